# SPDX-License-Identifier: Apache-2.0
"""Checks of a log against the machine file before any physics is fitted."""

from ros2_ident.gates.examine import examine
from ros2_ident.gates.finding import Gate, GateReport, sentences

__all__ = ['Gate', 'GateReport', 'examine', 'sentences']
