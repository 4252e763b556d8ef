# SPDX-License-Identifier: Apache-2.0
"""What machines made of controlled drives share."""
