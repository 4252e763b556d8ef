# SPDX-License-Identifier: Apache-2.0
"""Key of a machine file, and the keys that every kind of machine has.

A kind lists its keys, this package's in `keys.yaml`; the loader and `ident check` judge by that
list, `ident new-machine` and the reference page are written from it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
import functools
import math
from pathlib import Path
import re
from typing import Any

import yaml

Value = float | str

# What a machine behaves like whose kind has no such key, and what an absent one means by default.
NEUTRAL: Mapping[str, Value] = {
    'gravity': 0.0,
    'gear_factor': 1.0,
    'travel_per_turn': 2.0 * math.pi,
    'rail_mass': 0.0,
    'coulomb_regularisation': 5e-3,
    'law': 'cascade_pi',
    'position_gain': math.nan,
    'velocity_gain': math.nan,
    'integral_gain': 0.0,
    'velocity_feedforward': 0.0,
    'torque_limit': math.inf,
}


# The default that follows from another constant, the travel per turn of the motor.
TURN_OF_GEAR = '2 pi / gear_factor'
# Sections of what belongs to a drive each, where a key does not say otherwise.
_OF_DRIVES = ('drive', 'controller', 'parameters')
# In the place of a description's file: the topic on which the node hears it.
DESCRIPTION_TOPIC = '/robot_description'


@dataclass(frozen=True)
class Key:
    """One key of a machine file.

    Attributes:
        section: The mapping it stands in; empty for the file itself.
        unit: Its unit, `1` for a plain number, empty where it is no number. The values of
            `parameters` are intervals in it.
        example: Value in a new machine file.
        absent: What its absence means, in words; empty where it may not be absent.
        default: What its absence means; where None, what `NEUTRAL` says.
        low: Smallest plausible value.
        force_unit: Its unit where the effort is a force.
        shown: Whether a new machine file sets it; else it stands there behind a `#`.
        each: Whether it belongs to a drive: the file has one value for all, or a list.
        choices: What may stand there where it is no number; empty for anything.
        aliases: Other words for a choice.
        file: Whether it names a file, by its way from the machine file's folder. What the file
            holds is then the constant: a machine needs no path. `DESCRIPTION_TOPIC` stands for
            what the node hears.
    """

    section: str
    name: str
    unit: str
    meaning: str
    example: object
    absent: str = ''
    default: Value | None = None
    low: float = -math.inf
    high: float = math.inf
    force_unit: str = ''
    shown: bool = True
    each: bool = False
    choices: tuple[str, ...] = ()
    aliases: tuple[tuple[str, str], ...] = ()
    remedy: str = 'check value and unit'
    file: bool = False

    @property
    def path(self) -> tuple[str, ...]:
        """Where it stands: section and name, or the name alone."""
        return (self.section, self.name) if self.section else (self.name,)

    @property
    def constant(self) -> bool:
        """Whether it says something of the machine that models read."""
        return self.section not in ('', 'parameters')

    def at(self, example: object, **changes: object) -> 'Key':
        """Return the key with another example, and other changes."""
        return replace(self, example=example, **changes)  # type: ignore[arg-type]

    def value(self, before: Mapping[str, Value]) -> Value:
        """Return what the key's absence means.

        Args:
            before: The same drive's constants before it in the table.
        """
        if self.default == TURN_OF_GEAR:
            return 2.0 * math.pi / float(before['gear_factor'])
        return NEUTRAL.get(self.name, math.nan) if self.default is None else self.default

    def searched(self, example: Sequence[float] | None = None, shown: bool = False) -> 'Key':
        """Return a constant as something to be identified, see `keys_of`."""
        ends: tuple[object, ...]
        if isinstance(self.example, tuple):
            low, high = example or (0.0, 0.0)
            ends = tuple((x + low, x + high) for x in self.example)
        else:
            assert isinstance(self.example, float)
            ends = tuple(example or (0.75 * self.example, 1.25 * self.example))
        absent = 'the constant above holds'
        return replace(self, section='parameters', example=ends, shown=shown, absent=absent)


@functools.cache
def _table() -> Mapping[str, Any]:
    text = Path(__file__).with_name('keys.yaml').read_text(encoding='utf-8')
    loader = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
    found: Mapping[str, Any] = yaml.load(text, loader)  # noqa: S506 - both are safe
    return found


def keys_of(kind: str, rows: Sequence[Any] | None = None) -> tuple[Key, ...]:
    """Return the keys of a kind of machine, in the order of a new machine file.

    Args:
        rows: Paths of shared keys, names of groups of them, lists of these, and
            `{path: attributes}`, which change a shared key where there is one; `range` is its
            plausible values. A parameter that is named as a constant before it is that one, to be
            identified: its example is three to five quarters of the constant's, or, where each
            drive has another one, these and how far bounds lie from them. What `keys.yaml` has of
            the kind where None.
    """
    shared = _table()['shared']
    known = {path: row for group in shared.values() for path, row in group.items()}
    found: dict[str, Key] = {}
    for path, own in _listed(['machine', *(_table()[kind] if rows is None else rows)], shared):
        section, _, name = path.rpartition('.')
        constant = next((k for k in found.values() if k.constant and k.name == name), None)
        if section == 'parameters' and constant is not None:
            found[path] = constant.searched(**own)
            continue
        row = {**known.get(path, {}), **own}
        least, most = row.pop('range', (-math.inf, math.inf))
        row = {'unit': '', 'low': least, 'high': most, 'each': section in _OF_DRIVES, **row}
        row['aliases'] = tuple(row.get('aliases', {}).items())
        found[path] = Key(section, name, **{n: _plain(value) for n, value in row.items()})
    found['machine'] = found['machine'].at(kind)
    return tuple(found.values())


def _listed(rows: Sequence[Any], shared: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield paths with the attributes that they change."""
    for row in rows:
        if isinstance(row, dict):
            yield from row.items()
        elif isinstance(row, list):
            yield from _listed(row, shared)
        else:
            yield from ((path, {}) for path in shared.get(row, [row]))


