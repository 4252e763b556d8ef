# SPDX-License-Identifier: Apache-2.0
"""Judge recordings before an hour is spent on them.

Did the streams arrive whole, is there enough motion, and can the effort be a torque?
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any, Literal

import numpy as np

from ros2_ident.errors import IdentError
from ros2_ident.recording.grid import sample_period
from ros2_ident.recording.motion import (
    best_lag,
    count_reversals,
    fill_gaps,
    LATEST,
    Motion,
    motion_of,
)
from ros2_ident.recording.sign import SAID, sign_of, WRONG
from ros2_ident.recording.streams import FloatArray, Recording, Stream, with_positions

# Shares of missing samples from which a warning, and an error, is due.
_MISSING_WARN, _MISSING_ERROR = 0.01, 0.2
# Shorter recordings hardly hold an acceleration, a cruise and a reversal, s.
_SHORT = 2.0
# A drive whose stroke is less than this part of the longest one stands: gears and their control
# give way to what the moving drives do.
STANDS = 0.02
# Fewer efforts are none.
_FEWEST = 10

Level = Literal['ok', 'warn', 'error']
_ORDER: dict[str, int] = {'ok': 0, 'warn': 1, 'error': 2}
# Level, code and sentence of what is found, without its subject.
Said = tuple[Level, str, str]


@dataclass(frozen=True)
class Finding:
    """One thing found.

    Attributes:
        level: `ok`, `warn` (the result may suffer) or `error` (identification is of no use).
        code: A stable short name, as `effort_sign`.
        subject: A stream's role, a drive, or empty for the recording.
        sentence: What was found, and the remedy where there is something to do.
    """

    level: Level
    code: str
    subject: str
    sentence: str


def about(subject: str, said: Iterable[Said]) -> list[Finding]:
    """Return what is found of a stream or a drive, which each sentence names first."""
    return [Finding(level, code, subject, f'{subject}: {text}') for level, code, text in said]


@dataclass(frozen=True)
class StreamSummary:
    """How one stream of one recording arrived.

    Attributes:
        recording: Number of the recording, from 0.
        role: `state`, `effort` or `command`.
        joints: The joints' names.
        fields: The fields that were measured.
        samples: Samples.
        duration: From the first to the last, s.
        rate: Typical rate, Hz; 0 for a single sample.
        jitter: Standard deviation of the steps from sample to sample about the typical one, s,
            gaps left out.
        gaps: Steps of at least 1.5 typical ones.
        longest_gap: The longest step, s.
        missing: Samples that would fill the gaps.
        nan: Samples without a value per measured field and joint, where some but not all are.
        silent: Measured fields and joints without any value, as `effort drive_2`.
    """

    recording: int
    role: str
    joints: tuple[str, ...]
    fields: tuple[str, ...]
    samples: int
    duration: float
    rate: float
    jitter: float
    gaps: int
    longest_gap: float
    missing: int
    nan: tuple[tuple[str, int], ...]
    silent: tuple[str, ...]

    @property
    def missing_share(self) -> float:
        """Missing samples as a share of those expected."""
        return self.missing / max(1, self.samples + self.missing)


@dataclass(frozen=True)
class DriveSummary:
    """How one drive moved in one recording.

    Attributes:
        recording: Number of the recording, from 0.
        drive: Joint name.
        stroke: Largest less smallest position, rad or m.
        top_speed: Largest speed, rad/s or m/s.
        reversals: Changes of the direction of motion.
        rest_share: Share of the time at rest.
        effort_low: Smallest effort, N m or N; NaN where not measured, as the next three.
        effort_high: Largest effort.
        effort_rest: Mean effort at rest.
        effort_lag: How much the effort is late behind the motion, s, as far as a fit can tell.
        explained: Share of the effort's variance that inertia, friction, offset and position
            explain.
    """

    recording: int
    drive: str
    stroke: float
    top_speed: float
    reversals: int
    rest_share: float
    effort_low: float
    effort_high: float
    effort_rest: float
    effort_lag: float
    explained: float


@dataclass(frozen=True)
class Report:
    """The judgement on some recordings.

    Attributes:
        source: Where they come from.
        streams: One entry per stream.
        drives: One entry per drive whose motion was measured.
        findings: Everything found, worst first.
    """

    source: str
    streams: tuple[StreamSummary, ...] = ()
    drives: tuple[DriveSummary, ...] = ()
    findings: tuple[Finding, ...] = ()

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

    Returns:
        The report; its findings carry sentences with the remedy.
    """
    streams: list[StreamSummary] = []
    drives: list[DriveSummary] = []
    findings: list[Finding] = []
    if not recordings:
        text = 'there is no recording; record joint states while the drives move'
        return Report('', findings=(Finding('error', 'no_data', '', text),))
    if len(recordings) > 1 and len({x.source for x in recordings}) == 1:
        text = (
            f'the stamps step back, or nothing came for long: the log falls into '
            f'{len(recordings)} segments; each is judged and used by itself'
        )
        findings.append(Finding('warn', 'segments', '', text))
    for number, recording in enumerate(recordings):
        findings += [Finding('warn', 'reading', '', text) for text in recording.warnings]
        if not number:
            findings += [Finding('ok', 'topics', '', text) for text in recording.notes]
        for role, stream in recording.streams.items():
            streams.append(summarise(number, role, stream))
            findings += about(role, _of_stream(streams[-1]))
        findings += _judge_recording(recording)
        found, said = _judge_drives(number, recording, wanted, gravity)
        drives += found
        findings += said
    if 'effort' not in need:
        findings = [f for f in findings if not f.code.startswith('effort_')]
    return Report(recordings[0].source, tuple(streams), tuple(drives), tuple(findings))


