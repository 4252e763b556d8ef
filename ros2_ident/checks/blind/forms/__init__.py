# SPDX-License-Identifier: Apache-2.0
"""The generator's forms of effects, from the literature; README.md says who does not read them."""

from collections.abc import Mapping
import functools

import numpy as np

from ros2_ident.checks.blind.forms import (
    controller,
    friction,
    measurement,
    outside,
    structure,
    transmission,
)
from ros2_ident.checks.blind.forms.form import Form, Hidden
from ros2_ident.effects import CATALOGUE
from ros2_ident.machine.machine import Machine
from ros2_ident.reference.effects import machine_has

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


def draw_form(
    form: Form, machine: Machine, where: str, size: float, seed: int
) -> Hidden:
    """Draw a form's numbers.

    Args:
        form: The form.
        machine: The machine; it scales torques and forces.
        where: The drive; forms of the whole machine sit on all.
        size: 0 (seen by nobody) to 1 (gross), geometric between the ends of the size's range.
        seed: Of everything but the size: with another size, signs and shapes stay.

    Returns:
        The form with its numbers.
    """
    rng = np.random.default_rng(seed)
    sign = -1.0 if form.size.signed and rng.random() < 0.5 else 1.0
    values = {}
    for number in form.others:
        starts = starts_of(form.effect, number.counterpart)
        values[number.name] = number.draw(rng, starts) * number.scale(machine)
    noise = int(rng.integers(2**31))
    magnitude = form.size.low * (form.size.high / form.size.low) ** size
    for start in starts_of(form.effect, form.size.counterpart):
        magnitude = _clear_of(magnitude, start)
    values[form.size.name] = sign * magnitude * form.size.scale(machine)
    return Hidden(form, 'all' if form.place == 'all' else where, values, size, noise)


def _clear_of(value: float, start: float, clear: float = 0.05) -> float:
    """Return a value, or where it is next to a start value one just beside that."""
    if abs(value - start) > clear * abs(start):
        return value
    return start * (1.0 + clear if value >= start else 1.0 - clear)
