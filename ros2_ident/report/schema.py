# SPDX-License-Identifier: Apache-2.0
"""A result as plain data and back; `null` stands for what is not a number."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, fields, is_dataclass
from enum import Enum
from itertools import repeat
import math
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np

from ros2_ident.arrays import plain
from ros2_ident.errors import ErrorCode
from ros2_ident.identify.result import Identification
from ros2_ident.words.identification import message

SCHEMA = 'ros2_ident.identification'
VERSION = 1


def to_mapping(result: Identification) -> dict[str, Any]:
    """Return a result as nested dictionaries of plain values, in the order a reader wants them."""
    data = {
        'schema': SCHEMA,
        'version': VERSION,
        'outcome': result.outcome.value,
        'message': message(result),
        'model': result.model,
        'drives': result.drives,
        'parameters': {
            p.name: but(asdict(p), 'name') | {'identifiable': p.identifiable}
            for p in result.parameters
        },
        'fixed': result.fixed,
        'cost': asdict(result.cost),
        'residual': {x.drive: but(asdict(x), 'drive') for x in result.residuals},
        'validation': {x.drive: but(asdict(x), 'drive') for x in result.validation},
        'validated_on': result.validated_on,
        'gates': [asdict(gate) for gate in result.gates],
        'prediction': None if result.prediction is None else asdict(result.prediction),
        'rival': result.rival,
        'poor': [asdict(x) for x in result.poor],
        'evaluations': result.evaluations,
        'seconds': result.seconds,
        'seed': result.seed,
        'correlation': result.correlation,
        'search': {
            'generations': result.generations,
            'best_costs': result.history.best_costs,
            'stop': result.search_stop,
            'refinement': result.refinement,
        },
        'quality': asdict(result.quality),
        'settings': result.settings,
        'provenance': asdict(result.provenance),
    }
    mapping: dict[str, Any] = plain(data)
    return mapping


def but(entry: dict[str, Any], name: str) -> dict[str, Any]:
    """Return an entry without the name that it is stored under, and without an empty unit."""
    return {k: v for k, v in entry.items() if k != name and (k, v) != ('unit', '')}


def read(kind: Any, value: Any) -> Any:
    """Return a value of a type from plain data; NaN where a number is not known.

    Args:
        kind: A dataclass, or a type as those of its fields; others stay as they are.
        value: What `plain` made of it, or what was read already; what a file lacks has its
            default.
    """
    parts, origin = get_args(kind), get_origin(kind)
    if is_dataclass(value):
        return value
    if origin is Annotated:
        return parts[1] if value is None else read(parts[0], value)
    if origin is UnionType:
        return None if value is None else read(parts[0], value)
    if is_dataclass(kind):
        kinds = get_type_hints(kind, include_extras=True)
        there = {f.name for f in fields(kind)} & {*value}
        return kind(**{name: read(kinds[name], value[name]) for name in there})  # type: ignore[operator]
    if origin is np.ndarray:
        return np.array(value, dtype=get_args(parts[1])[0])
    if origin is tuple and isinstance(value, Mapping):  # by the first of its fields
        name = fields(parts[0])[0].name
        return tuple(read(parts[0], {name: key, **x}) for key, x in value.items())
    if origin is tuple:
        return tuple(map(read, repeat(parts[0]) if ... in parts else parts, value))
    if origin is Mapping:
        return {name: read(parts[1], x) for name, x in value.items()}
    if isinstance(kind, type) and issubclass(kind, float):
        return math.nan if value is None else float(value)
    if isinstance(kind, type) and issubclass(kind, int | str | Enum):
        return kind(value)
    return value


def from_mapping(data: Any, path: Path) -> Identification:
    """Return the result that a file's content describes.

    Args:
        data: What `to_mapping` returned.

    Returns:
        The result; its history holds the best costs and no candidates.

    Raises:
        IdentError: BAD_VALUES where it is no result, or another version's.
    """
    if not isinstance(data, Mapping) or data.get('schema') != SCHEMA:
        raise ErrorCode.BAD_VALUES.error(
            f'{path}: is no result of an identification; '
            'give a directory that `ident identify` wrote'
        )
    if data.get('version') != VERSION:
        raise ErrorCode.BAD_VALUES.error(
            f'{path}: has version {data.get("version")!r} and this package reads {VERSION}; '
            'read it with the package version it names'
        )
    with intact(path):
        search, size = data['search'], len(data['parameters'])
        known = {
            'residuals': data.get('residual', {}),
            'validation': data.get('validation', {}),
            'correlation': np.reshape(data['correlation'], (size, size)),
            'generations': search['generations'],
            'search_stop': search['stop'],
            'refinement': search['refinement'],
            'history': {
                'best_costs': search['best_costs'],
                'candidates': np.empty((0, size)),
                'costs': (),
                'generations': (),
            },
        }
        found: Identification = read(Identification, {**data, **known})
        return found


@contextmanager
def intact(path: Path) -> Iterator[None]:
    """Refuse a file whose content turns out not to be what was written there."""
    try:
        yield
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as exc:
        raise ErrorCode.BAD_VALUES.error(
            f'{path}: is incomplete or changed ({type(exc).__name__}: {exc}); write it anew'
        ) from None