def summarise(number: int, role: str, stream: Stream) -> StreamSummary:
    """Describe how a stream of the recording of a number arrived."""
    steps = np.diff(stream.stamp) * 1e-9
    period = sample_period(stream.stamp)
    gap = steps > 1.5 * period
    nan: list[tuple[str, int]] = []
    silent: list[str] = []
    for field, values in stream.fields.items():
        for name, count in zip(stream.names, np.isnan(values).sum(axis=0).tolist(), strict=True):
            if count == stream.stamp.size:
                silent.append(f'{field} {name}')
            elif count:
                nan.append((f'{field} {name}', count))
    return StreamSummary(
        recording=number,
        role=role,
        joints=stream.names,
        fields=tuple(stream.fields),
        samples=stream.stamp.size,
        duration=stream.duration,
        rate=1.0 / period if period else 0.0,
        jitter=float(np.std(steps[~gap])) if (~gap).any() else 0.0,
        gaps=int(gap.sum()),
        longest_gap=float(steps.max()) if steps.size else 0.0,
        missing=int((np.round(steps[gap] / period) - 1).clip(0).sum()) if period else 0,
        nan=tuple(nan),
        silent=tuple(silent),
    )


def _of_stream(x: StreamSummary) -> Iterator[Said]:
    """Judge rate, gaps and missing values of one stream."""
    text = f'{x.samples} samples at {x.rate:.6g} Hz'
    period = 1.0 / x.rate if x.rate else 0.0
    if period and x.jitter > 0.15 * period and x.gaps > 0.02 * x.samples:
        text += (
            f', but the steps scatter by {x.jitter * 1e3:.3g} ms and {x.gaps} are far longer; log '
            'from the control loop itself where that is possible'
        )
        yield 'warn', 'irregular', text
    elif x.missing_share > _MISSING_WARN:
        text += (
            f', {100.0 * x.missing_share:.3g} % of the samples are missing, the longest gap lasts '
            f'{x.longest_gap:.3g} s; record on the machine itself, or with a larger cache'
        )
        yield 'error' if x.missing_share > _MISSING_ERROR else 'warn', 'missing', text
    else:
        text += f', {x.missing or "none"} missing, stamps scatter by {x.jitter * 1e3:.3g} ms'
        yield 'ok', 'rate', text
    for name in x.silent:
        remedy = ': it was not measured'
        if x.role != 'effort' and name.startswith('effort'):
            remedy = '; name the topic that carries the effort, or switch its measurement on'
        yield 'warn', 'nan', f'every value of the {_of(name)} is NaN{remedy}'
    for name, count in x.nan:
        if (share := count / x.samples) > _MISSING_WARN:
            text = (
                f'{100.0 * share:.3g} % of the values of the {_of(name)} are missing or NaN; they '
                'are left out; check the driver if you expected them'
            )
            yield 'warn', 'nan', text


def _of(name: str) -> str:
    """Return `effort of a` for `effort a`, a field and its joint."""
    return name.replace(' ', ' of ', 1)


