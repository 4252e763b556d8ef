# SPDX-License-Identifier: Apache-2.0
"""Samples that jump away from those around them and back: wrong bits, lost digits, bad packets.

A sample that a cubic through its neighbours misses by many times what it misses those by,
for a few milliseconds, is nothing that a machine does. Such samples are left out, like samples
that never came: left in, a set-point one millimetre off for one cycle moves friction by percents.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from ros2_ident.recording.streams import FIELDS, FloatArray, IntArray

# Samples on each side that a cubic is laid through, and those between that are judged by it.
_SIDE, _JUDGED = 10, 3
# Longer than this from the sample before to the one after, s, it may have been so.
_SHORT = 0.025
# More of them, and more than this share, are how the signal is.
_MANY, _MANY_SHARE = 20, 0.002
# So many samples tell the range and the resolution of a signal.
_ENOUGH = 1 << 15


class _Rule(NamedTuple):
    """Thresholds of a jump of one kind of signal."""

    run: int  # samples that may jump in a row
    ratio: float  # so many times farther off than the worst of the samples around
    share: float  # of the signal's range, which is no jump
    slip: float  # sampling periods by which a stamp may be off: a fast motion is no jump


# A set-point is exact, a position nearly so; velocities and efforts are rough by themselves.
_EXACT, _FINE, _ROUGH = (
    _Rule(3, 8.0, 1e-4, 0.0), _Rule(3, 8.0, 1e-4, 1.0), _Rule(1, 12.0, 0.05, 1.0),
)  # fmt: skip
# A jump's neighbours are off by this share of it at most.
_ALONE = 0.2
# So many steps of a signal's resolution are no jump either.
_STEPS, _FEW = 4.0, 9


def _lone(stamp: IntArray, values: FloatArray, rule: _Rule) -> tuple[IntArray, float]:
    """Return the samples (N,) of a signal (T,) that jump away and back, and the largest jump.

    None where they last as long as a machine could move, or are so many that the signal is like
    that.
    """
    none = np.empty(0, dtype=np.int64), 0.0
    there = np.flatnonzero(np.isfinite(values))
    if there.size < 2 * _SIDE + 1:
        return none
    whole = there.size == values.size
    x, time = (values, stamp) if whole else (values[there], stamp[there])
    least = _floor(x, rule)
    found = _candidates(x, rule, least)
    most = max(_MANY, int(_MANY_SHARE * x.size))
    if found.size > 20 * most:
        return none
    rows: list[int] = []
    largest, longest = 0.0, 0.0
    for at in found.tolist():
        if rows and at <= rows[-1] + _JUDGED:
            continue
        run, size = _run_at(time, x, at, rule, least)
        if run:
            rows += run
            largest = max(largest, size)
            longest = max(longest, float(time[run[-1] + 1] - time[run[0] - 1]) * 1e-9)
    if not rows or len(rows) > most or longest > _SHORT:
        return none
    return there[np.array(rows)], largest


def _floor(x: FloatArray, rule: _Rule) -> float:
    """Return the least that is a jump: a few steps of the resolution, some of the range."""
    few = x[:: max(1, x.size // _ENOUGH)]
    low, high = np.quantile(few, (0.005, 0.995))
    steps = np.abs(np.diff(x[:_ENOUGH]))
    steps = steps[steps > 0.0]
    if steps.size < _FEW:  # it stands still: a set-point has no resolution then, an encoder may
        step = 0.0 if rule is _EXACT else float(steps.max(initial=0.0))
    else:
        step = float(np.quantile(steps, 0.01))
    return max(_STEPS * step, rule.share * float(high - low), 1e-300)


def _candidates(x: FloatArray, rule: _Rule, least: float) -> IntArray:
    """Return where a cubic through two samples on each side is far off, and not so beside it."""
    far = 8
    # a run of samples shows half its jump at its edges
    part_of = 1.0 if rule.run == 1 else 0.4
    off = np.zeros(x.size + 2 * far)
    with np.errstate(over='ignore', invalid='ignore'):
        outer, inner = x[:-4] + x[4:], x[1:-3] + x[3:-1]
        off[far + 2 : far + x.size - 2] = np.abs(x[2:-2] - (4.0 * inner - outer) / 6.0)
    rows = np.flatnonzero(off[far:-far] > part_of * least)
    nearby = scipy.ndimage.maximum_filter1d(off, 3)
    beside = np.maximum(nearby[far - 7 + rows], nearby[far + 7 + rows])
    return np.asarray(rows[off[far + rows] > part_of * 0.8 * rule.ratio * beside])


def _run_at(
    time: IntArray, x: FloatArray, at: int, rule: _Rule, least: float
) -> tuple[list[int], float]:
    """Return the samples of a lone jump near a place, none where it is none, and its size."""
    begin, end = max(0, at - _JUDGED), min(x.size, at + _JUDGED + 1)
    low, high = max(0, begin - _SIDE), min(x.size, end + _SIDE)
    if begin - low < 4 or high - end < 4:
        return [], 0.0
    around = np.r_[low:begin, end:high]
    when = (time[low:high] - time[at]) / max(float(time[high - 1] - time[low]), 1.0)
    powers = when[:, None] ** np.arange(4)
    with np.errstate(over='ignore', invalid='ignore'):
        cubic = np.linalg.lstsq(powers[around - low], x[around], rcond=None)[0]
        off = np.abs(x[low:high] - powers @ cubic)
        steps = np.diff(when)
        usual = float(np.median(steps))
        slip = rule.slip * usual + float(np.abs(steps - usual).max())
        rest = float(off[around - low].max())
        bound = max(rule.ratio * rest, least, abs(float(cubic[1])) * slip)
    wrong = np.flatnonzero(off[begin - low : end - low] > bound) + begin
    if not np.isfinite(bound) or not 0 < wrong.size <= rule.run:
        return [], 0.0
    if wrong[-1] - wrong[0] >= rule.run or wrong[0] < 1 or wrong[-1] >= x.size - 1:
        return [], 0.0
    size = float(off[wrong - low].max())
    # a blow rings on, an oscillation sets in: only what leaves its neighbours alone is no motion
    off[wrong - low] = 0.0
    if float(off[begin - low : end - low].max()) > _ALONE * size:
        return [], 0.0
    return wrong.tolist(), size


def leave_out(
    role: str, stamp: IntArray, names: Sequence[str], fields: Sequence[FloatArray | None]
) -> list[str]:
    """Set the lone jumps of a stream to NaN, in place.

    Args:
        role: `state`, `effort` or `command`.
        stamp: Stamps (T,), ns, increasing.
        names: The D joints.
        fields: Position, velocity and effort, each (T, D) or None.

    Returns:
        What was found, one sentence for each signal.
    """
    said = []
    for field, values in zip(FIELDS, fields, strict=True):
        if values is None or (role, field) == ('command', 'effort'):
            continue  # a feedforward may be anything, and is not used
        for column, name in enumerate(names):
            signal = values[:, column]
            what = f'{role}: {field} of {name}'
            rule = _EXACT if role == 'command' else _FINE if field == 'position' else _ROUGH
            rows, size = _lone(stamp, signal, rule)
            if rows.size:
                signal[rows] = np.nan
                few = 'a sample' if rows.size == 1 else f'{rows.size} samples'
                at = (stamp[rows[0]] - stamp[0]) * 1e-9
                where = f'jumps by up to {size:.3g} and back in {few}, first at {at:.4f} s'
                said.append(f'{what} {where}; that is no motion and is left out')
    return said