def _plain(value: Any) -> Any:
    """Return lists as tuples."""
    return tuple(map(_plain, value)) if isinstance(value, list) else value


def literal(key: Key) -> str:
    """Return the example of a key as YAML."""
    value = key.example
    if key.section == 'parameters':
        assert isinstance(value, tuple)
        if isinstance(value[0], tuple):
            return f'[{", ".join(literal(key.at(box)) for box in value)}]'
        unit = '"1"' if key.unit == '1' else key.unit
        return f'[{digits(value[0])}, {digits(value[1])}, {unit}]'
    if isinstance(value, tuple):
        return f'[{", ".join(str(part) for part in value)}]'
    return digits(value) if isinstance(value, float) else str(value)


class _Dumper(yaml.SafeDumper):
    """Puts into quotes, too, what readers of YAML 1.2 or ROS take for no text: 1e3, y, nan."""


_Dumper.add_implicit_resolver('!', re.compile(r'[-+.\d]|(?i:y|n|nan|inf|infinity)$'), None)


def written(value: Any, flow: bool = False) -> str:
    """Return as YAML what may hold names from outside, in flow style on one line."""
    style: dict[str, Any] = {'default_flow_style': flow, 'width': math.inf if flow else 99}
    return str(yaml.dump(value, None, _Dumper, sort_keys=False, allow_unicode=True, **style))


def inline(value: Any) -> str:
    """Return a value as it may stand in a line of YAML, in a list, too."""
    return written([value], flow=True)[1:-2]


def digits(value: float) -> str:
    """Return a number so that YAML 1.1 reads it as one: with a point, its exponent with a sign."""
    if value and not 1e-3 <= abs(value) < 1e4:
        mantissa, _, exponent = f'{value:.7e}'.partition('e')
        mantissa = mantissa.rstrip('0')
        return f'{mantissa}{"0" if mantissa.endswith(".") else ""}e{int(exponent):+d}'
    text = f'{value:.9g}'
    return text if '.' in text else f'{text}.0'
