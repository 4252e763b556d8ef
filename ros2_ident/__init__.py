# SPDX-License-Identifier: Apache-2.0
"""Identify drive parameters from recorded drive data and say where the simulation falls short."""
