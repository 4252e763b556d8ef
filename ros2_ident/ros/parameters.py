# SPDX-License-Identifier: Apache-2.0
"""Declare the node's parameters from the table, refuse wrong ones in sentences, take snapshots."""

from collections.abc import Iterable, Mapping, Sequence
import difflib
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
from ros2_ident.models import load_machine
from ros2_ident.ros.parameter_table import BY_NAME, Entry, literal
from ros2_ident.ros.paths import expanded

# The parameters at one instant, by name.
Snapshot = Mapping[str, Any]


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
                raise IdentError(ErrorCode.BAD_VALUES, reason)
            # rclpy takes an empty list for bytes: the type comes from a list that is not empty
            default = [''] if entry.default == () else entry.default
            node.declare_parameter(entry.name, default, descriptor(entry))
            if entry.default == () and not value:
                empty = Parameter(entry.name, Parameter.Type.STRING_ARRAY, [])
                node.set_parameters([empty])
        except InvalidParameterTypeException:
            raise IdentError(ErrorCode.BAD_VALUES, _wrong_type(entry, value)) from None
        except InvalidParameterValueException as exc:
            raise IdentError(
                ErrorCode.BAD_VALUES,
                f'parameter {entry.name} is {value!r}, its range is {entry.range or str(exc)}; '
                'give a value inside it',
            ) from None


def _wrong_type(entry: Entry, value: Any) -> str:
    """Return the sentence for a value of the wrong type; `1` for a double is the common one."""
    if entry.kind == 'double' and isinstance(value, int) and not isinstance(value, bool):
        return (
            f'parameter {entry.name} is {value}, an integer, and has to be a double; '
            f'write {value}.0'
        )
    kind = entry.kind.replace('_', ' ')
    article = 'an' if kind == 'integer' else 'a'
    example = '[drive_1]' if kind == 'string array' else literal(entry.default)
    return (
        f'parameter {entry.name} is {value!r} and has to be {article} {kind}; '
        f'write it like {example}'
    )


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


def check_change(changes: Iterable[Parameter]) -> SetParametersResult:
    """Answer a change at run time; rclpy has checked types and ranges before."""
    for change in changes:
        entry = BY_NAME.get(change.name)
        reason = ''
        if entry is not None and change.type_ != Parameter.Type.NOT_SET:
            reason = _wrong(entry, change.value)
        elif entry is not None and entry.kind == 'string_array':
            reason = f'parameter {entry.name} cannot be taken away; set it to an empty list'
        if change.name == 'machine_file' and change.value:
            try:
                load_machine(expanded(change.value))
            except IdentError as error:
                reason = error.message
        if reason:
            return SetParametersResult(successful=False, reason=reason)
    return SetParametersResult(successful=True)
