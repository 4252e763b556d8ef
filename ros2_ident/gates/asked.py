# SPDX-License-Identifier: Apache-2.0
"""Does a drive make the effort that it is asked for, and if not: at which instants?

A drive that is told its effort reports it late, and less what its own rotor takes:

    effort(t) = factor asked(t - late) + offset + viscous speed + inertia acceleration

No model of the machine is in this. What is left was added by somebody else, or by the drive.
"""

from dataclasses import dataclass, replace
import math

import numpy as np

from ros2_ident.arrays import Array, highest
from ros2_ident.errors import IdentError
from ros2_ident.gates import scale
from ros2_ident.gates.instants import peaks_of, robust_fit, robust_size, robust_weights
from ros2_ident.models import Machine
from ros2_ident.recording import Dataset, smooth_motion
from ros2_ident.recording.motion import allowed_cutoff, fill_gaps, low_pass

# Values compared in each period of the band's end: four times what Nyquist asks for. By hand.
_VALUES = 8.0
# Periods of the band below which nothing is said. By hand.
_SHORTEST = 10.0
# An effort that stands out does so by this share of the highest. By hand.
_SMALL = 0.2
# A drive that makes less than it is asked for at this share of its largest effort is limited,
# where most of all that is left lies there. By hand.
_LIMITED = 0.9


@dataclass(frozen=True)
class Event:
    """Effort of a drive that was not commanded.

    Attributes:
        recording: Its number, from 1.
        time: Instant of the peak, or start, s since the start of the recording.
        effort: Peak, or middle value [unit of the effort].
        end: When it ended, s; NaN where only the peak is known.
    """

    drive: str
    recording: int
    time: float
    effort: float
    end: float = math.nan

    @property
    def when(self) -> str:
        """Its instant, or from when to when it lasted, in words."""
        return f'{self.time:.2f}{"" if math.isnan(self.end) else f" to {self.end:.2f}"} s'


@dataclass(frozen=True)
class Asked:
    """How a drive makes the effort that it is asked for.

    Attributes:
        late: By how much, s.
        factor: Effort made per effort asked for; NaN where a control law asks for it.
        usual: Standard deviation of what is left where nothing stands out, N m or N.
        pushes: What stands out; the next four are NaN where nothing does.
        share: Share of all that is left which stands out.
        size: RMS of what stands out over the whole log.
        certain: Highest push in standard deviations of what is usual at its instant.
        count: Values compared.
        limit: Size of effort beyond which it made less than it was asked for; inf for none.
    """

    drive: str
    late: float
    factor: float
    usual: float
    pushes: tuple[Event, ...] = ()
    share: float = math.nan
    size: float = math.nan
    certain: float = math.nan
    count: float = math.nan
    limit: float = math.inf


@dataclass(frozen=True)
class _Log:
    """Signals that the law is fitted to, below the band's end: (T,) values.

    Attributes:
        start: Time of the first value, s.
        step: Time from value to value, s.
        cycle: Time from value to value of `asked`, s.
        asked: The effort asked for, whole and at every cycle.
        effort: The effort made.
        beside: (T, 3) one, speed and acceleration.
        scatter: Of the stamps about the instants that they stand for, s.
        noise: Least standard deviation of the effort.
    """

    start: float
    step: float
    cycle: float
    asked: Array
    effort: Array
    beside: Array
    scatter: float
    noise: float

    def late(self, by: float) -> Array:
        """Return the effort asked for a while ago."""
        cycles = (self.start - by + self.step * np.arange(self.effort.size)) / self.cycle
        out: Array = np.interp(cycles, np.arange(self.asked.size), self.asked)
        return out


