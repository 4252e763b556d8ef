# SPDX-License-Identifier: Apache-2.0
"""Machines that MuJoCo simulates, and the effects that are hidden in them."""
