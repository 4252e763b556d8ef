# SPDX-License-Identifier: Apache-2.0
"""Does a drive's effort follow joints that its model knows nothing of, as in an arm?"""

from itertools import combinations
import math

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import IdentError
from ros2_ident.gates.finding import Gate
from ros2_ident.gates.scale import FEWEST, FLOORS, SLOW
from ros2_ident.models import Machine
from ros2_ident.models.registry import kind_of
from ros2_ident.recording import Dataset, smooth_motion
from ros2_ident.recording.motion import allowed_cutoff, fill_gaps, low_pass

# A drive that its own motion leaves so much of, in standard deviations, may be a joint of an arm,
# where other joints' positions take this share of what is left (mean square) away.
_LEFT, _TAKEN = 0.2, 0.5
# Blocks that are held out in turn, s, and how many of them there are at least.
_BLOCK, _FOLDS = 1.0, 8
# Ridge, as a share of the columns' own squares.
_RIDGE = 1e-6
# Joints that are looked at; the most that sums of three angles are made of.
_MOST = 8


def check_coupling(machine: Machine, data: Dataset, drive: str) -> list[Gate]:
    """Judge whether a drive is a machine of its own, as its model takes it.

    Its effort is put down to its own position, speed and acceleration, then to those of the other
    joints in the log too: gravity of an arm acts by sines and cosines of sums of angles. What
    counts is how well blocks of the log are predicted that were left out.

    Args:
        machine: The machine; nothing is said where drives of its kind load each other anyway.
        data: A recording.
        drive: The drive.
    """
    if kind_of(machine).coupled or data.position is None or data.effort is None:
        return []
    d = data.names.index(drive)
    others = {n: row for n, row in zip(data.names, data.position, strict=True) if n != drive}
    others |= data.beside
    others = {n: row for n, row in others.items() if _moves(row)}
    if not others or not np.isfinite(data.effort[d]).any():
        return []
    names = list(others)[:_MOST]
    rows = np.stack([data.position[d], *(others[n] for n in names)])
    cutoff = allowed_cutoff(rows, data.cycle, SLOW)
    try:
        motion = smooth_motion(rows, data.cycle, cutoff)
    except IdentError:
        return []
    # Twice the Nyquist rate of it is enough.
    stride = max(1, round(0.25 / (SLOW * data.cycle)))
    place, speed, change = (part[:, ::stride] for part in motion)
    effort = low_pass(fill_gaps(data.effort[d])[None], data.cycle, cutoff)[0, ::stride]
    block = round(_BLOCK / (stride * data.cycle))
    if effort.size < _FOLDS * block:
        return []
    turning = machine.travel_unit == 'rad'
    own = _own(place[0], speed[0], change[0], turning)
    both = np.concatenate([own, _beside(place, change, turning)], axis=1)
    alone, together = (_missed(x, effort, block) for x in (own, both))
    varies = float(effort.std())
    if alone < _LEFT * varies or alone < FLOORS * machine.effort_noise:
        return []
    if together**2 > (1.0 - _TAKEN) * alone**2:
        return []
    return [_said(machine, drive, names, alone, together, varies)]


def _said(
    machine: Machine, drive: str, names: list[str], alone: float, together: float, varies: float
) -> Gate:
    """Return that a drive is loaded by others."""
    unit = machine.model_unit
    what = 'gravity and coupling of an arm' if machine.travel_unit == 'rad' else 'coupling'
    others = ', '.join(names) if len(names) < 3 else f'the {len(names)} other joints'
    text = (
        f'{drive}: the model is the wrong one, its own motion leaves {100.0 * alone / varies:.0f} '
        f'% of what varies in its effort ({alone:.3g} {unit}) and that of {others} takes all but '
        f'{100.0 * together / varies:.0f} % away: {what}, which a {machine.kind} does not have; '
        'use a kind of machine with all these joints in one model'
    )
    return Gate('coupling', drive, 'fail', alone / varies, '1', text, contradicts=True)


def _moves(row: Array) -> bool:
    """Return whether a joint moves at all, by enough samples."""
    there = row[np.isfinite(row)]
    if there.size <= FEWEST:
        return False
    return float(np.ptp(there)) > 1e-6 * max(1.0, float(np.abs(there).max()))


def _own(place: Array, speed: Array, change: Array, turning: bool) -> Array:
    """Return columns (T, P) of what a drive's own motion may take of its effort."""
    fast = float(np.abs(speed).max()) or 1.0
    # Powers of a position that is new in a block left out would be worse than none.
    columns = [np.ones_like(place), place, speed, change, speed * np.abs(speed)]
    columns += [np.tanh(speed / (share * fast)) for share in (0.01, 0.05, 0.2)]
    if turning:
        columns += [np.sin(place), np.cos(place)]
    return np.stack(columns, axis=1)


def _beside(place: Array, change: Array, turning: bool) -> Array:
    """Return columns (T, P) of what the other joints, rows 1 and on, may add."""
    columns = [*change[1:], *place[1:]]
    if turning:
        count = len(place)
        chosen = [c for size in (1, 2, 3) for c in combinations(range(count), size) if c != (0,)]
        # The drive carries what hangs on it: sums of angles without its own are those before it.
        for sum_of in (c for c in chosen if len(c) < 3 or 0 in c):
            angle = place[list(sum_of)].sum(axis=0)
            columns += [np.sin(angle), np.cos(angle)]
    return np.stack(columns, axis=1)


def _missed(columns: Array, effort: Array, block: int) -> float:
    """Return the RMS by which blocks left out are missed."""
    scale = np.sqrt((columns**2).mean(axis=0)) + 1e-300
    columns = columns / scale
    number = np.arange(effort.size) // block % _FOLDS
    square = 0.0
    for held in range(_FOLDS):
        out = number == held
        # Neighbours of what is left out know too much of it.
        near = np.convolve(out, np.ones(2 * (block // 4) + 1), 'same') > 0.0
        x, y = columns[~near], effort[~near]
        normal = x.T @ x + _RIDGE * len(x) * np.eye(x.shape[1])
        solution = np.linalg.solve(normal, x.T @ y)
        square += float(((effort[out] - columns[out] @ solution) ** 2).sum())
    return math.sqrt(square / effort.size)
