# SPDX-License-Identifier: Apache-2.0
"""Efforts as they are compared where the recorded motion drives a model.

Measured and simulated efforts pass the same low-pass without phase, as the motion does, and as
many rows are left as it needs: identification by inverse dynamics as in Gautier, Janot,
Vandanjon, IEEE TCST 21(2), 2013, section III. Where a drive stands, what holds it is what was
measured: no motion tells its friction. Put there before the low-pass, it keeps what a model makes
of rest out of the rows beside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import functools
import math
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from ros2_ident.arrays import Array
from ros2_ident.recording.motion import fill_gaps, low_pass

Mask = npt.NDArray[np.bool_]
Whole = npt.NDArray[np.intp]

# Rows that are kept for a period of the band's end.
_KEPT = 4.0
# What is filtered are means, of at least so many blocks in a period.
_FINE = 20.0
# Of so many cycles one is looked at first where rows are compared. By hand.
_FEW = 499
# Of what a row is made of at least this share is motion.
_LEAST = 0.5


@dataclass(frozen=True, eq=False)
class Band:
    """The low-pass of a log's efforts.

    Attributes:
        cutoff: Frequency of gain one half, Hz.
        motion: That of the motion that drives the model, Hz.
        cycle: Time from cycle to cycle, s.
        logged: (O, K) efforts, NaN at cycles without a sample.
        still: (O, K) cycles at which nothing tells what an effort should be.
        doubtful: (O, K) where the motion does not decide what it should be, nowhere where False.
    """

    cutoff: float
    motion: float
    cycle: float
    logged: Array
    still: Mask
    doubtful: Mask | bool = False

    @functools.cached_property
    def _gaps(self) -> Array:
        """(O,) cycles from one sample to the next; 0 without samples."""
        steps = [np.diff(np.flatnonzero(np.isfinite(row))) for row in self.logged]
        return np.array([np.median(s) if s.size else 0.0 for s in steps])

    @property
    def passes(self) -> float:
        """Share of white noise that passes, by its standard deviation."""
        usual = max(1.0, float(self._gaps.max()))
        return float(np.sqrt(min(1.0, 2.0 * self.cutoff * self.cycle * usual)))

    @functools.cached_property
    def _filled(self) -> Array:
        """(O, K) the logged efforts without gaps; NaN where none was ever logged."""
        return np.stack([fill_gaps(row) if np.isfinite(row).any() else row for row in self.logged])

    @functools.cached_property
    def measured(self) -> Array:
        """(O, K) the logged efforts as they are compared; NaN where they are not."""
        stride = max(1, int(1.0 / (_KEPT * self.cutoff * self.cycle)))
        rows = np.zeros(self.still.shape, dtype=bool)
        rows[:, ::stride] = True
        # Of a log slower than the grid the samples lie between its cycles.
        near = [
            scipy.ndimage.maximum_filter1d(np.isfinite(row), 2 * int(0.5 * gap) + 1)
            for row, gap in zip(self.logged, self._gaps, strict=True)
        ]
        moving = self.low((~self.still).astype(float)) > _LEAST
        rows &= near & moving & ~self.still & np.logical_not(self.doubtful)
        return np.where(rows, self.low(self._filled), np.nan)

    @functools.cached_property
    def _held(self) -> Mask:
        """(O, K) rest; what is shorter than a period is a change of direction, which passes."""
        period = 2 * math.ceil(0.5 / (self.cutoff * self.cycle)) + 1
        beyond = np.pad(self.still, ((0, 0), (period, period)), constant_values=True)
        lasting = scipy.ndimage.binary_opening(beyond, np.ones((1, period)))
        return np.asarray(lasting[:, period:-period])

    def low(self, efforts: Array, cutoff: float = 0.0) -> Array:
        """Return efforts (..., O, K) below a frequency, the band's end where 0."""
        cutoff = cutoff or self.cutoff
        return self._at(self._blocks(efforts, cutoff), cutoff, np.arange(efforts.shape[-1]))

    def _blocks(self, efforts: Array, cutoff: float) -> Array:
        """Return (..., B) what is below a frequency of the means of blocks of efforts (..., K).

        What passes is as good in means, and filtered in a fraction of the time.
        """
        size = self._size(cutoff)
        if size == 1:
            return low_pass(efforts, self.cycle, cutoff)
        cycles = efforts.shape[-1]
        starts = np.arange(0, cycles, size)
        counts = np.diff(starts, append=cycles)
        return self._slow(np.add.reduceat(efforts, starts, axis=-1) / counts, cutoff)

    def _slow(self, blocks: Array, cutoff: float) -> Array:
        """Return what of the means of blocks (..., B) is below a frequency."""
        return low_pass(blocks, self._size(cutoff) * self.cycle, cutoff)

    def _at(self, blocks: Array, cutoff: float, cycles: Whole) -> Array:
        """Return (..., R) what blocks (..., B) are at some cycles (R,)."""
        if self._size(cutoff) == 1:
            return blocks[..., cycles]
        before, share = self._about(cycles, cutoff)
        out: Array = blocks[..., before]
        out += share * (blocks[..., before + 1] - out)
        return out

    def _about(self, cycles: Whole, cutoff: float) -> tuple[Whole, Array]:
        """Return (R,) the blocks before some cycles (R,), and how far these are to the next."""
        size = self._size(cutoff)
        # just short of the last block, which has no next
        most = -(-self.logged.shape[1] // size) - 1.0 - 1e-9
        at = np.clip((cycles - 0.5 * (size - 1)) / size, 0.0, most)
        before = at.astype(int)
        return before, at - before

    def _size(self, cutoff: float) -> int:
        return max(1, int(1.0 / (_FINE * cutoff * self.cycle)))

    def passed(self, efforts: Array, there: Mask) -> Array:
        """Return (S, R) what is compared of efforts (S, O, K) where `there` (O, K) holds.

        Most candidates differ on one drive only: rows that come again are filtered once.
        """
        count = np.concatenate([[0], np.cumsum(there.sum(axis=1))])
        out = np.empty((len(efforts), count[-1]))
        for o, cycles in enumerate(map(np.flatnonzero, there)):
            rows, own = efforts[:, o], out[:, count[o] : count[o + 1]]
            usual = self._usual.get(o)
            before = [] if usual is None else [usual[0]]
            first = firsts([*before, *rows])[len(before) :] - len(before)
            known = first < 0
            if usual is not None and known.any():
                own[known] = self._at(usual[1], self.cutoff, cycles)
            if not known.all():
                new, place = np.unique(first[~known], return_inverse=True)
                made = self._passed(rows[new], o)
                own[~known] = self._at(made, self.cutoff, cycles)[place]
            if not known.any():
                # The drive does something else from now on.
                most = int(np.bincount(place).argmax())
                self._usual[o] = rows[new[most]].copy(), made[[most]]
        return out

    @functools.cached_property
    def _usual(self) -> dict[int, tuple[Array, Array]]:
        """Of each output a row (K,) that came last for most candidates, and its blocks (1, B)."""
        return {}

    def _passed(self, rows: Array, o: int) -> Array:
        """Return blocks (S, B) of what passes of rows (S, K) of an output."""
        if self._with_gaps:
            means, rest = self._sampled(o)
            # Friction of a smoothed motion turns over as no effort does, and would be sampled so.
            fine = self._blocks(rows, self.motion)
            return self._slow((means @ fine.T).T + rest, self.cutoff)
        held = self._held[o] & np.isfinite(self._filled[o])
        return self._blocks(np.where(held, self._filled[o], rows), self.cutoff)

    @functools.cached_property
    def _with_gaps(self) -> bool:
        """Whether there are cycles between samples of an output."""
        counts = np.isfinite(self.logged).sum(axis=1)
        return bool(((counts > 1) & (counts < self.logged.shape[1])).any())

    def _sampled(self, o: int) -> tuple[Any, Array]:
        """Return how blocks of an output in a log with gaps come of those of the motion's band.

        By a sparse (B, F), and (B,) that is added for what was measured at rest: interpolated to
        the samples, these to the cycles between them, and averaged.
        """
        if o in self._maps:
            return self._maps[o]
        cycles = np.arange(self.logged.shape[1])
        samples = np.flatnonzero(np.isfinite(self.logged[o]))
        made = _mixed(*self._about(cycles, self.motion))
        if 1 < samples.size < cycles.size:
            at = np.clip(np.searchsorted(samples, cycles) - 1, 0, samples.size - 2)
            before, after = samples[at], samples[at + 1]
            share = np.clip((cycles - before) / (after - before), 0.0, 1.0)
            made = _mixed(at, share) @ made[samples]
        held = self._held[o] & np.isfinite(self._filled[o])
        of = cycles // self._size(self.cutoff)
        mean = scipy.sparse.csr_array((1.0 / np.bincount(of)[of], (of, cycles)))
        rest = mean @ np.where(held, self._filled[o], 0.0)
        self._maps[o] = mean.multiply(~held[None]).tocsr() @ made, rest
        return self._maps[o]

    @functools.cached_property
    def _maps(self) -> dict[int, tuple[Any, Array]]:
        """Those of `_sampled` that were made."""
        return {}


def _mixed(before: Whole, share: Array) -> Any:
    """Return (R, C), sparse, that mixes columns `before` (R,) with the next by its share (R,)."""
    rows = np.arange(before.size)
    values, at = np.concatenate([1.0 - share, share]), np.concatenate([before, before + 1])
    return scipy.sparse.csr_array((values, (np.tile(rows, 2), at)))


def firsts(rows: Sequence[Array]) -> Whole:
    """Return (S,) which of rows (K,) is the first that is the same as each.

    Where others agree with it in the few cycles looked at first, they count as new.
    """
    seen: dict[bytes, int] = {}
    found = np.arange(len(rows))
    for i, row in enumerate(rows):
        first = seen.setdefault(row[::_FEW].tobytes(), i)
        found[i] = first if np.array_equal(row, rows[first]) else i
    return found
