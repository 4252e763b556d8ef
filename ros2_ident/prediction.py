# SPDX-License-Identifier: Apache-2.0
"""Free runs: how far a machine's own model comes from a log, by set-points alone.

What a fit leaves of an effort says little of where a simulator stands after ten seconds. Here the
model starts where the log does, is told the log's set-points (or efforts) and nothing else, and
each quantity that was logged is compared.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from ros2_ident.arrays import Above, Array
from ros2_ident.models.protocol import FullModel

# A model, and a candidate (N,) of it.
Run = tuple[FullModel, Array]
DESCRIBED, IDENTIFIED = 'as described', 'identified'
CHECK, LOG = 'check bag', 'log fitted on'
_ORDER = 'position', 'velocity', 'effort'


@dataclass(frozen=True)
class Error:
    """How far one quantity of one drive comes from its log.

    Attributes:
        quantity: `position`, `velocity` or `effort`.
        rmse: Root of the mean squared error; inf where the model diverged.
        mae: Mean absolute error.
    """

    drive: str
    quantity: str
    unit: str
    rmse: Above
    mae: Above
    samples: int


@dataclass(frozen=True)
class Stage:
    """One model: its name, and its errors by quantity, positions first, drive by drive within."""

    label: str
    errors: tuple[Error, ...]


@dataclass(frozen=True)
class Prediction:
    """Free runs of several models on the same recordings.

    Attributes:
        on: The recordings: `check bag` or `log fitted on`, or their paths.
        stages: The models, in the order in which they became better.
        hindered: Why there is no free run, and what to log; empty where there is one.
    """

    on: str = ''
    stages: tuple[Stage, ...] = ()
    hindered: str = ''

    @property
    def rows(self) -> tuple[tuple[Error, ...], ...]:
        """Each quantity of each drive, stage after stage."""
        return tuple(zip(*(s.errors for s in self.stages), strict=True))

    @property
    def first(self) -> tuple[tuple[Error, ...], ...]:
        """Those of the quantity that tells most: positions where they are logged."""
        return next((tuple(rows) for _, rows in groupby(self.rows, lambda r: r[0].quantity)), ())

    @property
    def quantity(self) -> str:
        """That quantity."""
        return self.first[0][0].quantity if self.first else ''


def predicted(
    on: str, stages: Iterable[tuple[str, Sequence[Run]]], warm_up: int = 0
) -> Prediction:
    """Run models freely.

    Args:
        stages: For each model its name, and itself on every recording.
        warm_up: Samples at a recording's start that are simulated and not compared.
    """
    found = []
    for label, runs in stages:
        free = [(model.free_run(), theta) for model, theta in runs]
        if any(model is None for model, _ in free):
            return Prediction(on, hindered=_hindered(runs[0][0]))
        errors = _errors([(m, theta) for m, theta in free if m is not None], warm_up)
        found.append(Stage(label, errors))
    return Prediction(on, tuple(found))


def of_description(runs: Sequence[Run]) -> list[tuple[str, list[Run]]]:
    """Return as one stage the models with all that their description states, as far as it does."""
    stated = runs[0][0].as_described({})
    names = [p.name for p in runs[0][0].parameters]
    if not set(names) & set(stated):
        return []
    own = [np.array([stated.get(n, x) for n, x in zip(names, t, strict=True)]) for _, t in runs]
    return [(DESCRIBED, [(model, t) for (model, _), t in zip(runs, own, strict=True)])]


def _errors(runs: Sequence[Run], warm_up: int) -> tuple[Error, ...]:
    """Return the errors of one model on all recordings, of what each of them holds."""
    left: dict[tuple[str, str, str], list[Array]] = {}
    for model, theta in runs:
        simulated = model.simulate(theta[None])[0]
        for output, seen, made in zip(model.outputs, model.measured, simulated, strict=True):
            there = np.flatnonzero(np.isfinite(seen))[warm_up:]
            key = output.quantity, output.place or output.name, output.unit
            left.setdefault(key, []).append(seen[there] - made[there])
    errors = []
    for (quantity, drive, unit), parts in left.items():
        if len(parts) == len(runs) and any(x.size for x in parts):
            rest = np.concatenate(parts)
            rmse, mae = float(np.sqrt(np.mean(rest**2))), float(np.mean(np.abs(rest)))
            errors.append(Error(drive, quantity, unit, rmse, mae, rest.size))
    return tuple(sorted(errors, key=lambda error: _ORDER.index(error.quantity)))


def _hindered(model: FullModel) -> str:
    """Return why a model does not run freely, and what to log for one that does."""
    if model.machine is None:
        return "a user's own model does not say that it runs freely (`free_run`)"
    return (
        "without a set-point or the controllers' gains the recorded motion drives the model; for "
        "a free run log the drives' set-points (`joint_command`) and state the gains, or list "
        'them in parameters'
    )
