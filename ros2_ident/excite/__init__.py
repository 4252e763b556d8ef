# SPDX-License-Identifier: Apache-2.0
"""Motions that determine a machine's parameters well, within its limits."""
