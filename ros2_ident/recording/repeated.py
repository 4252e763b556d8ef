# SPDX-License-Identifier: Apache-2.0
"""Samples that are no measurement: frozen, held, a register's bits, or another quantity."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ros2_ident.recording.streams import FloatArray, Recording

# By hand: an effort that stays for so long, s, while the drive goes so far, as a share of its
# stroke, was not measured; a coarse one (SO-101: 6.5 mA) stays for up to 0.8 s.
_LONG, _FAR = 1.0, 0.5
# By hand: values are held where those that last so many samples, at least, all last as long; a
# coarse encoder's last the shorter the faster it turns.
_HELD, _EVEN = 3, 0.15
# A digital signal is another one to its last digit.
_SAME = 1e-6
# Feetech and Dynamixel registers: ten bits of size, the eleventh is the direction.
_SIGN_BIT = 1024


def repeats(recording: Recording, name: str) -> Iterator[tuple[str, str]]:
    """Yield (code, sentence) for what is no measurement of a joint of measured positions."""
    state, effort = recording.state, recording.effort or recording.state
    place = state.column('position', name) if state else None
    values = effort.column('effort', name) if effort else None
    if state is None or place is None or effort is None or values is None:
        return
    if not np.isfinite(values).all() or np.ptp(values) == 0.0:
        return
    seconds = (effort.stamp - recording.begin) * 1e-9
    moved = np.interp(effort.stamp, state.stamp, place)
    frozen = []
    for a, b in _runs(values):
        long = seconds[b - 1] - seconds[a] > _LONG
        if long and np.abs(np.diff(moved[a:b])).sum() > _FAR * np.ptp(moved):
            frozen.append(f'{values[a]:.4g} from {seconds[a]:.3g} to {seconds[b - 1]:.3g} s')
    if frozen:
        text = f'the effort is {" and ".join(frozen[:3])} while the drive moves, so it was not '
        yield 'effort_frozen', f'{text}measured there; cut the log, or leave these cells empty'
    for what, own, stamp in (
        ('position', place, state.stamp),
        ('effort', values, effort.stamp),
    ):
        if held := _holding(own, stamp, rising=what == 'position'):
            text = f'each {what} stays for {1e3 * held:.3g} ms, as of a bus that is read at '
            yield 'held', f'{text}{1.0 / held:.3g} Hz; log each value once, when it is read'
    command = recording.command
    if command is not None and (goal := command.column('position', name)) is not None:
        apart = np.interp(effort.stamp, command.stamp, goal) - moved
        scale = float(apart @ values) / (float(apart @ apart) or 1.0)
        if np.abs(values - scale * apart).max() <= _SAME * np.abs(values).max():
            text = f'the effort is {scale:.6g} times set-point less position, to the last digit: '
            text += 'the following error, no torque; name the column or topic of the torque'
            yield 'effort_error', text
    whole = np.array_equal(values, np.round(values))
    above = 100.0 * float(np.mean(values >= _SIGN_BIT))
    if whole and values.min() >= 0.0 and values.max() < 2 * _SIGN_BIT and 5.0 < above < 95.0:
        text = f'the effort is whole numbers from 0 to {values.max():g}, {above:.0f} % above '
        text += f'{_SIGN_BIT}: a register whose bit {_SIGN_BIT} is the direction; log '
        yield 'effort_register', f'{text}{_SIGN_BIT} less the value where it is above'


def _runs(values: FloatArray) -> NDArray[np.intp]:
    """Return (R, 2) begin and end of the stretches of equal values."""
    edges = np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1], [True]]))
    return np.stack([edges[:-1], edges[1:]], axis=1)


def _holding(values: FloatArray, stamp: NDArray[np.int64], rising: bool) -> float:
    """Return how long each value is held, s; 0 where they are not held.

    Of what is `rising` for long, as a coarse position at one speed, all have to last as long; else
    most: the next reading may be the same.
    """
    first, last = _runs(values)[1:-1].T
    size = last - first
    if size.size < 20 or np.median(size) < _HELD:
        return 0.0
    if rising:
        even = size.std() <= _EVEN * size.mean()
    else:
        even = np.ptp(np.percentile(size, (25, 75))) <= max(1.0, _EVEN * float(np.median(size)))
    return float(np.median(stamp[last] - stamp[first])) * 1e-9 if even else 0.0
