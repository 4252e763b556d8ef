# SPDX-License-Identifier: Apache-2.0
"""The generator's forms of effects, from the literature; README.md says who does not read them."""

from collections.abc import Mapping
import functools
import re

import numpy as np

from checks.blind.forms import controller, friction, measurement, outside, structure, transmission
from checks.blind.forms.form import Form, Hidden, Range
from checks.reference.effect_kind import TRIPOD_FORCE, TRIPOD_LIMIT
from checks.reference.effects import machine_has
from ros2_ident.effects import CATALOGUE
from ros2_ident.machine.machine import Machine
from ros2_ident.models.registry import KINDS

# Motor angle per travel of the tripod that the ranges suit, rad/m.
TRIPOD_GEAR = TRIPOD_FORCE / TRIPOD_LIMIT

_MODULES = (friction, transmission, controller, structure, measurement, outside)
FORMS: Mapping[str, Form] = {form.name: form for part in _MODULES for form in part.FORMS}


@functools.cache
def starts_of(effect: str, parameter: str) -> tuple[float, ...]:
    """Return the values from which the search of a catalogue's parameter starts."""
    for known in CATALOGUE[effect].parameters if effect in CATALOGUE else ():
        if known.name == parameter:
            return (*known.starts, *(() if known.starts else (known.neutral,)))
    return ()


def suits(form: Form, machine: Machine) -> bool:
    """Return whether a form can sit on a machine."""
    return machine_has(form.needs, machine, 'gear_stiffness' in machine.bounds)


def draw_form(form: Form, machine: Machine, where: str, size: float, seed: int) -> Hidden:
    """Draw a form's numbers.

    Args:
        machine: The machine; it scales torques and forces.
        where: The drive; forms of the whole machine sit on all.
        size: 0 (seen by nobody) to 1 (gross), geometric between the ends of the size's range.
        seed: Of everything but the size: with another size, signs and shapes stay.
    """
    rng = np.random.default_rng(seed)
    sign = -1.0 if form.size.signed and rng.random() < 0.5 else 1.0
    values = {}
    for number in form.others:
        starts = starts_of(form.effect, number.counterpart)
        values[number.name] = number.draw(rng, starts) * _scale(form, number, machine)
    noise = int(rng.integers(2**31))
    magnitude = form.size.low * (form.size.high / form.size.low) ** size
    for start in starts_of(form.effect, form.size.counterpart):
        magnitude = _clear_of(magnitude, start)
    values[form.size.name] = sign * magnitude * _scale(form, form.size, machine)
    return Hidden(form, 'all' if form.place == 'all' else where, values, size, noise)


def _scale(form: Form, number: Range, machine: Machine) -> float:
    """Return the factor from the tripod's number to that of another machine.

    Where a drive turns a joint, a metre is the angle for which its motor turns as far.
    """
    scale = number.scale(machine)
    turns = KINDS[machine.kind].travel == 'rad' and machine.known('gear_factor')
    if form.place == 'all' or not turns:
        return scale
    metre = TRIPOD_GEAR / float(machine.numbers('gear_factor').max())
    return float(scale * metre ** _metres(number.unit))


def _metres(unit: str) -> float:
    """Return the power of metres of travel in a unit; those of a torque are none."""
    above, _, below = unit.replace('N m', 'N').partition('/')
    return sum(
        sign * float(power or 1.0)
        for sign, part in ((1.0, above), (-1.0, below))
        for power in re.findall(r'\bm\b(?:\^([\d.]+))?', part)
    )


def _clear_of(value: float, start: float, clear: float = 0.05) -> float:
    """Return a value, or where it is next to a start value one just beside that."""
    if abs(value - start) > clear * abs(start):
        return value
    return start * (1.0 + clear if value >= start else 1.0 - clear)
