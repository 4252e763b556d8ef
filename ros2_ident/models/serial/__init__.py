# SPDX-License-Identifier: Apache-2.0
"""Arms: links and joints from a URDF, an MJCF or a table, driven by their recorded motion."""
