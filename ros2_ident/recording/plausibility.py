# SPDX-License-Identifier: Apache-2.0
"""One drive's motion and effort: is there enough of it, and can the effort be a torque?"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ros2_ident.errors import IdentError
from ros2_ident.recording.findings import DriveSummary, Finding
from ros2_ident.recording.motion import (
    best_lag,
    count_reversals,
    CUTOFF,
    fill_gaps,
    LATEST,
    Motion,
    motion_of,
)
from ros2_ident.recording.sign import sentence, sign_of, WRONG
from ros2_ident.recording.smooth import low_pass
from ros2_ident.recording.streams import FloatArray, Recording

# A drive whose stroke is less than this part of the longest one stands: gears and their control
# give way to what the moving drives do.
STANDS = 0.02


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
    findings: list[Finding] = []
    stroke = float(np.ptp(motion.position))
    still = stroke <= 1e-6 * float(np.abs(motion.position).max())
    reversals = 0 if still else count_reversals(motion)
    moving = not still
    if still:
        findings.append(
            Finding(
                'error' if wanted else 'warn',
                'no_motion',
                name,
                f'{name}: does not move; move it through its working range while recording',
            )
        )
    else:
        findings.append(_judge_motion(name, motion, stroke, reversals))
    summary = DriveSummary(
        number,
        name,
        stroke,
        float(np.abs(motion.velocity).max()),
        reversals,
        1.0 if still else float(motion.resting.mean()),
        *([float('nan')] * 5),
    )
    if moving and (velocity := _judge_velocity(name, motion)):
        findings.append(velocity)
    if motion.effort is None or np.isfinite(motion.effort).sum() < 10:
        return summary, findings
    effort = motion.effort
    low, high = float(np.nanmin(effort)), float(np.nanmax(effort))
    rest = motion.resting & np.isfinite(effort)
    at_rest = float(np.mean(effort[rest])) if rest.sum() >= 10 else float('nan')
    summary = replace(summary, effort_low=low, effort_high=high, effort_rest=at_rest)
    if high - low <= 1e-9 * max(abs(high), abs(low), 1e-300):
        return summary, [
            *findings,
            Finding(
                'error',
                'effort_constant',
                name,
                f'{name}: the effort is {high:g} all the time; switch its measurement on in the '
                'drive, or name the topic that carries it',
            ),
        ]
    if not moving:
        return summary, findings
    lag, explained, said = _judge_effort(name, motion)
    findings += said
    if weight := _judge_gravity(name, at_rest, float(np.nanstd(effort)), gravity):
        findings.append(weight)
    return replace(summary, effort_lag=lag, explained=explained), findings


def _judge_motion(name: str, motion: Motion, stroke: float, reversals: int) -> Finding:
    """Judge whether a drive moved in a way that tells its parameters apart."""
    if reversals == 0:
        return Finding(
            'warn',
            'one_way',
            name,
            f'{name}: moves in one direction only, so Coulomb friction cannot be told from a '
            'constant force; record the way back too',
        )
    if reversals < 3:
        return Finding(
            'warn',
            'few_reversals',
            name,
            f'{name}: reverses only {("once", "twice")[reversals - 1]}; four or more reversals '
            'at different speeds tell friction, inertia and offset apart',
        )
    return Finding(
        'ok',
        'excitation',
        name,
        f'{name}: stroke {stroke:.3g}, top speed {np.abs(motion.velocity).max():.3g}, {reversals} '
        f'reversals, {100.0 * motion.resting.mean():.0f} % of the time at rest',
    )


def _judge_velocity(name: str, motion: Motion) -> Finding | None:
    """Compare the reported velocity with the derivative of the position."""
    if motion.reported is None or np.isfinite(motion.reported).sum() < 20:
        return None
    reported = fill_gaps(motion.reported)
    reported = low_pass(reported[None], motion.period, min(CUTOFF, 0.2 / motion.period))[0]
    lag, gain, share = best_lag(motion.velocity[:, None], reported, motion.period, -0.02)
    if share < 0.5:
        return Finding(
            'warn',
            'velocity',
            name,
            f'{name}: the reported velocity explains {100.0 * share:.0f} % of the derivative '
            'of the position; leave the velocity out of the log, or correct its scale and '
            'source',
        )
    slope = float(gain[0])
    if not 0.9 < slope < 1.1:
        return Finding(
            'warn',
            'velocity',
            name,
            f'{name}: the reported velocity is {slope:.3g} times the derivative of the '
            'position; correct its unit or sign in the driver',
        )
    if abs(lag) > max(0.6 * motion.period, 1e-3):
        return Finding(
            'warn',
            'velocity_lag',
            name,
            f'{name}: the reported velocity is {abs(lag) * 1e3:.3g} ms '
            f'{"late" if lag > 0 else "early"}; the position is the better measurement of '
            'this motion',
        )
    return Finding(
        'ok',
        'velocity',
        name,
        f'{name}: the reported velocity is the derivative of the position',
    )


def _judge_effort(name: str, motion: Motion) -> tuple[float, float, list[Finding]]:
    """Judge sign and kind of the effort from what accelerations and velocities say.

    Returns:
        Lag of the effort, s; the share of its variance explained; the findings.
    """
    assert motion.effort is not None
    cutoff = min(CUTOFF, 0.2 / motion.period)
    speed = np.abs(motion.velocity).max()
    friction = np.tanh(motion.velocity / (0.02 * speed))
    place = motion.position - motion.position.mean()
    rows = np.stack([motion.acceleration, motion.velocity, friction, np.ones(place.size), place])
    columns = low_pass(rows, motion.period, cutoff).T
    effort = low_pass(fill_gaps(motion.effort)[None], motion.period, cutoff)[0]
    lag, _, share = best_lag(columns, effort, motion.period, 0.0)
    if lag > LATEST - 2.0 * motion.period or share < 0.85:
        # a fit that is best at the very edge, or poor, knows nothing of a delay
        lag = float('nan')
    # A recording does not show which of its joints load each other.
    sign = sign_of(motion, alone=True)
    bad = sign in WRONG
    found = [Finding('error' if bad else 'ok', 'effort_sign', name, sentence(name, sign))]
    if bad:
        return lag, share, found
    kind = _kind(name, motion.effort)
    found += [] if kind is None else [kind]
    if share < 0.3:
        text = (
            f'{name}: inertia, friction and gravity of this joint alone explain '
            f'{100.0 * share:.0f} % of its effort; other joints load it, or the effort is '
            'no torque of this drive'
        )
        return lag, share, [*found, Finding('warn', 'effort_unexplained', name, text)]
    late = f', about {lag * 1e3:.2g} ms late' if lag > max(motion.period, 2e-3) else ''
    text = f'{name}: inertia, friction and offset explain {100.0 * share:.0f} % of the effort'
    return lag, share, [*found, Finding('ok', 'effort', name, text + late)]


def _kind(name: str, effort: FloatArray) -> Finding | None:
    """Recognise counts and percents: whole numbers, many of them."""
    values = effort[np.isfinite(effort)]
    whole = np.abs(values - np.round(values)).max() < 1e-9
    if not whole or np.unique(values).size < 5:
        return None
    what = (
        'percent of the rated torque'
        if np.abs(values).max() <= 300.0
        else 'milliamperes or counts'
    )
    return Finding(
        'warn',
        'effort_unit',
        name,
        f'{name}: all efforts are whole numbers up to {np.abs(values).max():g}, which looks like '
        f'{what}; state effort_unit with torque_constant or rated_torque in the machine file',
    )


def _judge_gravity(name: str, at_rest: float, spread: float, gravity: float) -> Finding | None:
    """Look for the weight in the effort at rest, where gravity acts along the drive."""
    if gravity == 0.0 or at_rest != at_rest:
        return None
    if abs(at_rest) < 0.05 * spread:
        return Finding(
            'warn',
            'effort_gravity',
            name,
            f'{name}: gravity acts along this drive but the effort at rest is {at_rest:.2g}; '
            'log the whole torque, not one with gravity compensated, or set gravity to 0 in '
            'the machine file',
        )
    if at_rest * gravity < 0.0:
        return Finding(
            'warn',
            'effort_gravity',
            name,
            f'{name}: the effort at rest is {at_rest:.2g}, it pulls downwards; positive '
            'effort has to hold the drive against gravity: check the signs of position and '
            'effort',
        )
    return Finding(
        'ok', 'effort_gravity', name, f'{name}: holds {at_rest:.3g} at rest against gravity'
    )