def fit_asked(machine: Machine, data: Dataset, drive: str, recording: int = 1) -> Asked | None:
    """Compare a drive's effort with the one that it was asked for.

    Returns:
        How it makes its effort, None where it is not told it.
    """
    log = _log_of(machine, data, data.names.index(drive))
    if log is None:
        return None
    fits = []
    for lag in np.arange(0.0, scale.LATEST_EFFORT, log.cycle):
        columns = np.concatenate([log.late(lag)[:, None], log.beside], axis=1)
        fits.append((lag, *robust_fit(columns, log.effort, log.noise)))
    late, solution, left = min(fits, key=lambda f: float(np.log1p((f[2] / log.noise) ** 2).sum()))
    size = max(robust_size(left), log.noise)
    weight = robust_weights(left, size) ** 2
    apart = log.effort - float(weight @ log.effort) / float(weight.sum())
    if float(weight @ left**2) > (1.0 - scale.OWN) * float(weight @ apart**2):
        return None  # the command asks for a part of it only
    asked = Asked(drive, float(late), float(solution[0]), size)
    stamped = log.scatter * np.abs(np.gradient(log.late(late), log.step))
    usual = np.hypot(size, float(solution[0]) * stamped)
    if is_limited(log.effort, left, usual):
        return replace(asked, limit=float(np.abs(log.effort).max()))
    peaks = peaks_of(left, scale.STANDS_OUT * usual, log.step, _SMALL)
    if peaks is None:
        return asked
    rest = float(np.sqrt(np.mean(left[~peaks.inside] ** 2)))
    top = float((np.abs(left) / np.maximum(usual, rest))[peaks.at].max())
    if top < scale.STANDS_OUT:
        return asked
    square = float((left[peaks.inside] ** 2).sum())
    pushes = tuple(
        Event(
            drive, recording, log.start + log.step * (p + highest(np.abs(left), p)), float(left[p])
        )
        for p in peaks.at.tolist()
    )
    return replace(
        asked,
        pushes=pushes,
        share=square / float((left**2).sum()),
        size=math.sqrt(square / left.size),
        certain=top,
        count=left.size,
    )


def _log_of(machine: Machine, data: Dataset, d: int) -> _Log | None:
    """Return a drive's log, None where a part of it is missing, too short, or does not change."""
    if data.command_effort is None or data.effort is None or data.position is None:
        return None
    asked, effort = data.command_effort[d], data.effort[d]
    if not np.isfinite(asked).all() or not np.ptp(asked) or not np.isfinite(effort).any():
        return None
    band = machine.number('bandwidth') if machine.known('bandwidth') else scale.SLOW
    band = min(band, scale.SLOW)
    band = min(band, 0.5 * allowed_cutoff(data.position[d], data.cycle, 2.0 * band))
    if data.duration < (_SHORTEST + 2.0 * scale.ENDS) / band:
        return None
    try:
        motion = smooth_motion(data.position[d : d + 1], data.cycle, 2.0 * band)
    except IdentError:
        return None
    ends = int(scale.ENDS / (band * data.cycle))
    stride = max(1, int(1.0 / (_VALUES * band * data.cycle)))
    kept = slice(ends, asked.size - ends, stride)
    rows = np.stack([asked, fill_gaps(effort), motion[1][0], motion[2][0]])
    slow = low_pass(rows, data.cycle, band)
    beside = np.stack([np.ones_like(slow[1, kept]), slow[2, kept], slow[3, kept]], axis=1)
    stream = data.streams.get('effort') or data.streams.get('state')
    jitter = 0.0 if stream is None else stream.jitter
    return _Log(
        ends * data.cycle, stride * data.cycle, data.cycle,
        slow[0], slow[1, kept], beside,
        # A sample stands at the nearest cycle.
        math.hypot(jitter, data.cycle / math.sqrt(12.0)),
        # White noise, of which the band lets a part through.
        max(
            machine.effort_noise * math.sqrt(2.0 * band * data.cycle),
            1e-6 * float(np.ptp(slow[1, kept])),
        ),
    )  # fmt: skip


def is_limited(effort: Array, left: Array, usual: Array) -> bool:
    """Whether most of the residual lies where the drive makes its largest effort."""
    most = float(np.abs(effort).max())
    short = (left * effort < 0.0) & (np.abs(effort) > _LIMITED * most)
    short &= np.abs(left) > scale.STANDS_OUT * usual
    return float(left[short] @ left[short]) > scale.MOSTLY * float(left @ left)
