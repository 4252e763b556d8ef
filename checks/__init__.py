# SPDX-License-Identifier: Apache-2.0
"""Checks of the package itself: the blind check of the diagnosis, the paper's experiments."""
