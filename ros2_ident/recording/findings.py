# SPDX-License-Identifier: Apache-2.0
"""Findings of a check of recordings: values, and their rendering as lines of text."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

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
