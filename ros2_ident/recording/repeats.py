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
    """Yield (code, sentence) for what is no measurement of a joint.

    Args:
        recording: A log with measured positions.
        name: The joint.
    """
    state, effort = recording.state, recording.effort or recording.state
    place = state.column('position', name) if state else None
    values = effort.column('effort', name) if effort else None
    if state is None or place is None or effort is None or values is None:
        return
    if not np.isfinite(values).all() or np.ptp(values) == 0.0:
        return
    seconds = (effort.stamp - recording.begin) * 1e-9
    moved = np.interp(effort.stamp, state.stamp, place)
    frozen = [
        f'{values[a]:.4g} from {seconds[a]:.3g} to {seconds[b - 1]:.3g} s'
        for a, b in _runs(values)
        if seconds[b - 1] - seconds[a] > _LONG
        and np.abs(np.diff(moved[a:b])).sum() > _FAR * np.ptp(moved)
    ]
    if frozen:
        text = f'the effort is {" and ".join(frozen[:3])} while the drive moves, so it was not '
        yield 'effort_frozen', f'{text}measured there; cut the log, or leave these cells empty'
    if held := _holding(place, state.stamp):
        text = f'each position stays for {1e3 * held:.3g} ms, as of a bus that is read at '
        yield 'held', f'{text}{1.0 / held:.3g} Hz; log each value once, when it is read'
    command = recording.command
    goal = command.column('position', name) if command else None
    if command is not None and goal is not None:
        apart = np.interp(effort.stamp, command.stamp, goal) - moved
        scale = float(apart @ values) / (float(apart @ apart) or 1.0)
        if np.abs(values - scale * apart).max() <= _SAME * np.abs(values).max():
            text = f'the effort is {scale:.6g} times set-point less position, to the last digit: '
            remedy = 'name the column or topic of the torque'
            yield 'effort_error', f'{text}the following error, no torque; {remedy}'
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


def _holding(place: FloatArray, stamp: NDArray[np.int64]) -> float:
    """Return how long each position is held, s; 0 where they are not held."""
    runs = _runs(place)[1:-1]
    lengths = runs[:, 1] - runs[:, 0]
    few = lengths.size < 20 or np.median(lengths) < _HELD
    if few or lengths.std() > _EVEN * lengths.mean():
        return 0.0
    return float(np.median(stamp[runs[:, 1]] - stamp[runs[:, 0]])) * 1e-9
