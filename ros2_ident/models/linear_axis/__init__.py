# SPDX-License-Identifier: Apache-2.0
"""Carriages, each on a motor of its own."""
