# SPDX-License-Identifier: Apache-2.0
"""Judge recordings before an hour is spent on them.

Did the streams arrive whole, is there enough motion, and can the effort be a torque?
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import Literal

import numpy as np

from ros2_ident.errors import IdentError
from ros2_ident.recording import motion as motions
from ros2_ident.recording.columns import MOTION, SPEEDS
from ros2_ident.recording.grid import missing_samples, sample_period
from ros2_ident.recording.limits import likewise
from ros2_ident.recording.maps import DIGITS
from ros2_ident.recording.motion import fill_gaps, Motion
from ros2_ident.recording.repeated import repeats
from ros2_ident.recording.sign import backward, effort_lag, KNOWN, SAID, sign_of, WRONG
from ros2_ident.recording.streams import (
    FIELDS,
    FloatArray,
    Recording,
    SPEEDS_ALONE,
    Stream,
    with_positions,
)

# So many different values that are whole numbers are so by no chance. By hand.
_WHOLE = 5
# A reported velocity is looked for from so much before the motion on, s. By hand.
_EARLIEST = -0.02
_NOT_DRIVEN = 'switch its measurement on, where it is driven; what swings freely has none'
# Shares of missing samples from which a warning, and an error, is due.
_MISSING_WARN, _MISSING_ERROR = 0.01, 0.2
# Shorter recordings hardly hold an acceleration, a cruise and a reversal, s.
_SHORT = 2.0
# A drive whose stroke is less than this part of the longest one stands: gears and their control
# give way to what the moving drives do.
STANDS = 0.02
# What is said of a drive's motion, the best first.
_MOTION = {'excitation': 0, 'few_reversals': 1, 'one_way': 2, 'no_motion': 3}
# Fewer efforts are none.
_FEWEST = 10

# Units of a time that may have been taken for seconds, s; factors between rad, deg, turns, rpm.
_PARTS = {unit: 10.0 ** (digits - DIGITS['s']) for unit, digits in DIGITS.items() if unit != 's'}
_ANGLES = 1.0, MOTION['deg'], MOTION['rev'], SPEEDS['rpm']
_BETWEEN = [x / y for x in _ANGLES for y in _ANGLES]

Level = Literal['ok', 'warn', 'error']
_RECORD = 'record the set-point where there is one'
_ORDER: dict[str, int] = {'ok': 0, 'warn': 1, 'error': 2}
# Level, code and sentence of what is found, without its subject.
Said = tuple[Level, str, str]
# How late a signal is, s, by which factor off, and which share of it is explained.
_Fit = tuple[float, float, float]


@dataclass(frozen=True)
class Finding:
    """One thing found."""

    level: Level  # `warn`: the result may suffer; `error`: identification is of no use
    code: str  # a stable short name, as `effort_sign`
    subject: str  # a stream's role, a drive, or empty for the recording
    sentence: str  # what was found, and the remedy where there is something to do


def about(subject: str, said: Iterable[Said]) -> list[Finding]:
    """Return what is found of a stream or a drive, which each sentence names first."""
    return [Finding(level, code, subject, f'{subject}: {text}') for level, code, text in said]


@dataclass(frozen=True)
class DriveSummary:
    """How far one drive moved in one recording."""

    recording: int  # its number, from 0
    drive: str  # joint name
    stroke: float  # largest less smallest position, rad or m
    effort_rest: float  # mean effort at rest, N m or N; NaN where not measured


@dataclass(frozen=True)
class Report:
    """The judgement on some recordings."""

    source: str  # where they come from
    drives: tuple[DriveSummary, ...] = ()  # one entry per drive whose motion was measured
    findings: tuple[Finding, ...] = ()  # everything found, worst first

    def __post_init__(self) -> None:
        """Sort the findings, worst first."""
        ordered = sorted(dict.fromkeys(self.findings), key=lambda x: -_ORDER[x.level])
        object.__setattr__(self, 'findings', tuple(ordered))

    @property
    def level(self) -> Level:
        """The worst level found."""
        return self.findings[0].level if self.findings else 'ok'

    def of(self, code: str) -> tuple[Finding, ...]:
        """Return the findings of a code."""
        return tuple(x for x in self.findings if x.code == code)


def check(
    recordings: Sequence[Recording],
    wanted: Sequence[str] | None = None,
    need: Sequence[str] = ('effort',),
    gravity: float = 0.0,
) -> Report:
    """Judge recordings: streams, excitation, plausibility of the effort.

    Args:
        recordings: In the order of the log, efforts in N m or N where their unit is known.
        wanted: Drives to be identified; every joint of the state is looked at where None.
        need: What will be compared; where no effort is, nothing is said of it.
        gravity: Gravity along the drives, m/s^2; 0 where it does not act or is not known.
    """
    drives: list[DriveSummary] = []
    findings: list[Finding] = []
    if not recordings:
        text = 'there is no recording; record joint states while the drives move'
        return Report('', findings=(Finding('error', 'no_data', '', text),))
    if len(recordings) > 1 and len({x.source for x in recordings}) == 1:
        text = 'the stamps step back, or nothing came for long: each of the segments, '
        text += f'{len(recordings)}, is judged and used by itself'
        findings.append(Finding('warn', 'segments', '', text))
    findings += [Finding('ok', 'topics', '', text) for text in recordings[0].notes]
    for number, recording in enumerate(recordings):
        findings += [Finding('warn', 'reading', '', text) for text in recording.warnings]
        for role, stream in recording.streams.items():
            findings += about(role, _of_stream(role, stream))
        if recording.duration < _SHORT:
            text = f'the recording lasts {recording.duration:.2g} s; record at least {_SHORT:g} s'
            findings.append(Finding('warn', 'short', '', text))
        if recording.command is None:
            text = 'there is no command stream: the recorded motion will drive the model, and '
            text += 'nothing is found of the controller; '
            unread = any('--command-topic' in x for x in recording.notes)
            text += 'read the set-point, for which there is a topic' if unread else _RECORD
            findings.append(Finding('warn', 'no_command', 'command', text))
        elif recording.sets_speeds_alone:
            findings.append(Finding('warn', 'no_command', 'command', SPEEDS_ALONE))
        found, said = _judge_drives(number, recording, wanted, gravity)
        drives += found
        findings += said
    # Of several recordings that counts which excites a drive best.
    told = sorted((x for x in findings if x.code in _MOTION), key=lambda x: -_MOTION[x.code])
    best = {x.subject: x for x in told}
    findings = [x for x in findings if x.code not in _MOTION or best[x.subject] is x]
    if 'effort' not in need:
        findings = [f for f in findings if not f.code.startswith('effort_')]
    return Report(recordings[0].source, tuple(drives), tuple(findings))


def _of_stream(role: str, stream: Stream) -> Iterator[Said]:
    steps, samples = np.diff(stream.stamp) * 1e-9, stream.stamp.size
    period = sample_period(stream.stamp)
    near = steps[steps <= 1.5 * period]
    missing = missing_samples(stream.stamp)
    share = (missing or 0) / (samples + (missing or 0))
    text = f'{samples} samples of {"+".join(stream.fields)} in {stream.duration:.4g} s'
    level: Level = 'ok'
    if missing is None:
        level = 'warn'
        text += f' come unevenly, {1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} ms apart: '
        text += 'log at a fixed rate, stamped where they are taken'
    else:
        text += f', at {1.0 / period if period else 0.0:.6g} Hz, {missing or "none"} missing, '
        text += f'stamps scatter by {float(np.std(near)) * 1e3 if near.size else 0.0:.3g} ms'
    if share > _MISSING_WARN:
        level = 'error' if share > _MISSING_ERROR else 'warn'
        text += f'; {100.0 * share:.3g} % are missing, the longest gap lasts {steps.max():.3g} s: '
        text += 'record on the machine itself, or with a larger cache'
    yield level, 'missing', text
    for field, values in stream.fields.items():
        for name, share in zip(stream.names, np.isnan(values).mean(axis=0).tolist(), strict=True):
            what, remedy = f'the {field} of {name}', ': it was not measured'
            if role != 'effort' and field == 'effort':
                remedy = '; name the topic or column that carries it, or switch its measurement on'
            if share == 1.0:
                yield 'warn', 'nan', f'every value of {what} is NaN{remedy}'
            elif share > _MISSING_WARN:
                text = f'{100.0 * share:.3g} % of the values of {what} are missing or NaN'
                yield 'warn', 'nan', f'{text}: they are left out'


def _judge_drives(
    number: int, recording: Recording, wanted: Sequence[str] | None, gravity: float
) -> tuple[list[DriveSummary], list[Finding]]:
    names = recording.state.names if recording.state else ()
    recording, integrated = with_positions(recording, names)
    state = recording.state
    if state is None or state.position is None:
        text = 'no position was recorded, so excitation and effort cannot be judged; record the '
        return [], [Finding('warn', 'no_position', 'state', f'{text}joint states')]
    drives: list[DriveSummary] = []
    findings: list[Finding] = []
    rates: list[float] = []
    idle = set[str]()
    for name in (x for x in (state.names if wanted is None else wanted) if x in state.names):
        try:
            motion = motions.motion_of(recording, name)
        except IdentError as exc:
            findings.append(Finding('error', exc.code.name.lower(), name, exc.message))
            continue
        at_rest, effort = math.nan, motion.effort
        if effort is not None:
            rest = motion.resting & np.isfinite(effort)
            at_rest = float(np.mean(effort[rest])) if rest.sum() >= _FEWEST else math.nan
        if effort is None or not np.nan_to_num(effort).any():
            idle.add(name)
        drives.append(DriveSummary(number, name, float(np.ptp(motion.position)), at_rest))
        # An integrated speed says nothing of the speed.
        rests = motions.still(state.position[:, state.names.index(name)])
        fit = None if name in integrated or rests else _velocity_fit(motion)
        if fit is not None and fit[2] >= KNOWN:
            rates.append(fit[1])
        judged = [*_judged(drives[-1], motion, rests, gravity, wanted is not None, fit)]
        judged += [('warn', code, text) for code, text in repeats(recording, name)]
        if name not in integrated:
            judged += _of_counts(state.position[:, state.names.index(name)])
        findings += about(name, judged)
    # Beside others one without an effort is not compared.
    idle = idle if len(idle) < len(drives) else set()
    there = [x.code == 'effort_constant' and x.subject in idle for x in findings]
    findings = [replace(x, level='warn') if y else x for x, y in zip(findings, there, strict=True)]
    if off := _of_time(rates, sample_period(state.stamp)):
        findings = [x for x in findings if x.code != 'velocity']
        findings += about('state', off)
    ways = {x.drive: recording.units.get((x.drive, FIELDS[0]), '') for x in drives}
    if still := standing({x.drive: x.stroke for x in drives}, idle, ways):
        text = 'stood still, so nothing is found of what moves there; the others count'
        findings = [f for f in findings if f.subject not in still]
        findings += [y for x in still for y in about(x, [('warn', 'no_motion', text)])]
    return drives, findings


def standing(
    strokes: Mapping[str, float], idle: Collection[str] = (), ways: Mapping[str, str] | None = None
) -> tuple[str, ...]:
    """Return the drives that stand while others move, by the strokes of all.

    Args:
        strokes: Of each drive, rad or m.
        idle: Drives driven by nothing: they may go round, and are no measure for others.
        ways: Unit of each drive's stroke, which is compared with those in the same.
    """
    units = ways or {}
    moving = [(units.get(x, ''), y) for x, y in strokes.items() if x not in idle]
    longest = {unit: max(y for x, y in moving if x == unit) for unit, _ in moving}
    return tuple(x for x, y in strokes.items() if y < STANDS * longest.get(units.get(x, ''), 0.0))


def _judged(
    drive: DriveSummary, motion: Motion, still: bool, gravity: float, wanted: bool,
    fit: _Fit | None,
) -> Iterator[Said]:  # fmt: skip
    """Yield what is to be said of a drive's excitation, velocity by its fit, and effort.

    Where it is `wanted` to identify the drive, that it stands still is an error.
    """
    if not still:
        yield _of_motion(drive, motion)
        if fit is not None:
            yield _of_velocity(motion, *fit)
    else:
        text = 'does not move beyond the noise of its readings; move it through its working range '
        text += 'while recording'
        yield 'error' if wanted else 'warn', 'no_motion', text
    effort = motion.effort
    if effort is None or np.isfinite(effort).sum() < _FEWEST:
        return
    if np.nanmax(effort) - np.nanmin(effort) <= 1e-9 * np.nanmax(np.abs(effort)):
        text = f'the effort is {np.nanmax(effort):g} all the time'
        text += f'; name another topic or column, {_NOT_DRIVEN}'
        yield 'error', 'effort_constant', text
    elif not still:
        yield from _of_effort(motion, effort)
        if gravity and math.isfinite(drive.effort_rest):
            yield _of_gravity(drive.effort_rest, float(np.nanstd(effort)), gravity)


def _of_counts(position: FloatArray) -> Iterator[Said]:
    """Say it where positions (T,) are whole numbers, as no angle in rad or travel in m is."""
    values = np.unique(position[np.isfinite(position)])
    if _whole(values):
        text = f'all positions are whole numbers from {values[0]:g} to {values[-1]:g}, which '
        text += 'looks like counts or degrees; state their unit, or a scale to rad or m'
        yield 'warn', 'position_unit', text


def _whole(values: FloatArray) -> bool:
    """Return whether values are whole numbers, and many, as counts and percents are."""
    each = np.unique(values)
    return each.size >= _WHOLE and bool(np.abs(each - np.round(each)).max() < 1e-9)


def _of_motion(drive: DriveSummary, motion: Motion) -> Said:
    """Judge whether a drive moved in a way that tells its parameters apart."""
    turns = motions.count_reversals(motion.velocity)
    text = f'stroke {drive.stroke:.3g}, top speed {np.abs(motion.velocity).max():.3g}, {turns} '
    text += f'reversals, {100.0 * motion.resting.mean():.0f} % of the time at rest'
    if turns == 0:
        text += '; Coulomb friction cannot be told from a constant force: record the way back too'
        return 'warn', 'one_way', text
    if turns < 3:
        text += '; four or more at different speeds tell friction, inertia and offset apart'
        return 'warn', 'few_reversals', text
    return 'ok', 'excitation', text


def _velocity_fit(motion: Motion) -> _Fit | None:
    """Fit the reported velocity by the derivative of the position; None where one is not there."""
    if motion.reported is None or np.isfinite(motion.reported).sum() < 20:
        return None
    reported = motion.slowly(fill_gaps(motion.reported))
    lag, gain, share = motions.best_lag(
        motion.velocity[:, None], reported, motion.period, _EARLIEST
    )
    return lag, float(gain[0]), share


def _of_time(rates: Sequence[float], period: float) -> list[Said]:
    """Return what is said of the time where all joints' velocities are off by one factor.

    Args:
        rates: Their reported velocities over the derivatives of their positions.
        period: From row to row, as the time was read, s.
    """
    middle = float(np.median(rates)) if len(rates) > 1 else 1.0
    off = not 0.9 < middle < 1.1 and all(0.9 * middle < x < 1.1 * middle for x in rates)
    if not off or _between_units(middle):
        return []
    text = f'the reported velocities of all {len(rates)} joints are {middle:.4g} times the '
    text += 'derivatives of their positions: the time is '
    if unit := next((x for x, size in _PARTS.items() if 0.9 < middle * size < 1.1), ''):
        text += f'in {unit} and was read as s; state `unit: {unit}` of it in the column map, '
        return [('error', 'time', f'{text}unless all velocities are in another unit')]
    text += f'no time in s ({_fitting(middle, period)}), or all velocities '
    return [('warn', 'time', f'{text}are those of motors before a gear; correct the one')]


def _between_units(factor: float) -> bool:
    """Return whether a factor of velocities is one between units of angles."""
    return any(0.97 < factor * x < 1.03 for x in _BETWEEN)


def _fitting(factor: float, period: float) -> str:
    """Return with which rate of rows, s apart as read, velocities off by a factor agree."""
    rate = f'{factor / period:.4g}'
    return f'with {rate} rows a second, in a column map `time: {{rate: {rate}}}`, they agree'


def _of_velocity(motion: Motion, lag: float, gain: float, share: float) -> Said:
    """Compare the reported velocity with the derivative of the position."""
    text = f'the reported velocity is {gain:.3g} times the derivative of the position and '
    text += f'explains {100.0 * max(share, 0.0):.0f} % of it'
    if share < 0.5 or not 0.9 < gain < 1.1:
        remedy = 'correct its unit, sign or source in the driver, or leave it out'
        # Alone it does not show whether it is the velocity or the time that is off.
        if share >= KNOWN and gain > 0.0 and not _between_units(gain):
            remedy += f', unless the time is no time in s ({_fitting(gain, motion.period)})'
        return 'warn', 'velocity', f'{text}; {remedy}'
    if abs(lag) > max(0.6 * motion.period, 1e-3):
        # the samples between which it is looked for
        low, high = (x / motion.period for x in (_EARLIEST, motions.LATEST))
        edge = not math.floor(low) + 0.5 < lag / motion.period < math.ceil(high) - 0.5
        text = f'the reported velocity is {abs(lag) * 1e3:.3g} ms {"late" if lag > 0 else "early"}'
        text += ' or more' * edge
        return 'warn', 'velocity_lag', f'{text}; the position is the better measurement'
    return 'ok', 'velocity', text


def _explained_moving(motion: Motion, effort: FloatArray, lag: float) -> float:
    """Return the share of an effort, `lag` s late, that is explained while the drive moves.

    At rest friction holds whatever is asked of it, up to its most. 0 where it hardly moves.
    """
    late = 0 if math.isnan(lag) else round(lag / motion.period)
    columns, moving = motion.regressors, ~motion.resting
    moving[moving.size - late :] = False
    at = np.flatnonzero(moving)
    if at.size < _FEWEST * columns.shape[1]:
        return 0.0
    asked, left = motion.slowly(fill_gaps(effort))[at + late], columns[at]
    left = asked - left @ np.linalg.lstsq(left, asked, rcond=None)[0]
    return 1.0 - float(np.var(left)) / max(float(np.var(asked)), 1e-300)


def _of_effort(motion: Motion, effort: FloatArray) -> Iterator[Said]:
    """Judge sign and kind of the effort from what accelerations and velocities say."""
    # A recording does not show which of its joints load each other.
    sign = sign_of(motion, alone=True)
    yield 'error' if sign in WRONG else 'ok', 'effort_sign', SAID[sign]
    if sign in WRONG:
        return
    values = effort[np.isfinite(effort)]
    moved = effort[np.isfinite(effort) & ~motion.resting]
    # A drive that moves has friction to overcome.
    if 2 * np.count_nonzero(moved) < moved.size:
        text = f'the effort is exactly 0 in {100.0 * np.mean(moved == 0.0):.0f} % of the samples '
        text += 'in which the drive moves; log it in finer steps, '
        yield 'warn', 'effort_idle', f'{text}{_NOT_DRIVEN}'
        return
    top = np.abs(values).max()
    if _whole(values):
        what = 'percent of the rated torque' if top <= 300.0 else 'milliamperes or counts'
        text = f'all efforts are whole numbers up to {top:g}, which looks like {what}; state '
        text += 'effort_unit with torque_constant or rated_torque in the machine file'
        yield 'warn', 'effort_unit', text
    lag, share = effort_lag(motion, effort)
    if sign == 'open' and not motion.beside.size and backward(motion, effort):
        text = f'a negative inertia, friction and gravity explain {100.0 * share:.0f} % of the '
        text += 'effort: unless what is not logged loads this joint, its sign is reversed against '
        text += 'the motion; for this log negate the torque_constant, of a table the scale'
        yield 'warn', 'effort_backward', text
        return
    share = max(share, _explained_moving(motion, effort, lag))
    text = f'inertia, friction and gravity of this joint explain {100.0 * share:.0f} % of its '
    if share < 0.3:
        text += 'effort; other joints load it, or the effort is no torque of this drive'
        yield 'warn', 'effort_unexplained', text
    else:
        late = f', about {lag * 1e3:.2g} ms late' if lag > max(motion.period, 2e-3) else ''
        yield 'ok', 'effort', f'{text}effort{late}'


def _of_gravity(at_rest: float, spread: float, gravity: float) -> Said:
    """Look for the weight in the effort at rest, where gravity acts along the drive."""
    text = f'gravity acts along this drive and the effort at rest is {at_rest:.3g}'
    remedy = ''
    if abs(at_rest) < 0.05 * spread:
        remedy = '; log the whole torque, not one with gravity compensated, or set gravity to 0'
    elif at_rest * gravity < 0.0:
        remedy = '; it has to hold the drive: check the signs of position and effort'
    return 'warn' if remedy else 'ok', 'effort_gravity', text + remedy


def render(report: Report) -> list[str]:
    """Return a report as lines of text."""
    alike: dict[tuple[str, str], list[Finding]] = {}
    for x in report.findings:
        alike.setdefault((x.level, x.sentence.removeprefix(f'{x.subject}: ')), []).append(x)
    findings = [
        f'{first.level:5s} {first.sentence}{likewise(x.subject for x in others)}'
        for first, *others in alike.values()
    ]
    return [report.source or 'recording', '', *findings]
