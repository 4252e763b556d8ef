# SPDX-License-Identifier: Apache-2.0
"""Words made of results, the same for terminal, page, message and file."""
