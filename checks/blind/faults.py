# SPDX-License-Identifier: Apache-2.0
"""Bookkeeping faults: the machine is as it should be, its log or its file is not.

What a diagnosis has to say of each is in `NAMED_BY`: the gate's id, or a word of its sentence.
"""

from collections.abc import Callable, Mapping
import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ros2_ident.recording import Stream

Streams = dict[str, Stream]
Plain = dict[str, Any]

EFFORT, STATE, COMMAND = '/effort', '/joint_states', '/joint_command'


@dataclass(frozen=True)
class Fault:
    """A fault with its numbers.

    Attributes:
        kind: One of `KINDS`.
        drive: Index of the drive; -1 where it is of the whole log.
        value: A factor or a time [s]; 0 where it has none.
        name: What is wrong: a constant's name, or `effort`, `position`, `command`.
    """

    kind: str
    drive: int
    value: float
    name: str


@dataclass(frozen=True)
class _Kind:
    """How a fault is drawn and made."""

    draw: Callable[[np.random.Generator, int, Plain], Fault]
    named_by: tuple[str, ...]


def _pick(rng: np.random.Generator, names: tuple[str, ...]) -> str:
    return str(rng.choice(list(names)))


def _sign(rng: np.random.Generator, drives: int, plain: Plain) -> Fault:
    return Fault('sign', int(rng.integers(-1, drives)), -1.0, 'effort')


def _unit(rng: np.random.Generator, drives: int, plain: Plain) -> Fault:
    """Millimetres for metres, thousandths of a newton metre, or percent of the rated torque."""
    if rng.random() < 0.4:
        return Fault('unit', -1, 1000.0, 'position')
    rated = 100.0 / float(plain['controller'].get('torque_limit', 1.0))
    return Fault('unit', -1, 1000.0 if rng.random() < 0.5 else rated, 'effort')


def _order(rng: np.random.Generator, drives: int, plain: Plain) -> Fault:
    return Fault('order', int(rng.integers(drives)), 0.0, _pick(rng, ('effort', 'command')))


def _lag(rng: np.random.Generator, drives: int, plain: Plain) -> Fault:
    return Fault('lag', -1, float(rng.uniform(0.012, 0.06)), 'command')


def _constant(rng: np.random.Generator, drives: int, plain: Plain) -> Fault:
    gains = ['velocity_gain', 'position_gain', 'effort']
    if float(plain['controller'].get('integral_gain', 0.0)):
        gains.append('integral_gain')
    factor = float(np.exp(rng.uniform(np.log(1.3), np.log(4.0))))
    return Fault('constant', -1, factor if rng.random() < 0.5 else 1.0 / factor,
                 _pick(rng, tuple(gains)))  # fmt: skip


KINDS: Mapping[str, _Kind] = {
    'sign': _Kind(_sign, ('sign',)),
    'unit': _Kind(_unit, ('unit', 'scale')),
    'order': _Kind(_order, ('order', 'swap', 'exchang')),
    'lag': _Kind(_lag, ('lag', 'late', 'delay', 'clock')),
    'constant': _Kind(_constant, ('law', 'scale')),
}


def named_by(fault: Fault) -> tuple[str, ...]:
    """Return ids of gates, or parts of words in a sentence, any of which names a fault."""
    own = () if fault.kind != 'constant' else (fault.name, fault.name.replace('_', ' '))
    return (*KINDS[fault.kind].named_by, *own)


def draw_fault(kind: str, rng: np.random.Generator, drives: int, plain: Plain) -> Fault:
    """Draw a fault of a kind."""
    return KINDS[kind].draw(rng, drives, plain)


def _field(streams: Streams, topic: str, name: str) -> Any:
    return getattr(streams[topic], name)


def _columns(fault: Fault, count: int) -> list[int]:
    return list(range(count)) if fault.drive < 0 else [fault.drive]


def _scaled(streams: Streams, topics: tuple[str, ...], names: tuple[str, ...],
            columns: list[int], factor: float) -> Streams:  # fmt: skip
    out = dict(streams)
    for topic in topics:
        for name in names:
            rows = _field(out, topic, name)
            if rows is not None:
                rows = rows.copy()
                rows[:, columns] *= factor
                out[topic] = replace(out[topic], **{name: rows})
    return out


def _swapped(streams: Streams, topic: str, first: int) -> Streams:
    """Return streams in which two neighbouring drives have each other's columns."""
    stream = streams[topic]
    names = list(stream.names)
    second = (first + 1) % len(names)
    order = np.arange(len(names))
    order[[first, second]] = order[[second, first]]
    fields = {
        name: rows[:, order]
        for name in ('position', 'velocity', 'effort')
        if (rows := getattr(stream, name)) is not None
    }
    return {**streams, topic: replace(stream, **fields)}


def in_log(fault: Fault, streams: Streams) -> Streams:
    """Return the streams as the fault leaves them."""
    columns = _columns(fault, len(streams[EFFORT].names))
    if fault.kind == 'unit' and fault.name == 'position':
        both = (STATE, COMMAND)
        return _scaled(streams, both, ('position', 'velocity'), columns, fault.value)
    if fault.kind in ('sign', 'unit') or (fault.kind, fault.name) == ('constant', 'effort'):
        return _scaled(streams, (EFFORT,), ('effort',), columns, fault.value)
    if fault.kind == 'order':
        return _swapped(streams, EFFORT if fault.name == 'effort' else COMMAND, fault.drive)
    if fault.kind == 'lag':
        later = streams[COMMAND].stamp + np.int64(round(fault.value * 1e9))
        return {**streams, COMMAND: replace(streams[COMMAND], stamp=later)}
    return streams


def in_file(fault: Fault, plain: Plain) -> Plain:
    """Return the machine file's content as the fault leaves it."""
    if fault.kind != 'constant' or fault.name == 'effort':
        return plain
    out = copy.deepcopy(plain)
    wrong = float(out['controller'][fault.name]) * fault.value
    out['controller'][fault.name] = float(f'{wrong:.5g}')
    return out
