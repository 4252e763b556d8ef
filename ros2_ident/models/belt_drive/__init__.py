# SPDX-License-Identifier: Apache-2.0
"""The belt drive of the paper's section 3."""
