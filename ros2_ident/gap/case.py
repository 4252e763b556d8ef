# SPDX-License-Identifier: Apache-2.0
"""The recordings of one machine, and what any extended model makes of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ros2_ident.effects import CATALOGUE
from ros2_ident.models import DriveModel, EffectAt, Machine, make_model
from ros2_ident.models.drives.recorded import recorded_motion, RecordedMotion
from ros2_ident.recording import Dataset

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# A controller's motion has to be in the log at this share of its cycles to be replayed.
SEEN = 0.3
# Seconds at a log's start that are not compared: a machine that has stood still holds forces no
# model knows.
SETTLE = 0.1
# Seconds at a log's start at which a delayed effort does not yet belong to the motion beside it.
LAW_SETTLE = 0.15


@dataclass(frozen=True)
class Part:
    """Some recordings and which of their samples are compared.

    Attributes:
        data: The recordings.
        masks: For each, (D, K) where a sample is compared.
        seen: For each, the motion that its controllers saw; empty where they cannot be checked.
        law_masks: For each of these, (D, K) where its effort is compared with the controllers'.
    """

    data: tuple[Dataset, ...]
    masks: tuple[Mask, ...]
    seen: tuple[RecordedMotion, ...] = ()
    law_masks: tuple[Mask, ...] = ()

    @property
    def drive(self) -> npt.NDArray[np.int64]:
        """(R,) the drive of each value that `residual` returns."""
        parts = [np.full(int(row.sum()), d) for mask in self.masks for d, row in enumerate(mask)]
        out: npt.NDArray[np.int64] = np.concatenate(parts)
        return out

    def rows(self, values: Array) -> Array:
        """Return a residual as (D, K), recordings side by side, NaN where nothing is compared."""
        parts = []
        at = 0
        for mask in self.masks:
            out = np.full(mask.shape, np.nan)
            for d, row in enumerate(mask):
                count = int(row.sum())
                out[d, row] = values[at : at + count]
                at += count
            parts.append(out)
        return np.concatenate(parts, axis=1)

    @property
    def starts(self) -> tuple[int, ...]:
        """Columns of `rows` at which a recording begins, besides the first."""
        widths = np.cumsum([mask.shape[1] for mask in self.masks])
        return tuple(int(w) for w in widths[:-1])

    def residual(self, models: Sequence[DriveModel], theta: Array) -> Array:
        """Return (S, R) measured less simulated output of (S, N) candidates."""
        parts = []
        for model, mask in zip(models, self.masks, strict=True):
            simulated = model.simulate_at(theta, mask)
            parts.append(np.subtract(model.measured[mask], simulated, out=simulated))
        return np.concatenate(parts, axis=1) if len(parts) > 1 else parts[0]

    @property
    def law_drive(self) -> npt.NDArray[np.int64]:
        """(L,) the drive of each value that `law_residual` returns."""
        parts = [
            np.full(int(row.sum()), d) for mask in self.law_masks for d, row in enumerate(mask)
        ]
        out: npt.NDArray[np.int64] = np.concatenate(parts or [np.empty(0, np.int64)])
        return out

    def law_residual(self, models: Sequence[DriveModel], theta: Array) -> Array:
        """Return (S, L) measured effort less what the controllers make of the recorded motion.

        A controller's effort is known but for a constant, so the mean of each drive is zero.
        """
        parts = [np.empty((len(theta), 0))]
        for model, mask, seen in zip(models, self.law_masks, self.seen, strict=False):
            rest = model.measured[mask] - model.replay_law(seen, theta, mask)
            ends = np.cumsum(mask.sum(axis=1))
            for row in np.split(rest, ends[:-1], axis=1):
                parts.append(row - row.mean(axis=1, keepdims=True))
        return np.concatenate(parts, axis=1)


def _settled(data: Dataset, drives: Sequence[str]) -> Mask:
    rows = [data.names.index(name) for name in drives]
    assert data.effort is not None
    there: Mask = ~np.isnan(data.effort[rows])
    there[:, : int(round(SETTLE / data.cycle))] = False
    return there


def _seen(machine: Machine, data: Sequence[Dataset]) -> tuple[RecordedMotion, ...]:
    """Return what controllers saw; nothing unless all drives' motion was recorded everywhere."""
    complete = all(
        d.command_position is not None
        and d.position is not None
        and (np.isfinite(d.position).sum(axis=1) > SEEN * d.cycles).all()
        for d in data
    )
    return tuple(recorded_motion(d, machine.drives) for d in data) if complete else ()


