# SPDX-License-Identifier: Apache-2.0
"""Steps of an encoder in the loop, looked for in what the controllers miss of the log.

Whether an encoder is just below or just above its next step decides when a controller reacts, so
no simulation repeats the course of the effort, however exact. But the error of a reading is a
function of the position alone, periodic with the step: what the controller commanded less what it
should have, taken over the position in the log, has a line there and nowhere else.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d

from ros2_ident.gap.case import Case, LAW_SETTLE
from ros2_ident.models import FullModel
from ros2_ident.models.recorded import RecordedMotion

Array = npt.NDArray[np.float64]

# Steps looked for, m (see `FullModel.travel` for joints that turn); a smaller one drowns in the
# resolution of the log's own position.
SMALLEST, LARGEST = 4e-6, 1.5e-4
# Power of a line, in units of its mean, that chance does not reach among all of them.
CLEAR = 45.0
# Mean square, in units of the floor, from which on something else than steps is missed.
LOST = 2500.0
# What is slower is no step, s.
_SLOW = 0.05
_BINS = 2**20


@dataclass(frozen=True)
class CoarseReading:
    """An encoder whose steps show.

    Attributes:
        drive: The drive.
        step: Period of the reading's error over the position [`unit`].
        error: What one period more or less over the whole way would change of it [`unit`].
        power: Power of the line, in units of the mean of all lines.
        unit: Unit of the position.
    """

    drive: str
    step: float
    error: float
    power: float
    unit: str = 'm'


def coarse_readings(case: Case, theta: Array, law: Array) -> tuple[CoarseReading, ...]:
    """Return the drives' encoders whose steps show in any recording, the clearest line of each.

    Args:
        case: The recordings.
        theta: (N,) the nominal fit.
        law: (D,) mean square, in units of the floor, of what the controllers miss.
    """
    best: dict[str, CoarseReading] = {}
    trusted = [d for d, missed in zip(case.drives, law, strict=True) if missed < LOST]
    for part in (case.fit, case.check):
        joint = part.with_effects(())
        for number, seen in enumerate(part.seen):
            model, own = joint.models[number], joint.own(number, theta)[0]
            for drive in trusted:
                found = coarse_reading(model, seen, own, drive)
                if found and (drive not in best or found.power > best[drive].power):
                    best[drive] = found
    return tuple(best.values())


def coarse_reading(
    model: FullModel, seen: RecordedMotion, theta: Array, drive: str
) -> CoarseReading | None:
    """Look for the steps of one drive's encoder.

    Args:
        model: The model on a recording.
        seen: The recording's motion.
        theta: (N,) a candidate, for how late the effort is logged.
        drive: The drive.

    Returns:
        The reading's step where its line stands clear of all others; None else.
    """
    drives = model.data.names if model.machine is None else model.machine.drives
    count = model.data.cycles
    d = drives.index(drive)
    row = model.places.index(drive)
    wanted = np.isfinite(model.measured)
    wanted[np.arange(len(wanted)) != row] = False
    wanted[:, : int(LAW_SETTLE / model.cycle)] = False
    there = np.flatnonzero(wanted[row])
    missed = model.measured[wanted] - model.replay_law(seen, theta[None], wanted)[0]
    when = there - float(model.effort_delay(theta)[row]) / model.cycle
    position = np.interp(when, np.arange(count), seen.values[d * count : (d + 1) * count])
    first = (len(drives) + d) * count
    velocity = np.interp(when, np.arange(count), seen.values[first : first + count])
    rate = there.size / (count * model.cycle)
    fast = missed - uniform_filter1d(missed, max(3, int(_SLOW * rate)))
    span = float(np.ptp(position))
    unit, per_metre = model.travel
    smallest, largest = SMALLEST * per_metre, LARGEST * per_metre
    if span < 3.0 * smallest:
        return None
    # The step itself, and its difference from cycle to cycle, which turns with the direction.
    lines = [_lines(position, fast), _lines(position, fast * np.sign(velocity))]
    power = np.maximum(*lines)
    order = np.arange(power.size) * (_BINS // 2) / _BINS
    inside = (order > span / largest) & (order < span / smallest)
    best = int(np.argmax(np.where(inside, power, 0.0)))
    if power[best] < CLEAR:
        return None
    # A sharp step has multiples of its line; the first of them is the step's own.
    for part in (4, 3, 2):
        low = int(round(best / part))
        near = slice(max(0, low - 2), low + 3)
        if inside[low] and power[near].max() > 0.5 * power[best]:
            best = max(0, low - 2) + int(np.argmax(power[near]))
            break
    step = span / float(order[best])
    return CoarseReading(drive, step, step**2 / span, float(power[best]), unit)


def _lines(position: Array, values: Array) -> Array:
    """Return the power of `values` at every whole number of half periods over the way."""
    span = float(np.ptp(position))
    place = ((position - position.min()) / span * (_BINS // 2 - 1)).astype(int)
    binned = np.bincount(place, values, _BINS)
    out: Array = np.abs(np.fft.rfft(binned)) ** 2 / max(float((values**2).sum()), 1e-300)
    return out
