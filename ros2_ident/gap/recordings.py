# SPDX-License-Identifier: Apache-2.0
"""The recordings of one machine, and the residuals of any extended model on them."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
import copy
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache, partial
import shlex

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.gates.scale import LATEST_EFFORT
from ros2_ident.identify.data import chosen_drives
from ros2_ident.identify.hidden import BLOCK, SETTLE, settled
from ros2_ident.identify.layout import Conditions, held_of, Layout
from ros2_ident.machine.machine import Machine
from ros2_ident.models import complete, EffectAt, FullModel, make_model, Model
from ros2_ident.models.protocol import RecordedMotion
from ros2_ident.models.registry import compared_of, kind_of, scales_of
from ros2_ident.recording import Dataset

Mask = npt.NDArray[np.bool_]

# Extended models of a part that are kept: those of the rounds go on being asked for. By hand.
_KEPT = 16
# Values of a drive that a part has at least, where a band of the recorded motion is compared. By
# hand.
_FEWEST = 10


def recordings_of(
    machine: Machine,
    data: Sequence[Dataset],
    *,
    drives: Sequence[str] | None = None,
    fixed: Mapping[str, float] | None = None,
    effects: Sequence[EffectAt] = (),
    output: str | None = None,
    labels: Sequence[str] = (),
    beside: Sequence[Dataset] = (),
) -> 'Part':
    """Return a machine's nominal model on each recording.

    Args:
        data: The recordings, on the controller's grid.
        drives: The drives compared; all by default.
        fixed: Parameters that are held; `gear_stiffness` means that of every drive.
        effects: Effects that belong to the nominal model.
        output: Quantity that is compared: `effort`, `position` or `velocity`; what the machine's
            kind compares where None.
        labels: For each recording, the bag it came from.
        beside: The machine's other recordings: what drives do on them bounds effects, too.

    Raises:
        IdentError: As `make_model`; INVALID_GOAL where a kind compares more than one quantity.
    """
    scales = scales_of(machine, [*data, *beside])
    # Of two the effort: what controllers do, and when, hardly shows in a position.
    compared = compared_of(machine)
    quantities = (output or ('effort' if 'effort' in compared else compared[0]),)
    make = partial(
        make_model, machine, drives=drives, effects=effects, scales=scales, quantities=quantities
    )
    if data and (fixed or machine.prior):
        free = make(data[0])
        fixed = held_of(machine, free, chosen_drives(machine, drives), fixed or {})
    models = [make(d, fixed=fixed) for d in data]
    _one_output_a_drive(models)
    return Part(tuple(models), tuple(labels))


def recordings_from(models: Model | Sequence[Model]) -> 'Part':
    """Return a user's own models, one a recording.

    Raises:
        IdentError: INVALID_GOAL where one is no model, or compares more than one quantity.
    """
    several = tuple(complete(m) for m in (models if isinstance(models, Sequence) else [models]))
    _one_output_a_drive(several)
    return Part(several)


def _one_output_a_drive(models: Sequence[FullModel]) -> None:
    for model in models:
        if len(model.outputs) != len(model.places):
            raise ErrorCode.INVALID_GOAL.error(
                f'a {model.name} compares {len(model.outputs)} outputs of '
                f'{len(model.places)} drives; a diagnosis takes one of each: name it (`output`)'
            )


class JointModel(Layout):
    """A model with some effects on every recording of a part, as one fit.

    The parameters of the effects are the last ones.

    Attributes:
        effects: The effects, in the order of their parameters.
    """

    def __init__(self, part: 'Part', effects: Sequence[EffectAt]) -> None:
        self.effects = tuple(effects)
        models = [m.extended((*m.effects, *self.effects)) for m in part.models]
        super().__init__(models, part.labels, part.conditions)
        self._part = part

    def without(self, theta: Array, effects: Sequence[EffectAt]) -> Array:
        """Return (N,) parameters at which some of the effects vanish: their sizes neutral."""
        own = [(at, p) for at in self.effects for p in self.models[0].scaled(at)]
        out = theta.copy()
        for column, (at, p) in enumerate(own, len(theta) - len(own)):
            if at in effects and p.role == 'size':
                out[column] = p.neutral
        return out

    def residual(self, theta: Array) -> Array:
        """Return (S, R) measured less simulated output of (S, N) candidates."""
        parts = []
        for number, (model, mask) in enumerate(zip(self.models, self._part.masks, strict=True)):
            simulated = model.simulate_at(self.own(number, theta), mask)
            parts.append(np.subtract(model.measured[mask], simulated, out=simulated))
        return np.concatenate(parts, axis=1) if len(parts) > 1 else parts[0]

    def law_residual(self, theta: Array) -> Array:
        """Return (S, L) measured effort less that of the controllers on the recorded motion.

        A controller's effort is known but for a constant, so the mean of each drive is zero.
        """
        theta = np.atleast_2d(theta)
        parts = [np.empty((len(theta), 0))]
        part = self._part
        for number, (mask, seen) in enumerate(zip(part.law_masks, part.seen, strict=True)):
            model = self.models[number]
            rest = model.replayed[mask] - model.replay_law(seen, self.own(number, theta), mask)
            ends = np.cumsum(mask.sum(axis=1))
            for row in np.split(rest, ends[:-1], axis=1):
                parts.append(row - row.mean(axis=1, keepdims=True))
        return np.concatenate(parts, axis=1)


@dataclass(frozen=True, eq=False)
class Part:
    """Some recordings and which of their samples are compared.

    Attributes:
        models: Their nominal models.
        labels: For each, the bag it came from; empty where there is one only.
        masks: For each, (D, K) where a sample is compared; empty before a split has chosen.
        conditions: How the recordings differ.
    """

    models: tuple[FullModel, ...]
    labels: tuple[str, ...] = ()
    masks: tuple[Mask, ...] = ()
    conditions: Conditions = Conditions()

    def __add__(self, other: 'Part') -> 'Part':
        """Return the recordings of both."""
        labels = self.labels + other.labels if self.labels and other.labels else ()
        return Part(self.models + other.models, labels)

    def __getstate__(self) -> dict[str, object]:
        """Leave out cached values."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @cached_property
    def _joints(self) -> Callable[[tuple[EffectAt, ...]], JointModel]:
        return lru_cache(_KEPT)(partial(JointModel, self))

    def with_effects(self, effects: Sequence[EffectAt]) -> JointModel:
        """Return the models with these effects."""
        return self._joints(tuple(effects))

    @cached_property
    def seen(self) -> tuple[RecordedMotion, ...]:
        """For each, the motion that its controllers saw; empty unless all was recorded."""
        seen = tuple(x for m in self.models if (x := m.recorded_motion()) is not None)
        return seen if len(seen) == len(self.models) else ()

    @cached_property
    def law_masks(self) -> tuple[Mask, ...]:
        """For each of `seen`, (D, K) where its effort is compared with the controllers'."""
        out = []
        for model, mask in zip(self.models[: len(self.seen)], self.masks, strict=False):
            # At its start a delayed effort does not yet belong to the motion beside it.
            later = mask & np.isfinite(model.replayed)
            later[:, : int(round(LATEST_EFFORT / model.cycle))] = False
            out.append(later)
        return tuple(out)

    @cached_property
    def drive(self) -> npt.NDArray[np.int64]:
        """(R,) the drive of each value that `JointModel.residual` returns."""
        return _drives_of(self.masks)

    @cached_property
    def law_drive(self) -> npt.NDArray[np.int64]:
        """(L,) the drive of each value that `JointModel.law_residual` returns."""
        return _drives_of(self.law_masks)

    def rows(self, values: Array) -> Array:
        """Return a residual as (D, K), recordings side by side, NaN where nothing is compared."""
        out = [np.full(mask.shape, np.nan) for mask in self.masks]
        ends = np.cumsum([mask.sum() for mask in self.masks])
        for row, mask, own in zip(out, self.masks, np.split(values, ends[:-1]), strict=True):
            row[mask] = own
        return np.concatenate(out, axis=1)

    def measured(self, drive: int) -> list[Array]:
        """Return a drive's measured output where it is compared, by recording."""
        both = zip(self.models, self.masks, strict=True)
        return [model.measured[drive, mask[drive]] for model, mask in both]

    @property
    def starts(self) -> tuple[int, ...]:
        """Columns of `rows` at which a recording begins, besides the first."""
        return tuple(np.cumsum([mask.shape[1] for mask in self.masks])[:-1].tolist())


