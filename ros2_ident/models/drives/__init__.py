# SPDX-License-Identifier: Apache-2.0
"""Common parts of machines made of controlled drives."""
