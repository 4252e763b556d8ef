# SPDX-License-Identifier: Apache-2.0
"""An MJCF with its own actuators, stepped by MuJoCo."""
