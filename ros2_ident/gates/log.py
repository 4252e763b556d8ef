# SPDX-License-Identifier: Apache-2.0
"""Is the log whole, and is the effort a torque that moves the drive?"""

import math

import numpy as np

from ros2_ident.errors import IdentError
from ros2_ident.gates.asked import Asked
from ros2_ident.gates.finding import Gate, Level
from ros2_ident.models import Machine
from ros2_ident.recording import Dataset, smooth_motion
from ros2_ident.recording.motion import best_lag, fill_gaps
from ros2_ident.recording.plausibility import lost_sign, unsigned
from ros2_ident.recording.smooth import allowed_cutoff, ROOM

# Shares of samples missing from which on a log is suspect, and of no use.
MISSING, TOO_MANY_MISSING = 0.02, 0.2
# A drive's own motion has to explain so much of its effort to tell a sign.
_TELLS = 0.3
# Motion up to this frequency is looked at where the log shows it, Hz.
SEEN = 50.0
# Motion faster than this is left out of the check of the sign, Hz.
_SLOW = 15.0
# A drive makes so much more or less than it is asked for, and it is said.
_OFF = 0.1


def check_streams(data: Dataset) -> list[Gate]:
    """Judge missing samples and the jitter of the stamps of every stream."""
    found = []
    for stream in data.quality.streams:
        share = stream.missing_share
        level: Level = 'fail' if share > TOO_MANY_MISSING else 'warn' if share > MISSING else 'ok'
        text = f'{stream.role}: {stream.samples} samples at {stream.rate:.6g} Hz'
        if level == 'ok':
            text += f', {stream.missing} missing' if stream.missing else ', none missing'
        else:
            text += (
                f', {100.0 * share:.2g} % are missing; record on the machine itself, or with a '
                'larger cache'
            )
        found.append(Gate('missing', '', level, share, '1', text))
        period = 1.0 / stream.rate if stream.rate else math.inf
        loose = stream.jitter > 0.15 * period
        text = f'{stream.role}: stamps scatter by {1e3 * stream.jitter:.2g} ms about the grid'
        if loose:
            text += '; a shorter delay cannot be seen: stamp samples where they are taken'
        if stream.role == 'state':
            found += _slow(stream.rate)
        found.append(
            Gate('jitter', '', 'warn' if loose else 'ok', stream.jitter, 's', text)
        )
    return found


def _slow(rate: float) -> list[Gate]:
    """Return a warning where positions come too seldom to show how a drive moves."""
    cutoff = ROOM * rate
    if cutoff >= SEEN:
        return []
    text = (
        f'positions come at {rate:.4g} Hz, so motion is smoothed at {cutoff:.3g} Hz: what is '
        f'faster does not show and looks like a gap; log at {SEEN / ROOM:g} Hz or more'
    )
    return [Gate('rate', '', 'warn', rate, 'Hz', text)]


def check_effort(machine: Machine, data: Dataset, drive: str) -> list[Gate]:
    """Judge whether a drive's effort has the sign and the size of a torque that moves it.

    The slow part of the effort is put down to acceleration, friction in both directions, position
    and a constant, at the lag that suits best. Inertia and friction have to come out positive.
    """
    d = data.names.index(drive)
    if data.effort is None or data.position is None:
        return []
    found = []
    limit = machine.number('torque_limit', drive)
    top = float(np.nanmax(np.abs(data.effort[d])))
    if math.isfinite(limit):
        bad = top > 1.2 * limit
        text = f'{drive}: the effort reaches {top:.4g}, the limit is {limit:.4g}'
        if bad:
            text += '; state the unit of the log as effort_unit, or the true torque_limit'
        found.append(Gate('limit', drive, 'fail' if bad else 'ok', top / limit, '1', text, bad))
    stride = max(1, round(1.0 / (250.0 * data.cycle)))
    cutoff = allowed_cutoff(data.position[d], data.cycle, _SLOW)
    try:
        motion = smooth_motion(data.position[d : d + 1], data.cycle, cutoff)
    except IdentError:
        return found
    position, velocity, acceleration = (row[0, ::stride] for row in motion)
    if lost_sign(fill_gaps(data.effort[d]), velocity):
        return [*found, Gate('sign', drive, 'fail', math.nan, '1', unsigned(drive), True)]
    still = 0.02 * float(np.abs(velocity).max())
    if still <= 0.0:
        return found
    columns = np.stack(
        [acceleration, np.tanh(velocity / still), velocity, position, np.ones_like(position)],
        axis=1,
    )
    effort = fill_gaps(data.effort[d])[::stride]
    lag, solution, share = best_lag(columns, effort, stride * data.cycle, 0.0)
    # What is small beside the rest of the effort has no sign that could be trusted.
    small = 0.1 * float(effort.std())
    weight = float(np.std(solution[0] * acceleration))
    sound = solution[0] > 0.0 or weight < small
    friction = columns[:, 1:3] @ solution[1:3]
    loses = float(np.mean(velocity * friction)) >= 0.0 or float(np.std(friction)) < 3.0 * small
    # Over a log a motor gives more than it takes back; with its sign reversed it would take.
    gives = float(np.mean(velocity * (effort - effort.mean()))) >= 0.0
    level: Level = 'ok'
    text = (
        f'{drive}: inertia and friction explain {100.0 * share:.0f} % of the effort, '
        f'{1e3 * lag:.0f} ms late'
    )
    if not sound or not loses:
        clear = not sound and not gives and (weight > 3.0 * small or not loses)
        level = 'fail' if clear else 'warn'
        what = 'inertia' if not sound else 'friction'
        text += f', but {what} comes out negative: '
        text += (
            "something other than the drive's own motion moves the effort"
            if gives
            else "the effort's sign is reversed against the motion; negate effort or position in "
            'the driver'
        )
    known = level == 'fail' and share > _TELLS
    found.append(Gate('sign', drive, level, float(solution[0]), 'effort s^2/m', text, known))
    return found


def check_asked(found: Asked, unit: str) -> list[Gate]:
    """Judge how a drive makes the effort that it is asked for.

    Args:
        found: From `fit_asked`.
        unit: Unit of an effort.
    """
    drive = found.drive
    off = abs(found.factor - 1.0) > _OFF
    text = (
        f'{drive}: makes {found.factor:.3g} times the effort that it is asked for, '
        f'{1e3 * found.late:.0f} ms late, to within {found.usual:.2g} {unit}'
    )
    if off:
        text += '; check the torque constants of log and controller'
    said = [Gate('asked', drive, 'warn' if off else 'ok', found.factor, '1', text)]
    if math.isfinite(found.limit):
        text = (
            f'{drive}: the effort stays at about {found.limit:.3g} {unit} where the command asks '
            'for more; something limits it there'
        )
        said.append(Gate('limited', drive, 'warn', found.limit, unit, text))
    if found.pushes:
        at = ', '.join(p.said(unit) for p in found.pushes)
        text = (
            f'{drive}: made efforts that the command did not ask for: {at}; look for another '
            'source of commands, a hand at the machine, or a fault of the drive'
        )
        said.append(Gate('not_asked', drive, 'warn', found.pushes[0].time, 's', text))
    return said
