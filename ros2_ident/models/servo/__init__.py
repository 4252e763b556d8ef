# SPDX-License-Identifier: Apache-2.0
"""Servos: motors fed with a share of a supply voltage by a law on position, an arm as load."""
