# SPDX-License-Identifier: Apache-2.0
"""A URDF under P and D on position, or an MJCF with its own actuators, stepped by MuJoCo."""
