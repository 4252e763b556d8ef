# SPDX-License-Identifier: Apache-2.0
"""The node's parameters: the table `parameters.yaml`, declared, judged and as values."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
import difflib
import json
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.files import make_directory, read_yaml
from ros2_ident.models import load_machine
from ros2_ident.ros.run import expanded
from ros2_ident.search import GeneticSettings

Value = bool | int | float | str | tuple[str, ...]
# The parameters at one instant, by name.
Snapshot = Mapping[str, Any]

_KINDS = {bool: 'bool', int: 'integer', float: 'double', str: 'string', tuple: 'string_array'}
_LARGEST = 2**63 - 1


@dataclass(frozen=True)
class Entry:
    """One parameter of the node.

    Attributes:
        low: Least value of a number; None where there is no range.
        high: Largest value of a number that has a least one.
        unit: Unit of a number, empty for a count.
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


def descriptor(entry: Entry) -> ParameterDescriptor:
    """Return what `ros2 param describe` shows."""
    found = ParameterDescriptor(
        name=entry.name, description=entry.description, read_only=entry.read_only
    )
    found.type = Parameter.Type[entry.kind.upper()].value
    # the type of an empty list is unknown: `drives` could not be emptied
    found.dynamic_typing = entry.kind == 'string_array'
    if entry.choices:
        found.additional_constraints = f'one of {", ".join(entry.choices)}'
    if entry.low is not None and entry.kind == 'integer':
        found.integer_range = [IntegerRange(from_value=entry.low, to_value=entry.high)]
    elif entry.low is not None:
        found.floating_point_range = [
            FloatingPointRange(from_value=entry.low, to_value=entry.high)
        ]
    return found


def declare(node: Node) -> None:
    """Declare every parameter of the table on a node.

    Raises:
        IdentError: BAD_VALUES where an override does not fit, with the remedy.
    """
    given = dict(node._parameter_overrides)  # as launch files and the command line say; read only
    for entry in BY_NAME.values():
        value = given[entry.name].value if entry.name in given else None
        try:
            if value is not None and (reason := _wrong(entry, value)):
                raise ErrorCode.BAD_VALUES.error(reason)
            # rclpy takes an empty list for bytes: the type comes from a list that is not empty
            default = [''] if entry.default == () else entry.default
            node.declare_parameter(entry.name, default, descriptor(entry))
            if entry.default == () and not value:
                empty = Parameter(entry.name, Parameter.Type.STRING_ARRAY, [])
                node.set_parameters([empty])
        except InvalidParameterTypeException:
            raise ErrorCode.BAD_VALUES.error(_wrong_type(entry, value)) from None
        except InvalidParameterValueException as exc:
            raise ErrorCode.BAD_VALUES.error(
                f'parameter {entry.name} is {value!r}, its range is {entry.range or str(exc)}; '
                'give a value inside it'
            ) from None


def _wrong_type(entry: Entry, value: Any) -> str:
    """Return the sentence for a value of the wrong type; `1` for a double is the common one."""
    kind = entry.kind.replace('_', ' ')
    example = '[drive_1]' if kind == 'string array' else literal(entry.default)
    if kind == 'double' and type(value) is int:
        example = literal(float(value))
    wanted = f'has to be of type {kind}; write it like {example}'
    return f'parameter {entry.name} is {value!r} and {wanted}'


def _wrong(entry: Entry, value: Any) -> str:
    """Return what is wrong with a value that rclpy would take, empty for nothing."""
    if entry.choices and isinstance(value, str) and value not in entry.choices:
        return f'parameter {entry.name} is {value!r}; write one of {", ".join(entry.choices)}'
    if entry.kind == 'string_array':
        several = isinstance(value, Sequence) and not isinstance(value, str)
        if not (several and all(isinstance(x, str) for x in value)):
            return _wrong_type(entry, value)
    return ''


def unknown(node: Node) -> list[str]:
    """Return a sentence for every parameter that was given and that the node does not have."""
    sentences = []
    for name in node._parameter_overrides:
        if node.has_parameter(name) or name.startswith('qos_overrides.'):
            continue
        near = difflib.get_close_matches(name, BY_NAME, 1)
        remedy = (
            f'did you mean {near[0]}?' if near else 'see docs/parameters.md for those there are.'
        )
        sentences.append(f'parameter {name} is not known and has no effect; {remedy}')
    return sentences


def snapshot(node: Node) -> Snapshot:
    """Return all parameters of the table as they are now."""
    values = {}
    for entry in BY_NAME.values():
        value = node.get_parameter(entry.name).value
        if entry.kind == 'string_array':
            value = tuple(x for x in value or () if x)
        values[entry.name] = value
    return values


# What has to hold of the paths that some parameters name.
_PATHS: Mapping[str, Callable[[Path], Any]] = {
    'machine_file': load_machine,
    'output_directory': make_directory,
}


def check_path(name: str, value: Any) -> None:
    """Read the machine file, make the output directory; any other parameter is none of those.

    Raises:
        IdentError: Where that cannot be done.
    """
    if value and name in _PATHS:
        _PATHS[name](expanded(value))


def check_change(changes: Iterable[Parameter]) -> SetParametersResult:
    """Answer a change at run time; rclpy has checked types and ranges before."""
    for change in changes:
        entry = BY_NAME.get(change.name)
        reason = ''
        if entry is not None and change.type_ != Parameter.Type.NOT_SET:
            reason = _wrong(entry, change.value)
        elif entry is not None and entry.kind == 'string_array':
            reason = f'parameter {entry.name} cannot be taken away; set it to an empty list'
        try:
            check_path(change.name, change.value)
        except IdentError as error:
            reason = error.message
        if reason:
            return SetParametersResult(successful=False, reason=reason)
    return SetParametersResult(successful=True)