def are_alike(model: FullModel) -> bool:
    """Whether all drives of a model's machine are of one make."""
    return model.machine is not None and kind_of(model.machine).alike


def _drives_of(masks: Sequence[Mask]) -> npt.NDArray[np.int64]:
    return np.concatenate([np.empty(0, np.int64), *(np.nonzero(mask)[0] for mask in masks)])


class Split:
    """One machine's recordings: those to fit on, and those held out.

    Args:
        fit: Recordings for fitting.
        check: Recordings held out; where None, every second block, of a second, of the others is.
        conditions: How the recordings differ.

    Attributes:
        drives: The drives compared.
        noise: Standard deviation of the outputs' noise as stated.
        fit: What is fitted on.
        check: What is held out.
        whole: All recordings with all samples.
        held_out: `check bag` or `blocks`.
    """

    def __init__(
        self,
        fit: Part,
        check: Part | None = None,
        conditions: Conditions | None = None,
    ) -> None:
        check, differ = check or Part(()), conditions or Conditions()
        self._given = fit, check, conditions
        self.drives = fit.models[0].places
        self.noise = fit.models[0].noise

        def part(of: Part, masks: Sequence[Mask]) -> Part:
            return Part(of.models, of.labels, tuple(masks), differ)

        masks = [settled(m) for m in fit.models]
        if check.models:
            self.held_out = 'check bag'
            self.fit = part(fit, masks)
            self.check = part(check, [settled(m) for m in check.models])
        else:
            self.held_out = 'blocks'
            even, odd = [], []
            for model, mask in zip(fit.models, masks, strict=True):
                # The simulation runs through; only the comparison is split, with a gap between.
                time = np.arange(mask.shape[1]) * model.cycle
                inside, second = mask & (time % BLOCK < BLOCK - SETTLE), time // BLOCK % 2 == 1
                even.append(inside & ~second)
                odd.append(inside & second)
            self.fit = part(fit, even)
            self.check = part(fit, odd)
        self._require_rows()
        both = fit + check if check.models else fit
        self.whole = part(both, [settled(m) for m in both.models])

    def _require_rows(self) -> None:
        """Refuse a log of which a drive's recorded motion leaves too little to compare."""
        for part in (self.fit, self.check):
            counts = np.bincount(part.drive, minlength=len(self.drives))
            if part.models[0].thinned and counts.min() < _FEWEST:
                told = zip(self.drives, counts, strict=True)
                others = ','.join(name for name, count in told if count >= _FEWEST)
                way = f'leave it out (--drives {shlex.quote(others)}), or ' if others else ''
                raise ErrorCode.NO_DATA.error(
                    f'{self.drives[int(counts.argmin())]} moves too little for the rate of its '
                    f'log: {counts.min()} values are left beside rest and turns; {way}record '
                    'longer moves, or at a higher rate'
                )

    def carrying(self, held: Sequence[Array]) -> 'Split':
        """Return the split whose models know when a payload is carried.

        Args:
            held: For each recording of `whole`, (K,) the share of it that is carried.
        """
        models = self.whole.models
        return self._of([m.carrying(h) for m, h in zip(models, held, strict=True)])

    def decided(self, theta: Array, noise: Array) -> 'Split':
        """Return the split without samples whose effort depends on how the motion was smoothed.

        Args:
            theta: (N,) a nominal fit.
            noise: (D,) noise of each drive.
        """
        joint = self.whole.with_effects(())
        models = [m.decided(own, noise) for m, own in joint.each(theta)]
        if all(new is old for new, old in zip(models, joint.models, strict=True)):
            return self
        with suppress(IdentError):
            return self._of(models)
        return self

    @property
    def check_bag(self) -> bool:
        """Whether recordings of their own are held out."""
        return bool(self._given[1].models)

    def by_blocks(self) -> 'Split':
        """Return the split of all recordings whose blocks take turns."""
        fit, check, conditions = self._given
        return Split(fit + check, conditions=conditions)

    def together(self) -> 'Split':
        """Return the split that is fitted on the blocks held out as well."""
        other = copy.copy(self)
        other.fit = self.whole
        return other

    def stating(self, name: str, value: float) -> 'Split':
        """Return the split whose machine file states another number."""
        return self._of([m.stating(name, value) for m in self.whole.models])

    def _of(self, models: Sequence[FullModel]) -> 'Split':
        fit, check, conditions = self._given
        count = len(fit.models)
        return Split(
            replace(fit, models=tuple(models[:count])),
            replace(check, models=tuple(models[count:])),
            conditions,
        )

    def candidates(self, without: Sequence[str] = ()) -> list[EffectAt]:
        """Return every effect, but for those left out or known, at every place it can sit."""
        model = self.fit.models[0]
        return [
            at for at in model.extensions()
            if at.effect not in without and at not in model.effects
        ]  # fmt: skip
