# SPDX-License-Identifier: Apache-2.0
"""Compared quantities of a machine's drives, and their weights."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, KW_ONLY
import functools
from typing import ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.effects import EffectParameter
from ros2_ident.errors import ErrorCode
from ros2_ident.kernel.group import Task
from ros2_ident.kernel.measurement import QUANTITIES, Quantity
from ros2_ident.machine.machine import Machine, Parameter
from ros2_ident.models.drives.candidates import Candidates
from ros2_ident.models.protocol import EffectAt, FullModel, Output, Scales
from ros2_ident.recording import Dataset

T = TypeVar('T', bound=np.generic)


@dataclass(frozen=True)
class Outputs:
    """Quantities of drives, quantity by quantity, drive by drive within.

    Position and velocity are the motor's at the controller's instants, neither late nor rounded:
    what an encoder makes of a position acts on what the controller reads.

    Attributes:
        drives: Names of the drives that are compared.
        places: Their numbers among the machine's drives.
        count: Drives of the machine.
        quantities: What of each is compared, in the order of `QUANTITIES`.
        weights: Factor on the errors of each quantity.
    """

    drives: tuple[str, ...]
    places: tuple[int, ...]
    count: int
    quantities: tuple[Quantity, ...]
    weights: tuple[float, ...]

    def __len__(self) -> int:
        return len(self.quantities) * len(self.drives)

    def described(self, efforts: Sequence[str], travels: Sequence[str]) -> tuple[Output, ...]:
        """Return the O outputs: `drive_1` for its effort, `drive_1.position` for its position.

        Args:
            efforts: (D,) unit of the effort of each drive of the machine.
            travels: (D,) unit of its position.
        """
        units = {'effort': efforts, 'position': travels, 'velocity': [f'{x}/s' for x in travels]}
        out = []
        for quantity, weight in zip(self.quantities, self.weights, strict=True):
            for drive, place in zip(self.drives, self.places, strict=True):
                name = drive if quantity == 'effort' else f'{drive}.{quantity}'
                out.append(Output(name, units[quantity][place], weight, drive, quantity))
        return tuple(out)

    @property
    def sources(self) -> tuple[int, ...]:
        """The number of the drive that each of them is of."""
        return self.places * len(self.quantities)

    @property
    def moving(self) -> bool:
        """Whether motion is among them."""
        return self.quantities != ('effort',)

    def measured(self, data: Dataset) -> Array:
        """Return (O, K) what a recording holds of them; NaN at cycles without a sample.

        Raises:
            IdentError: MISSING_STREAM where it holds nothing of a quantity.
        """
        rows = [data.names.index(name) for name in self.drives]
        parts = []
        for quantity in self.quantities:
            values = getattr(data, quantity)
            if values is None:
                raise ErrorCode.MISSING_STREAM.error(
                    f'the recording holds no {quantity}; record it, or leave it out of what is '
                    'compared'
                )
            parts.append(values[rows])
        return np.ascontiguousarray(np.concatenate(parts))

    def task(self, there: npt.NDArray[np.bool_], out: Array) -> Task:
        """Return the task of writing them to `out` where `there` (O, K) holds."""
        columns = np.full(there.shape, -1, dtype=np.int64)
        columns[there] = np.arange(int(there.sum()))
        wanted = self._in_kernel(columns, -1)
        weights = np.ones(len(wanted))
        weights[[QUANTITIES.index(quantity) for quantity in self.quantities]] = self.weights
        samples = (wanted >= 0).sum(axis=2)
        return Task(wanted, np.empty((0, 0, 0)), samples, weights, np.empty(0), out)

    def costing(self, measured: Array) -> Task:
        """Return the task of summing costs by what was measured (O, K).

        What belongs to the candidates is still to be put in: `limits` and `out`.
        """
        behind = np.pad(measured, ((0, 0), (0, 1)), constant_values=np.nan)
        task = self.task(~np.isnan(measured), np.empty((0, 1)))
        return task._replace(measured=self._in_kernel(behind, np.nan))

    def _in_kernel(self, values: npt.NDArray[T], fill: float) -> npt.NDArray[T]:
        """Return (Q, D, ...) the values (O, ...) among what the kernel knows."""
        known = len(QUANTITIES) if self.moving else 1
        out = np.full((known, self.count, *values.shape[1:]), fill, dtype=values.dtype)
        each = values.reshape(len(self.quantities), len(self.drives), *values.shape[1:])
        for quantity, part in zip(self.quantities, each, strict=True):
            out[QUANTITIES.index(quantity), list(self.places)] = part
        return out


def logged_of(data: Dataset, drives: Sequence[str]) -> tuple[str, ...]:
    """Return which quantities a recording holds of some drives, of one of them at least."""
    rows = [data.names.index(name) for name in drives]
    every = {quantity: getattr(data, quantity) for quantity in QUANTITIES}
    return tuple(q for q, x in every.items() if x is not None and np.isfinite(x[rows]).any())


def chosen_outputs(
    machine_drives: Sequence[str],
    drives: Sequence[str],
    quantities: Sequence[str],
    weights: Sequence[float] | None,
) -> Outputs:
    """Return the outputs that were asked for.

    Args:
        machine_drives: The machine's drives.
        drives: Those that are compared.
        quantities: What of them, each one of `QUANTITIES`.
        weights: One for each quantity; 1 by default.

    Raises:
        IdentError: INVALID_GOAL with the remedy.
    """
    unknown = [q for q in quantities if q not in QUANTITIES]
    if unknown or not quantities or len(set(quantities)) < len(quantities):
        raise ErrorCode.INVALID_GOAL.error(
            f'{", ".join(quantities) or "nothing"} cannot be compared; choose from '
            f'{", ".join(QUANTITIES)}, each once'
        )
    given = [1.0] * len(quantities) if weights is None else [float(w) for w in weights]
    if len(given) != len(quantities) or not all(0.0 < w < np.inf for w in given):
        raise ErrorCode.INVALID_GOAL.error(
            f'weights {", ".join(f"{w:g}" for w in given) or "none"} do not suit '
            f'{", ".join(quantities)}; give one positive number for each'
        )
    of = dict(zip(quantities, given, strict=True))
    ordered: tuple[Quantity, ...] = tuple(q for q in QUANTITIES if q in of)
    places = tuple(machine_drives.index(name) for name in drives)
    told = tuple(of[q] for q in ordered)
    return Outputs(tuple(drives), places, len(machine_drives), ordered, told)


@dataclass(eq=False, repr=False)
class MachineModel(FullModel):
    """Common part of the models of machine files: machine, recording and outputs.

    Attributes:
        machine: The machine file's content.
        data: The recording on the controller's grid.
        drives: Drives that are compared and whose parameters are free; the others move along. All
            by default.
        effects: Effects besides the nominal physics.
        fixed: Values of parameters that are not to be identified, by name.
        cutoff: Low-pass of recorded motion where it drives the model [Hz]; at most a fifth of the
            log's rate.
        scales: Of which bounds of effects are shares; by default this recording's.
        quantities: What of the drives is compared: `effort`, `position`, `velocity`; `compares`
            by default.
        weights: Factor on the errors of each quantity; 1 by default.
        signals: What is compared of which drives.
        candidates: The parameters, effects included, and their rows.

    Raises:
        IdentError: INVALID_GOAL with the remedy.
    """

    compares: ClassVar[tuple[str, ...]] = ('effort',)
    machine: Machine = field()
    data: Dataset = field()
    _: KW_ONLY
    drives: tuple[str, ...] = ()
    effects: tuple[EffectAt, ...] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)
    cutoff: float = 100.0
    scales: Scales | None = None
    quantities: Sequence[str] | None = None
    weights: Sequence[float] | None = None
    candidates: Candidates = field(init=False)

    def __post_init__(self) -> None:
        known = self.machine.drives
        self.name, self.effects = self.machine.kind, tuple(self.effects)
        self.fixed = dict(self.fixed or {})
        for name in self.drives or ():
            if name not in known:
                raise ErrorCode.INVALID_GOAL.error(
                    f'drive {name!r} is not in the machine file; choose from {", ".join(known)}'
                )
        self.drives = tuple(n for n in known if n in (self.drives or known))
        quantities = self.compares if self.quantities is None else self.quantities
        self.signals = chosen_outputs(known, self.drives, quantities, self.weights)
        # Stated for the effort only.
        self.noise = self.machine.effort_noise if 'effort' in quantities else 0.0

    @property
    def cycle(self) -> float:
        """Seconds from one instant to the next."""
        return self.data.cycle

    @property
    def travels(self) -> tuple[str, ...]:
        """(D,) unit of the drives' positions, `m` or `rad`."""
        return (self.machine.travel_unit,) * len(self.machine.drives)

    @property
    def effort_units(self) -> tuple[str, ...]:
        """(D,) unit of the drives' efforts."""
        return (self.machine.model_unit,) * len(self.machine.drives)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The free parameters, in the order of theta's columns."""
        return self.candidates.free

    def scaled(self, at: EffectAt) -> tuple[EffectParameter, ...]:
        """Return an effect's parameters with the numbers they have at a place, in their units."""
        return self.candidates.scaled(at)

    @property
    def outputs(self) -> tuple[Output, ...]:
        """Compared outputs: quantity by quantity, drive by drive within."""
        return self.signals.described(self.effort_units, self.travels)

    @functools.cached_property
    def measured(self) -> Array:
        """(O, K) measured outputs, NaN where there is no sample."""
        return self.signals.measured(self.data)

    def _begun(self, found: Mapping[str, Array]) -> Array:
        """Return (N,) parameters for a search to begin with, by (D,) estimates of some by key.

        Others are as described, absent, or in the middle of their box.
        """
        told, drives, theta = self.as_described({}), self.machine.drives, []
        for p in self.parameters:
            drive, _, name = p.name.rpartition('.')
            value = told.get(p.name, 0.5 * (p.low + p.high) if p.absent is None else p.absent)
            if name in found and drive in drives:
                value = float(found[name][drives.index(drive)])
            theta.append(min(max(value, p.low), p.high))
        return np.array(theta)
