# SPDX-License-Identifier: Apache-2.0
"""One drive's motion and effort: is there enough of it, and can the effort be a torque?"""

from collections.abc import Iterator, Mapping
import math

import numpy as np

from ros2_ident.errors import IdentError
from ros2_ident.recording.findings import about, DriveSummary, Finding, Said
from ros2_ident.recording.motion import (
    best_lag,
    count_reversals,
    fill_gaps,
    LATEST,
    Motion,
    motion_of,
)
from ros2_ident.recording.sign import SAID, sign_of, WRONG
from ros2_ident.recording.streams import FloatArray, Recording

# A drive whose stroke is less than this part of the longest one stands: gears and their control
# give way to what the moving drives do.
STANDS = 0.02
# Fewer efforts are none.
_FEWEST = 10


def standing(strokes: Mapping[str, float]) -> tuple[str, ...]:
    """Return the drives that stand while others move, by the strokes of all."""
    longest = max(strokes.values(), default=0.0)
    return tuple(name for name, stroke in strokes.items() if stroke < STANDS * longest)


def judge_drive(
    number: int,
    recording: Recording,
    name: str,
    gravity: float = 0.0,
    scale: float = 1.0,
    wanted: bool = True,
) -> tuple[DriveSummary | None, list[Finding]]:
    """Judge one drive's excitation and effort.

    Args:
        number: Number of the recording.
        recording: A recording whose state holds positions.
        name: The drive.
        gravity: Gravity along the drive, m/s^2; 0 where it does not act or is not known.
        scale: Factor from the logged effort to N m or N.
        wanted: Whether the drive is to be identified, so that standing still is an error.

    Returns:
        The drive's summary, None where there are too few samples, and the findings.
    """
    try:
        motion = motion_of(recording, name, scale)
    except IdentError as exc:
        return None, [Finding('error', exc.code.name.lower(), name, exc.message)]
    stroke = float(np.ptp(motion.position))
    moves = stroke > 1e-6 * float(np.abs(motion.position).max())
    low = high = at_rest = lag = explained = math.nan
    effort = motion.effort
    if effort is not None and np.isfinite(effort).sum() >= _FEWEST:
        low, high = float(np.nanmin(effort)), float(np.nanmax(effort))
        rest = motion.resting & np.isfinite(effort)
        at_rest = float(np.mean(effort[rest])) if rest.sum() >= _FEWEST else math.nan
    varies = high - low > 1e-9 * max(abs(high), abs(low), 1e-300)
    if moves and varies:
        lag, explained = _explained(motion)
    drive = DriveSummary(
        number,
        name,
        stroke,
        float(np.abs(motion.velocity).max()),
        count_reversals(motion) if moves else 0,
        float(motion.resting.mean()) if moves else 1.0,
        low,
        high,
        at_rest,
        lag,
        explained,
    )
    return drive, about(name, _judged(drive, motion, gravity, moves, varies, wanted))


def _judged(
    drive: DriveSummary, motion: Motion, gravity: float, moves: bool, varies: bool, wanted: bool
) -> Iterator[Said]:
    """Yield what is to be said of a drive."""
    if moves:
        yield _of_motion(drive)
        yield from _of_velocity(motion)
    else:
        text = 'does not move; move it through its working range while recording'
        yield 'error' if wanted else 'warn', 'no_motion', text
    if math.isfinite(drive.effort_low) and not varies:
        text = (
            f'the effort is {drive.effort_high:g} all the time; switch its measurement on in the '
            'drive, or name the topic that carries it'
        )
        yield 'error', 'effort_constant', text
    elif varies and moves and motion.effort is not None:
        yield from _of_effort(drive, motion, motion.effort)
        if gravity and math.isfinite(drive.effort_rest):
            yield _of_gravity(drive.effort_rest, float(np.nanstd(motion.effort)), gravity)


def _of_motion(drive: DriveSummary) -> Said:
    """Judge whether a drive moved in a way that tells its parameters apart."""
    if drive.reversals == 0:
        text = (
            'moves in one direction only, so Coulomb friction cannot be told from a constant '
            'force; record the way back too'
        )
        return 'warn', 'one_way', text
    if drive.reversals < 3:
        text = (
            f'reverses only {("once", "twice")[drive.reversals - 1]}; four or more reversals at '
            'different speeds tell friction, inertia and offset apart'
        )
        return 'warn', 'few_reversals', text
    text = (
        f'stroke {drive.stroke:.3g}, top speed {drive.top_speed:.3g}, {drive.reversals} '
        f'reversals, {100.0 * drive.rest_share:.0f} % of the time at rest'
    )
    return 'ok', 'excitation', text