def _judge_recording(recording: Recording) -> Iterator[Finding]:
    """Judge what a recording holds as a whole."""
    if recording.duration < _SHORT:
        text = (
            f'the recording lasts {recording.duration:.2g} s; record at least {_SHORT:g} s with '
            'acceleration, cruise and reversal'
        )
        yield Finding('warn', 'short', '', text)
    if recording.command is None:
        text = (
            'there is no command stream: the recorded motion will drive the model, which leaves '
            'the controller untested; record the set-point too where there is one'
        )
        yield Finding('warn', 'no_command', 'command', text)


def _judge_drives(
    number: int, recording: Recording, wanted: Sequence[str] | None, gravity: float
) -> tuple[list[DriveSummary], list[Finding]]:
    """Judge motion and effort of every drive."""
    names = recording.state.names if recording.state else ()
    recording, integrated = with_positions(recording, names)
    state = recording.state
    if state is None or state.position is None:
        text = 'no position was recorded, so excitation and effort cannot be judged; record the '
        return [], [Finding('warn', 'no_position', 'state', f'{text}joint states')]
    drives: list[DriveSummary] = []
    findings: list[Finding] = []
    for name in state.names if wanted is None else wanted:
        if name not in state.names:
            continue
        summary, said = _judge_drive(number, recording, name, gravity, wanted is not None)
        # An integrated speed says nothing of the speed.
        vacuous = name in integrated
        findings += [f for f in said if not (vacuous and f.code.startswith('velocity'))]
        if summary is not None:
            drives.append(summary)
    if still := standing({x.drive: x.stroke for x in drives}):
        listed = ', '.join(still)
        text = f'{listed}: stood still, so nothing is found of what moves there; the others count'
        findings = [f for f in findings if f.subject not in still]
        findings.append(Finding('warn', 'no_motion', listed, text))
    return drives, findings


def standing(strokes: Mapping[str, float]) -> tuple[str, ...]:
    """Return the drives that stand while others move, by the strokes of all."""
    longest = max(strokes.values(), default=0.0)
    return tuple(name for name, stroke in strokes.items() if stroke < STANDS * longest)


def _judge_drive(
    number: int, recording: Recording, name: str, gravity: float, wanted: bool
) -> tuple[DriveSummary | None, list[Finding]]:
    """Judge one drive's excitation and effort.

    Args:
        gravity: Gravity along the drive, m/s^2; 0 where it does not act or is not known.
        wanted: Whether the drive is to be identified, so that standing still is an error.

    Returns:
        The drive's summary, None where there are too few samples, and the findings.
    """
    try:
        motion = motion_of(recording, name)
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


def render(report: Report) -> list[str]:
    """Return a report as lines of text."""
    lines = [report.source or 'recording', '']
    for columns, entries in ((_STREAM, report.streams), (_DRIVE, report.drives)):
        if entries:
            rows = [[text(x) for text in columns.values()] for x in entries]
            lines += [*_table([list(columns), *rows]), '']
    return lines + [f'{x.level:5s} {x.sentence}' for x in report.findings]


def _known(value: float, text: str) -> str:
    """Return the text on a value, a dash where it is not known."""
    return '-' if value != value else text


# Columns of a report's tables.
_STREAM: Mapping[str, Callable[[Any], str]] = {
    'segment': lambda x: str(x.recording + 1),
    'stream': lambda x: x.role,
    'joints': lambda x: str(len(x.joints)),
    'fields': lambda x: '+'.join(x.fields),
    'samples': lambda x: str(x.samples),
    'time': lambda x: f'{x.duration:.2f} s',
    'rate': lambda x: f'{x.rate:.6g} Hz',
    'jitter': lambda x: f'{x.jitter * 1e3:.3g} ms',
    'missing': lambda x: f'{100.0 * x.missing_share:.2g} %',
}
_DRIVE: Mapping[str, Callable[[Any], str]] = {
    'segment': lambda x: str(x.recording + 1),
    'drive': lambda x: x.drive,
    'stroke': lambda x: f'{x.stroke:.4g}',
    'top speed': lambda x: f'{x.top_speed:.3g}',
    'reversals': lambda x: str(x.reversals),
    'at rest': lambda x: f'{100.0 * x.rest_share:.0f} %',
    'effort': lambda x: _known(x.effort_low, f'{x.effort_low:.3g} .. {x.effort_high:.3g}'),
    'late': lambda x: _known(x.effort_lag, f'{x.effort_lag * 1e3:.0f} ms'),
    'explained': lambda x: _known(x.explained, f'{100.0 * x.explained:.0f} %'),
}


def _table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return lines with aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        '  '.join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
