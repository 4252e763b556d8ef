# SPDX-License-Identifier: Apache-2.0
"""A result as plain data and back; `null` stands for what is not a number."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
import math
from pathlib import Path
from typing import Any

import numpy as np

from ros2_ident.arrays import Array, plain
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.gates import Gate
from ros2_ident.identify.result import (
    Cost,
    DriveResidual,
    History,
    Identification,
    Outcome,
    ParameterEstimate,
    Provenance,
    Quality,
)
from ros2_ident.prediction import prediction_from

SCHEMA = 'ros2_ident.identification'
VERSION = 1


def to_mapping(result: Identification) -> dict[str, Any]:
    """Return a result as nested dictionaries of plain values, in the order a reader wants them."""
    parameters = {}
    for estimate in result.parameters:
        entry = asdict(estimate)
        del entry['name']
        entry['identifiable'] = estimate.identifiable
        parameters[estimate.name] = entry
    data = {
        'schema': SCHEMA,
        'version': VERSION,
        'outcome': result.outcome.value,
        'message': result.message,
        'model': result.model,
        'drives': result.drives,
        'parameters': parameters,
        'fixed': result.fixed,
        'cost': asdict(result.cost),
        'residual': _residuals(result.residuals),
        'validation': _residuals(result.validation),
        'validated_on': result.validated_on,
        'gates': [asdict(gate) for gate in result.gates],
        'prediction': None if result.prediction is None else asdict(result.prediction),
        'rival': result.rival,
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


def _residuals(residuals: tuple[DriveResidual, ...]) -> dict[str, Any]:
    return {
        left.drive: {'rms': left.rms, 'share': left.share, 'samples': left.samples}
        | ({'unit': left.unit} if left.unit else {})
        for left in residuals
    }


def _read_residuals(data: Mapping[str, Any]) -> tuple[DriveResidual, ...]:
    return tuple(
        DriveResidual(
            drive,
            _number(x['rms']),
            _number(x['share']),
            int(x['samples']),
            str(x.get('unit', '')),
        )
        for drive, x in data.items()
    )


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def gates_from(data: Iterable[Mapping[str, Any]]) -> tuple[Gate, ...]:
    """Return the findings that a file holds."""
    return tuple(Gate(**{**gate, 'number': _number(gate['number'])}) for gate in data)


def _numbers(values: Any) -> Array:
    return np.array([_number(v) for v in values], dtype=np.float64)


def from_mapping(data: Any, path: Path) -> Identification:
    """Return the result that a file's content describes.

    Args:
        data: What `to_mapping` returned.
        path: The file, for the errors.

    Returns:
        The result; its history holds the best costs and no candidates.

    Raises:
        IdentError: BAD_VALUES where it is no result, or another version's.
    """
    if not isinstance(data, Mapping) or data.get('schema') != SCHEMA:
        raise IdentError(
            ErrorCode.BAD_VALUES,
            f'{path}: is no result of an identification; '
            'give a directory that `ident identify` wrote',
        )
    if data.get('version') != VERSION:
        raise IdentError(
            ErrorCode.BAD_VALUES,
            f'{path}: has version {data.get("version")!r} and this package reads {VERSION}; '
            'read it with the package version it names',
        )
    with intact(path):
        return _result(data)


@contextmanager
def intact(path: Path) -> Iterator[None]:
    """Refuse a file whose content turns out not to be what was written there."""
    try:
        yield
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as exc:
        raise IdentError(
            ErrorCode.BAD_VALUES,
            f'{path}: is incomplete or changed ({type(exc).__name__}: {exc}); write it anew',
        ) from None


def _estimate(name: str, entry: Mapping[str, Any]) -> ParameterEstimate:
    numbers = (
        'value', 'low', 'high', 'noise_low', 'noise_high', 'lower_bound', 'upper_bound', 'ga_value'
    )  # fmt: skip
    return ParameterEstimate(
        name=name,
        unit=str(entry['unit']),
        at_bound=bool(entry['at_bound']),
        state=entry.get('state', 'identified' if entry['identifiable'] else 'not determined'),
        kind=entry['kind'],
        note=str(entry['note']),
        hidden=bool(entry.get('hidden')),
        **{key: _number(entry.get(key)) for key in numbers},
    )


def _result(data: Mapping[str, Any]) -> Identification:
    search, quality = data['search'], data['quality']
    estimates = tuple(_estimate(name, entry) for name, entry in data['parameters'].items())
    size = len(estimates)
    cost = data['cost']
    outcome = Outcome(data['outcome'])
    ga = math.inf if cost['ga'] is None else float(cost['ga'])
    return Identification(
        outcome=outcome,
        message=str(data['message']),
        model=str(data['model']),
        drives=tuple(data['drives']),
        parameters=estimates,
        fixed={name: float(value) for name, value in data['fixed'].items()},
        correlation=np.array([_numbers(row) for row in data['correlation']]).reshape(size, size),
        cost=Cost(ga, _number(cost['refined']), str(cost['unit'])),
        residuals=_read_residuals(data['residual']),
        evaluations=int(data['evaluations']),
        generations=int(search['generations']),
        seconds=float(data['seconds']),
        seed=int(data['seed']),
        search_stop=str(search['stop']),
        refinement=str(search['refinement']),
        history=History(
            _numbers(search['best_costs']),
            np.empty((0, size)),
            np.empty(0),
            np.empty(0, dtype=np.int64),
        ),
        quality=Quality(
            int(quality['segments']),
            float(quality['duration']),
            int(quality['samples']),
            {role: float(share) for role, share in quality['missing'].items()},
            tuple(quality['warnings']),
        ),
        provenance=Provenance(**data['provenance']),
        settings=dict(data['settings']),
        validation=_read_residuals(data.get('validation', {})),
        validated_on=str(data.get('validated_on', '')),
        gates=gates_from(data.get('gates', ())),
        prediction=prediction_from(data.get('prediction')),
        rival=tuple(data.get('rival', ())),
    )