def _part(
    data: Sequence[Dataset], masks: Sequence[Mask], seen: tuple[RecordedMotion, ...]
) -> Part:
    later = [mask.copy() for mask in masks[: len(seen)]]
    for d, mask in zip(data, later, strict=False):
        mask[:, : int(round(LAW_SETTLE / d.cycle))] = False
    return Part(tuple(data), tuple(masks), seen, tuple(later))


def split(
    machine: Machine,
    fit: Sequence[Dataset],
    check: Sequence[Dataset],
    drives: Sequence[str],
    block: float = 1.0,
) -> tuple[Part, Part, str]:
    """Return what to fit on, what to hold out, and how it was split.

    Without a check recording every second block of the fit recordings is held out. The simulation
    runs through; only the comparison is split, with a tenth of a block between them left out.

    Args:
        machine: The machine.
        fit: Recordings to fit on.
        check: Recordings held out, or none.
        drives: The drives compared.
        block: Length of a block [s].

    Returns:
        The two parts, and `check bag` or `blocks`.
    """
    masks = tuple(_settled(data, drives) for data in fit)
    if check:
        held = tuple(_settled(data, drives) for data in check)
        parts = _part(fit, masks, _seen(machine, fit)), _part(check, held, _seen(machine, check))
        return *parts, 'check bag'
    even, odd = [], []
    for data, mask in zip(fit, masks, strict=True):
        phase = np.arange(mask.shape[1]) * data.cycle / block
        inside = phase % 1.0 < 0.9
        second = np.floor(phase) % 2 == 1
        even.append(mask & (inside & ~second))
        odd.append(mask & (inside & second))
    seen = _seen(machine, fit)
    return _part(fit, even, seen), _part(fit, odd, seen), 'blocks'


class Case:
    """One machine's recordings: those to fit on, and those held out.

    Args:
        machine: The machine.
        fit: Recordings for fitting, on the controller's grid.
        check: Recordings held out; empty for none.
        drives: The drives compared; all by default.
        fixed: Parameters not to be identified.
    """

    def __init__(
        self,
        machine: Machine,
        fit: Sequence[Dataset],
        check: Sequence[Dataset] = (),
        *,
        drives: Sequence[str] | None = None,
        fixed: Mapping[str, float] | None = None,
    ) -> None:
        self.machine = machine
        self.fixed = dict(fixed or {})
        self.drives = tuple(drives or machine.drives)
        self.fit, self.check, self.held_out = split(machine, fit, check, self.drives)

    def models(self, effects: Sequence[EffectAt], part: Part) -> list[DriveModel]:
        """Return the model with these effects on each recording of a part."""
        return [
            make_model(self.machine, data, drives=self.drives, effects=effects, fixed=self.fixed)
            for data in part.data
        ]

    def candidates(self, without: Sequence[str] = (), known: Sequence[str] = ()) -> list[EffectAt]:
        """Return every effect at every place it can sit in this machine.

        Args:
            without: Effects to leave out.
            known: Ids to choose from; all by default.
        """
        context = self.models((), self.fit)[0].context
        out = []
        for effect in CATALOGUE.values():
            left_out = effect.id in without or (known and effect.id not in known)
            if left_out or not effect.applies(context):
                continue
            places = self.drives if effect.place == 'drive' else ('all',)
            out += [EffectAt(effect.id, where) for where in places]
        return out
