# SPDX-License-Identifier: Apache-2.0
"""Carriages, each on a motor of its own."""

from ros2_ident.models.linear_axis.model import LinearAxis as LinearAxis
