# SPDX-License-Identifier: Apache-2.0
"""How two sets of logs differ before anything is fitted."""

from collections.abc import Iterator, Sequence
import math

from ros2_ident.change.columns import travels_of
from ros2_ident.change.result import Apart
from ros2_ident.gates import GateReport
from ros2_ident.identify.problem import Problem
from ros2_ident.machine.machine import Machine
from ros2_ident.models.registry import scales_of
from ros2_ident.recording import Dataset

# Motions whose strokes or speeds differ by this factor are others: what the model lacks does not
# cancel then. By hand.
_OTHER = 1.25


def apart(
    problem: Problem,
    machine: Machine,
    sides: Sequence[Sequence[Dataset]],
    reports: Sequence[GateReport],
    drives: Sequence[str] | None = None,
) -> Iterator[Apart]:
    """Yield how two sides differ in their checks and their motions.

    Args:
        problem: Nominal models of the machine.
        machine: The machine.
        sides: Its recordings before, and those after.
        reports: The checks of each side.
        drives: The drives looked at; all where None.
    """
    first, second = ([g for g in x.gates if g.level != 'ok'] for x in reports)
    both = {(g.gate, g.drive) for g in first} & {(g.gate, g.drive) for g in second}
    for gate, early in [(g, True) for g in first] + [(g, False) for g in second]:
        if (gate.gate, gate.drive) not in both:
            values = (gate.number, math.nan) if early else (math.nan, gate.number)
            yield Apart('check', gate.sentence, *values, gate.unit)
    scales = [scales_of(machine, x) for x in sides]
    units = travels_of(problem, machine)
    for d in map(machine.drives.index, drives or machine.drives):
        for name, unit in (('stroke', ''), ('speed', '/s')):
            one, other = (float(getattr(x, name)[d]) for x in scales)
            if max(one, other) > _OTHER * min(one, other):
                text = f'{name} of {machine.drives[d]}'
                yield Apart('motion', text, one, other, f'{units[d]}{unit}')
