# SPDX-License-Identifier: Apache-2.0
"""The gap between simulation and machine: where, which effect, how far it closes."""
