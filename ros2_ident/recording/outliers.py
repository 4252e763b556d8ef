# SPDX-License-Identifier: Apache-2.0
"""Samples that jump away from those around them and back: wrong bits, lost digits, bad packets.

A sample that a cubic through its neighbours misses by many times what it misses those by,
for a few milliseconds, is nothing that a machine does. Such samples are left out, like samples
that never came: left in, a set-point one millimetre off for one cycle moves friction by percents.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ros2_ident.recording.streams import FIELDS, FloatArray, IntArray

# Samples on each side that a cubic is laid through, and those between that are judged by it.
_SIDE, _JUDGED = 10, 3
# Longer than this from the sample before to the one after, s, it may have been so.
_SHORT = 0.025
# More of them, and more than this share, are how the signal is.
_MANY, _MANY_SHARE = 20, 0.002
# So many samples tell the range and the resolution of a signal.
_ENOUGH = 1 << 15
# Values and places taken at once, which a processor's cache holds.
_BLOCK, _BATCH = 1 << 15, 1 << 10


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


def _lone(
    stamp: IntArray, x: FloatArray, rule: _Rule, found: IntArray, least: float
) -> tuple[IntArray, float]:
    """Return the samples (N,) of a signal (T,) that jump away and back, and the largest jump.

    None where they last as long as a machine could move, or are so many that the signal is like
    that.

    Args:
        found: Where they may be, increasing.
        least: What is no jump.
    """
    rows: list[int] = []
    largest, longest = 0.0, 0.0
    most = max(_MANY, int(_MANY_SHARE * x.size))
    if found.size > 20 * most:
        found = found[:0]
    left = np.minimum(found - _JUDGED, _SIDE)
    right = np.minimum(x.size - 1 - _JUDGED - found, _SIDE)
    wrong, size = np.zeros((found.size, 2 * _JUDGED + 1), dtype=bool), np.zeros(found.size)
    for sides in {*zip(left.tolist(), right.tolist(), strict=True)}:
        own = np.flatnonzero((left == sides[0]) & (right == sides[1]))
        for part in np.split(own, range(_BATCH, own.size, _BATCH)) if min(sides) >= 4 else []:
            wrong[part], size[part] = _judged(stamp, x, found[part], sides, rule, least)
    for n in np.flatnonzero(wrong.any(axis=1)).tolist():
        run = (found[n] - _JUDGED + np.flatnonzero(wrong[n])).tolist()
        if not rows or found[n] > rows[-1] + _JUDGED:
            rows += run
            largest = max(largest, float(size[n]))
            longest = max(longest, float(stamp[run[-1] + 1] - stamp[run[0] - 1]) * 1e-9)
    if len(rows) > most or longest > _SHORT:
        return found[:0], 0.0
    return np.array(rows, dtype=np.int64), largest


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


def _candidates(x: FloatArray, rule: _Rule, least: FloatArray) -> tuple[IntArray, IntArray]:
    """Return where a cubic through two samples on each side is far off, and not so beside it.

    Args:
        x: Signals (T, D).
        least: What is no jump of each (D,).

    Returns:
        Samples (N,), increasing, and their signals; none with a NaN among the samples around.
    """
    far, (size, joints) = 8, x.shape
    # a run of samples shows half its jump at its edges
    part_of = 1.0 if rule.run == 1 else 0.4
    block = max(_BLOCK // joints, 4 * far)
    found = [(np.empty(0, dtype=np.int64),) * 2]
    for begin in range(2, size - 2, block):
        end = min(begin + block, size - 2)
        low, high = max(2, begin - far), min(size - 2, end + far)
        part = x[low - 2 : high + 2]
        inner, outer = part[1:-3] + part[3:-1], part[:-4] + part[4:]
        inner *= 4.0
        inner -= outer
        inner /= 6.0
        off = np.zeros((end - begin + 2 * far, joints))
        np.subtract(part[2:-2], inner, out=inner)
        np.abs(inner, out=off[low - begin + far : high - begin + far])
        nearby = np.maximum(off[:-1], off[1:])
        nearby = np.maximum(nearby[:-1], off[2:], out=nearby[:-1])
        beside = np.maximum(nearby[: end - begin], nearby[2 * far - 2 :])
        beside *= part_of * 0.8 * rule.ratio
        off = off[far:-far]
        rows, columns = np.nonzero((off > part_of * least) & (off > beside))
        found.append((rows + begin, columns))
    rows, columns = map(np.concatenate, zip(*found, strict=True))
    return rows, columns


def _judged(
    time: IntArray, x: FloatArray, at: IntArray, sides: tuple[int, int], rule: _Rule, least: float
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Return which samples around some places (N,) are a lone jump (N, 7), and its size (N,).

    A cubic through so many samples on both sides says where they should be: a sum of polynomials
    orthogonal on these (Forsythe, 1957), each from the two before.
    """
    left, right = sides
    middle = slice(left, left + 2 * _JUDGED + 1)
    place = at[:, None] + np.arange(-left - _JUDGED, _JUDGED + right + 1)
    y, when = x[place], (time[place] - time[at][:, None]).astype(np.float64)
    when /= np.maximum(when[:, -1:] - when[:, :1], 1.0)
    steps = np.diff(when)
    usual = np.median(steps, axis=1)
    slip = rule.slip * usual + np.abs(steps - usual[:, None]).max(axis=1)
    slope, last, last_rate, last_norm = np.zeros((4, at.size, 1))
    now, rate = np.ones_like(when), np.zeros_like(slope)
    for _ in range(4):  # a cubic has four
        around = now.copy()
        around[:, middle] = 0.0
        norm = _product(around, around)
        share = _product(around, y) / norm
        y = y - share * now
        slope += share * rate
        shift = _product(around * when, around) / norm
        back = norm / last_norm if last_norm.any() else last_norm
        here = now[:, left + _JUDGED, None]
        last, now = now, (when - shift) * now - back * last
        last_rate, rate = rate, here - shift * rate - back * last_rate
        last_norm = norm
    off = np.abs(y)
    judged = off[:, middle].copy()
    off[:, middle] = 0.0
    bound = np.maximum(np.maximum(rule.ratio * off.max(axis=1), least), np.abs(slope[:, 0]) * slip)
    wrong = (judged > bound[:, None]) & np.isfinite(bound[:, None])
    first, final = wrong.argmax(axis=1), 2 * _JUDGED - wrong[:, ::-1].argmax(axis=1)
    size = np.where(wrong, judged, 0.0).max(axis=1)
    # a blow rings on, an oscillation sets in: only what leaves its neighbours alone is no motion
    alone = np.where(wrong, 0.0, judged).max(axis=1) <= _ALONE * size
    return wrong & (alone & (final - first < rule.run))[:, None], size


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum('nw,nw->n', a, b)[:, None])


