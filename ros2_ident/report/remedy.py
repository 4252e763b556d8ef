# SPDX-License-Identifier: Apache-2.0
"""Lines for the machine file that bring in what a diagnosis found."""

from collections.abc import Iterator
import math

from ros2_ident.effects import CATALOGUE, EffectParameter
from ros2_ident.gap.diagnosis import Diagnosis, Value
from ros2_ident.machine.keys import digits, Key
from ros2_ident.machine.machine import Machine
from ros2_ident.models import EffectAt
from ros2_ident.models.drives.candidates import SLOTS
from ros2_ident.models.registry import KINDS
from ros2_ident.words.verdict import named


def machine_lines(found: Diagnosis, machine: Machine) -> tuple[str, ...]:
    """Return YAML for the machine file.

    Args:
        found: The diagnosis.
        machine: The machine it is of.

    Returns:
        Lines by section; none where no effect was found or the machine file has no key for it. A
        constant gets its new value. What the file does not know becomes a parameter to identify,
        searched up to twice the size found.
    """
    sections: dict[str, list[str]] = {}
    for at in named(found):
        for section, line in _lines(found, machine, at):
            sections.setdefault(section, []).append(line)
    return tuple(
        line for name, lines in sections.items() for line in (f'{name}:', *dict.fromkeys(lines))
    )


def _lines(found: Diagnosis, machine: Machine, at: EffectAt) -> Iterator[tuple[str, str]]:
    effect = CATALOGUE.get(at.effect)
    if effect is None or machine.kind not in KINDS:
        return
    size = next(p for p in effect.parameters if p.role == 'size')
    prefix = effect.id if at.where == 'all' else f'{at.where}.{effect.id}'
    value = found.parameters.get(f'{prefix}.{size.name}')
    if value is None or not math.isfinite(value.value):
        return
    # What fills the row of the kernel on which the effect acts.
    names = [name for name, slot in SLOTS.items() if size.target and slot.row == size.target]
    if any(name in machine.bounds for name in names):
        return
    keys = [key for key in KINDS[machine.kind].keys if key.name in names]
    for key in keys:
        if key.constant:
            yield from _constant(machine, key, size, value.value, at)
            return
    fitting = [k for k in keys if value.unit in (k.unit, k.force_unit)]
    if fitting:
        key = max(fitting, key=lambda k: k.unit == value.unit)
        yield key.section, _box(key.name, value)


def _constant(
    machine: Machine, key: Key, size: EffectParameter, value: float, at: EffectAt
) -> Iterator[tuple[str, str]]:
    """Yield a constant with its new value, of each drive where the effect sits on one."""
    old = machine.numbers(key.name).tolist()
    new = [
        (x * value if size.how == 'scale' else x + value) if at.where in ('all', drive) else x
        for drive, x in zip(machine.drives, old, strict=True)
    ]
    if not all(map(math.isfinite, new)):
        return
    said = [digits(float(f'{x:.5g}')) for x in new]
    text = said[0] if len(set(said)) == 1 else f'[{", ".join(said)}]'
    before = ', '.join(dict.fromkeys(digits(x) for x in old))
    yield key.section, f'  {key.name}: {text}  # {before} before'


def _box(name: str, value: Value) -> str:
    reach = digits(float(f'{2.0 * abs(value.value):.2g}'))
    low = f'-{reach}' if value.value < 0.0 else '0.0'
    return f'  {name}: [{low}, {reach}, {value.unit}]'
