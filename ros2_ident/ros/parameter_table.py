# SPDX-License-Identifier: Apache-2.0
"""The one table of the identifier's parameters, `parameters.yaml`, as values."""

from collections.abc import Mapping
from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

from ros2_ident.files import read_yaml
from ros2_ident.search import GeneticSettings

Value = bool | int | float | str | tuple[str, ...]

_KINDS = {bool: 'bool', int: 'integer', float: 'double', str: 'string', tuple: 'string_array'}
_LARGEST = 2**63 - 1


@dataclass(frozen=True)
class Entry:
    """One parameter of the node.

    Attributes:
        name: Its name.
        default: Its value where none is set.
        text: What it does and when to change it.
        low: Least value of a number; None where there is no range.
        high: Largest value of a number that has a least one.
        unit: Unit of a number, empty for a count.
        choices: Allowed strings, empty for any.
        read_only: Whether it is fixed when the node starts.
    """

    name: str
    default: Value
    text: str
    low: float | None = None
    high: float = _LARGEST
    unit: str = ''
    choices: tuple[str, ...] = ()
    read_only: bool = False

    @property
    def kind(self) -> str:
        """`bool`, `integer`, `double`, `string` or `string_array`."""
        return _KINDS[type(self.default)]

    @property
    def description(self) -> str:
        """Description for tools, with the unit and the choices."""
        unit = f' [{self.unit}]' if self.unit else ''
        choices = f' One of {", ".join(self.choices)}.' if self.choices else ''
        return f'{self.text}{choices}{unit}'

    @property
    def range(self) -> str:
        """Its range in words, empty where there is none."""
        if self.low is None:
            return ''
        return f'from {self.low:g}' if self.high == _LARGEST else f'{self.low:g} to {self.high:g}'


def _entry(name: str, written: Mapping[str, Any]) -> Entry:
    """Return a parameter as the file has it."""
    value = dict(written['value'])
    default = value.pop('default', None)
    if default is None:
        default = getattr(GeneticSettings(), name)
    ends = dict(zip(('low', 'high'), value.pop('range', ()), strict=False))
    choices = tuple(value.pop('choices', ()))
    default = tuple(default) if isinstance(default, list) else default
    return Entry(name, default, written['text'], choices=choices, **ends, **value)


BY_NAME = {
    name: _entry(name, written)
    for name, written in read_yaml(Path(__file__).with_name('parameters.yaml')).items()
}


def literal(value: Value) -> str:
    """Return a default as it is written in YAML; a double always has its point."""
    return repr(value) if isinstance(value, str) else json.dumps(value)