def _found(
    stamp: IntArray, values: FloatArray, rule: _Rule
) -> Iterator[tuple[int, IntArray, float]]:
    """Yield the signals of a field (T, D) that jump, where they do (N,), and the largest jump."""
    if stamp.size < 2 * _SIDE + 1:
        return
    whole = np.isfinite(values.sum(axis=0))
    pairs = zip(values.T, whole, strict=True)
    least = np.array([_floor(x, rule) if y else np.inf for x, y in pairs])
    at, of = _candidates(values, rule, least)
    for column, x in enumerate(values.T):
        if whole[column]:
            yield column, *_lone(stamp, x, rule, at[of == column], float(least[column]))
            continue
        there = np.flatnonzero(np.isfinite(x))
        if there.size > 2 * _SIDE:
            x, least_of = x[there], _floor(x[there], rule)
            own, _ = _candidates(x[:, None], rule, np.array([least_of]))
            rows, size = _lone(stamp[there], x, rule, own, least_of)
            yield column, there[rows], size


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
        rule = _EXACT if role == 'command' else _FINE if field == 'position' else _ROUGH
        for column, rows, size in _found(stamp, values, rule):
            if rows.size:
                values[rows, column] = np.nan
                few = 'a sample' if rows.size == 1 else f'{rows.size} samples'
                at = (stamp[rows[0]] - stamp[0]) * 1e-9
                where = f'jumps by up to {size:.3g} and back in {few}, first at {at:.4f} s'
                text = f'{role}: {field} of {names[column]} {where}; that is no motion and is left'
                said.append(f'{text} out')
    return said
