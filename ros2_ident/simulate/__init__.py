# SPDX-License-Identifier: Apache-2.0
"""Bags of a machine whose parameters are known: a motion, its log, and what a recorder adds."""
