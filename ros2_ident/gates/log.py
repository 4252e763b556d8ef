# SPDX-License-Identifier: Apache-2.0
"""Is the log whole, and is the effort a torque that moves the drive?"""

import math

import numpy as np

from ros2_ident.errors import IdentError
from ros2_ident.gates.asked import Asked
from ros2_ident.gates.finding import Gate, Level
from ros2_ident.gates.scale import figure, MORE, near
from ros2_ident.models import Machine
from ros2_ident.models.registry import kind_of
from ros2_ident.recording import Dataset
from ros2_ident.recording.motion import motion_in, ROOM
from ros2_ident.recording.quality import SAID, sign_of, WRONG
from ros2_ident.recording.streams import StreamQuality

# Shares of samples missing from which on a log is suspect, and of no use.
MISSING, TOO_MANY_MISSING = 0.02, 0.2
# Motion up to this frequency is looked at where the log shows it, Hz.
SEEN = 50.0


def check_streams(data: Dataset) -> list[Gate]:
    """Judge missing samples and the jitter of the stamps of every stream."""
    found = []
    # What is in one message comes with its losses and its stamp.
    alike: dict[StreamQuality, list[str]] = {}
    for role, stream in data.streams.items():
        alike.setdefault(stream, []).append(role)
    for stream, roles in alike.items():
        name, share = ' and '.join(roles), stream.missing_share
        level: Level = 'fail' if share > TOO_MANY_MISSING else 'warn' if share > MISSING else 'ok'
        text = f'{name}: {stream.samples} samples at {stream.rate:.6g} Hz'
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
        text = f'{name}: stamps scatter by {1e3 * stream.jitter:.2g} ms about the grid'
        if loose and not stream.stride:
            text = (
                f'{name}: the samples keep to no multiple of the controller cycle and '
                'lie up to half a cycle off; state a cycle that divides their period'
            )
        elif loose:
            text += '; a shorter delay cannot be seen: stamp samples where they are taken'
        if 'state' in roles:
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
    """Judge whether a drive's effort has the sign and the size of a torque that moves it."""
    d = data.names.index(drive)
    if data.effort is None or data.position is None:
        return []
    found = []
    limit = machine.number('torque_limit', drive)
    top = float(np.nanmax(np.abs(data.effort[d])))
    if math.isfinite(limit):
        bad = top > MORE * limit
        text = f'{drive}: the effort reaches {top:.4g}, the limit is {limit:.4g}'
        if bad:
            text += '; state the unit of the log as effort_unit, or the true torque_limit'
        found.append(Gate('limit', drive, 'fail' if bad else 'ok', top / limit, '1', text, bad))
    try:
        # The other links of an arm may drive a joint against its own friction.
        sign = sign_of(motion_in(data, drive), alone=not kind_of(machine).follows)
    except IdentError:
        return found
    bad = sign in WRONG
    level: Level = 'fail' if bad else 'ok'
    text = f'{drive}: {SAID[sign]}'
    return [*found, Gate('sign', drive, level, math.nan, '1', text, bad, cause=sign)]


def check_asked(found: Asked, unit: str) -> list[Gate]:
    """Judge how a drive makes the effort that it is asked for.

    Args:
        found: From `fit_asked`.
        unit: Unit of an effort.
    """
    drive = found.drive
    off = not near(found.factor)
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
        at = ', '.join(
            f'{p.time:.2f} s ({figure(p.effort, "+")} {unit})' for p in found.pushes
        )
        text = (
            f'{drive}: effort that was not commanded: {at}; look for another source of commands, '
            'contact with a person or an object, or a fault of the drive'
        )
        said.append(Gate('not_asked', drive, 'warn', found.pushes[0].time, 's', text))
    return said