def _of_velocity(motion: Motion) -> Iterator[Said]:
    """Compare the reported velocity with the derivative of the position."""
    if motion.reported is None or np.isfinite(motion.reported).sum() < 20:
        return
    reported = motion.slowly(fill_gaps(motion.reported))
    lag, gain, share = best_lag(motion.velocity[:, None], reported, motion.period, -0.02)
    if share < 0.5:
        text = (
            f'the reported velocity explains {100.0 * share:.0f} % of the derivative of the '
            'position; leave the velocity out of the log, or correct its scale and source'
        )
        yield 'warn', 'velocity', text
    elif not 0.9 < gain[0] < 1.1:
        text = (
            f'the reported velocity is {gain[0]:.3g} times the derivative of the position; '
            'correct its unit or sign in the driver'
        )
        yield 'warn', 'velocity', text
    elif abs(lag) > max(0.6 * motion.period, 1e-3):
        text = (
            f'the reported velocity is {abs(lag) * 1e3:.3g} ms {"late" if lag > 0 else "early"}; '
            'the position is the better measurement of this motion'
        )
        yield 'warn', 'velocity_lag', text
    else:
        yield 'ok', 'velocity', 'the reported velocity is the derivative of the position'


def _explained(motion: Motion) -> tuple[float, float]:
    """Return the lag of the effort, s, and what share of its variance the motion explains."""
    assert motion.effort is not None
    friction = np.tanh(motion.velocity / (0.02 * np.abs(motion.velocity).max()))
    place = motion.position - motion.position.mean()
    rows = np.stack([motion.acceleration, motion.velocity, friction, np.ones(place.size), place])
    effort = motion.slowly(fill_gaps(motion.effort))
    lag, _, share = best_lag(motion.slowly(rows).T, effort, motion.period, 0.0)
    # a fit that is best at the very edge, or poor, knows nothing of a delay
    known = lag <= LATEST - 2.0 * motion.period and share >= 0.85
    return lag if known else math.nan, share


def _of_effort(drive: DriveSummary, motion: Motion, effort: FloatArray) -> Iterator[Said]:
    """Judge sign and kind of the effort from what accelerations and velocities say."""
    # A recording does not show which of its joints load each other.
    sign = sign_of(motion, alone=True)
    yield 'error' if sign in WRONG else 'ok', 'effort_sign', SAID[sign]
    if sign in WRONG:
        return
    values = effort[np.isfinite(effort)]
    top = np.abs(values).max()
    # Counts and percents are whole numbers, many of them.
    if np.abs(values - np.round(values)).max() < 1e-9 and np.unique(values).size >= 5:
        what = 'percent of the rated torque' if top <= 300.0 else 'milliamperes or counts'
        text = (
            f'all efforts are whole numbers up to {top:g}, which looks like {what}; state '
            'effort_unit with torque_constant or rated_torque in the machine file'
        )
        yield 'warn', 'effort_unit', text
    if drive.explained < 0.3:
        text = (
            'inertia, friction and gravity of this joint alone explain '
            f'{100.0 * drive.explained:.0f} % of its effort; other joints load it, or the effort '
            'is no torque of this drive'
        )
        yield 'warn', 'effort_unexplained', text
        return
    lag = drive.effort_lag
    late = f', about {lag * 1e3:.2g} ms late' if lag > max(motion.period, 2e-3) else ''
    text = f'inertia, friction and offset explain {100.0 * drive.explained:.0f} % of the effort'
    yield 'ok', 'effort', text + late


def _of_gravity(at_rest: float, spread: float, gravity: float) -> Said:
    """Look for the weight in the effort at rest, where gravity acts along the drive."""
    if abs(at_rest) < 0.05 * spread:
        text = (
            f'gravity acts along this drive but the effort at rest is {at_rest:.2g}; log the '
            'whole torque, not one with gravity compensated, or set gravity to 0 in the machine '
            'file'
        )
        return 'warn', 'effort_gravity', text
    if at_rest * gravity < 0.0:
        text = (
            f'the effort at rest is {at_rest:.2g}, it pulls downwards; positive effort has to '
            'hold the drive against gravity: check the signs of position and effort'
        )
        return 'warn', 'effort_gravity', text
    return 'ok', 'effort_gravity', f'holds {at_rest:.3g} at rest against gravity'
