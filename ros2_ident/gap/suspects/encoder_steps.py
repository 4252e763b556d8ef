# SPDX-License-Identifier: Apache-2.0
"""Steps of an encoder in the loop, looked for in the controllers' error on the log.

Whether an encoder is just below or just above its next step decides when a controller reacts, so
no simulation repeats the course of the effort, however exact. But the error of a reading is a
function of the position alone, periodic with the step: what the controller commanded less what it
should have, taken over the position in the log, has a line there and nowhere else.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
import math

import numpy as np
import scipy

from ros2_ident.arrays import Array
from ros2_ident.effects import get_effect, shown_by
from ros2_ident.gap.recordings import Part, Split
from ros2_ident.gates.scale import LATEST_EFFORT
from ros2_ident.models import EffectAt
from ros2_ident.models.protocol import recorded_motion
from ros2_ident.recording.motion import step_of

# Steps over the way that are looked for: fewer may be what a gear or a motor repeats, and smaller
# ones drown in the resolution of the log's own position. By hand.
FEWEST, MOST = 200, 40_000
# A line's period is looked at again by its neighbours, so many periods over the way to either
# side.
_NEAR = np.arange(-2.0, 2.1, 0.5)
# Power of a line of white noise, in units of its mean, that one in 100,000 logs reaches anywhere:
# ln(lines / p), of two series at half periods (Fisher 1929, Proc. R. Soc. A 125). The density of
# coloured noise may be twice its mean: by hand. At a period that is known few lines are looked at.
_CHANCE = 1e-5
CLEAR = 2.0 * math.log(4 * (MOST - FEWEST) / _CHANCE)
_AGAIN = math.log(2 * _NEAR.size / _CHANCE)
# Logarithm of the odds of a line that is clear in one part and there again in the other.
SURE = -2.0 * math.log(_CHANCE)
# What is slower is no step, s. By hand.
_SLOW = 0.05
# A step is a controller's from so many of those in which the log holds its positions on: theirs
# says how the log was written, and of an encoder the next one is twice as large.
_OWN = 1.5
# How much more than any other line's, so many lines away from its multiples, its power has to be.
# By hand.
_STANDS, _ASIDE = 2.5, 100
# Share of its power in the line half as far on, from which on the clearest line is a second one: a
# saw-tooth's second line has a quarter of the first one's power.
_HALVED = 0.25
# The way falls into so many bins, 3.3 for each of the smallest steps, of whose power 0.73 is left
# then, sinc(1 / 3.3) squared; twice as many would leave 0.93 and take twice as long.
_BINS = 2**17
# Cycles between the position that a controller read and the one logged beside its effort; what the
# steps do to the nominal fit bends the delay that it finds. A grid.
_LAGS = np.arange(-2.5, 2.5, 0.25)


@dataclass(frozen=True)
class EncoderSteps:
    """An encoder whose steps show.

    Attributes:
        step: Period of the reading's error over the position [`unit`].
        error: What one period more or less over the whole way would change of it [`unit`].
        unit: Unit of the position.
    """

    drive: str
    step: float
    error: float = 0.0
    unit: str = 'm'

    @property
    def at(self) -> EffectAt:
        """The effect that the steps show, at its place."""
        effect = shown_by('reading_steps')
        assert effect is not None, 'steps are looked for where the catalogue has their effect'
        return EffectAt(effect.id, self.drive)

    @property
    def name(self) -> str:
        """Name of the step as the effect's parameter."""
        (step,) = get_effect(self.at.effect).parameters
        return f'{self.at.prefix}{step.name}'


def find_encoder_steps(split: Split, theta: Array) -> tuple[EncoderSteps, ...]:
    """Detect encoder steps: a line in one part of the recordings, confirmed on the other.

    Args:
        split: The recordings.
        theta: (N,) the nominal fit.
    """
    found = []
    unit, _ = split.fit.models[0].travel
    for drive in split.drives:
        logs = (model.data for model in split.whole.models)
        rows = [x[d.names.index(drive)] for d in logs if (x := d.position) is not None]
        own = _OWN * max((step_of(row[np.isfinite(row)]) for row in rows), default=0.0)
        for one, other in ((split.fit, split.check), (split.check, split.fit)):
            step, error = _step_in(_missed(one, theta, drive))
            # A line that chance or another cause makes is not there again at the same period.
            again = (_power_at(step, *way) >= _AGAIN for way in _missed(other, theta, drive))
            if step > own and any(again):
                found.append(EncoderSteps(drive, step, error, unit))
                break
    return tuple(found)


def made_by_steps(encoders: Sequence[EncoderSteps], split: Split, theta: Array) -> Array:
    """Return (D,) the change of each drive's output by encoders' steps, RMS in its unit.

    When a controller reacts to a step no simulation repeats; how much it reacts it does.

    Args:
        split: The recordings.
        theta: (N,) the nominal fit.
    """
    if not encoders:
        return np.zeros(len(split.drives))
    joint = split.whole.with_effects([r.at for r in encoders])
    both = np.append(theta, np.zeros(len(encoders))), np.append(theta, [r.step for r in encoders])
    without, there = joint.residual(np.stack(both))
    out: Array = np.sqrt(np.nanmean(split.whole.rows(there - without) ** 2, axis=1))
    return out


def _step_in(missed: Iterable[tuple[Array, Array, Array]]) -> tuple[float, float]:
    """Return the step of the clearest line and its error; 0 where none stands clear of all."""
    lines = ((*_clearest(*way), span) for way in missed if (span := float(np.ptp(way[0]))) > 0.0)
    step, _, stands, span = max(lines, key=lambda x: (x[2], x[1]), default=(0.0, 0.0, 0, 1.0))
    return (step, step**2 / span) if stands else (0.0, 0.0)


def _power_at(step: float, position: Array, velocity: Array, fast: Array) -> float:
    """Return the power of a step's line, in units of the mean of all, about its period."""
    span = float(np.ptp(position))
    turn = 2j * np.pi * (position - position.min()) / max(span, 1e-300)
    both = np.stack([fast, fast * np.sign(velocity)])
    power = max(np.abs(both @ np.exp(n * turn)).max() ** 2 for n in span / step + _NEAR)
    return float(power) / max(float(fast @ fast), 1e-300)


def _missed(part: Part, theta: Array, drive: str) -> Iterator[tuple[Array, Array, Array]]:
    """Yield position, velocity and the controllers' error on the log, for each lag.

    Where the controllers cannot be replayed, for too few of their cycles are logged, the nominal
    fit's residual stands for what they miss: the machine hardly answers to steps.

    Args:
        part: The recordings.
        theta: (N,) the nominal fit, for how late the effort is logged.
    """
    joint = part.with_effects(())
    for number, model in enumerate(joint.models):
        drives = model.data.names if model.machine is None else model.machine.drives
        seen, own = part.seen[number] if part.seen else None, joint.own(number, theta)[0]
        data = model.data
        motion = seen
        if seen is None and data.position is not None and data.effort is not None:
            known = np.isfinite(data.position).any(axis=1).all()
            motion = recorded_motion(data, drives) if known else None
        if motion is None:
            continue
        row = model.places.index(drive)
        logged = model.measured if seen is None else model.replayed
        wanted = np.isfinite(logged)
        wanted[np.arange(len(wanted)) != row] = False
        wanted[:, : int(LATEST_EFFORT / model.cycle)] = False
        there = np.flatnonzero(wanted[row])
        if seen is None:
            made = model.simulate_at(own[None], wanted)[0]
        else:
            made = model.replay_law(seen, own[None], wanted)[0]
        missed = logged[wanted] - made
        count = data.cycles
        rate = there.size / (count * model.cycle)
        fast = missed - scipy.ndimage.uniform_filter1d(missed, max(3, int(_SLOW * rate)))
        acted = there - float(model.effort_delay(own)[row]) / model.cycle
        ways = motion.values.reshape(2, len(drives), count)[:, drives.index(drive)]
        for lag in _LAGS:
            position, velocity = (np.interp(acted - lag, np.arange(count), x) for x in ways)
            yield position, velocity, fast


def _clearest(position: Array, velocity: Array, fast: Array) -> tuple[float, float, bool]:
    """Return the step of the clearest line, its power, and whether it is clear as no other is."""
    span = float(np.ptp(position))
    # The step itself, and its difference from cycle to cycle, which turns with the direction.
    lines = [_lines(position, x, _BINS) for x in (fast, fast * np.sign(velocity))]
    power = np.maximum(*lines)
    order = 0.5 * np.arange(power.size)
    inside = (order > FEWEST) & (order < MOST)
    best = int(np.argmax(np.where(inside, power, 0.0)))
    # A sharp step has multiples of its line; the first of them is the step's own.
    for part in (4, 3, 2):
        low = int(round(best / part))
        near = slice(max(0, low - 2), low + 3)
        if inside[low] and power[near].max() > 0.5 * power[best]:
            best = max(0, low - 2) + int(np.argmax(power[near]))
            break
    if power[best] < CLEAR:
        return 0.0, float(power[best]), False
    # A step beyond those looked for shows by its second line: then halves are multiples, too.
    turns = np.arange(power.size) / max(best, 1)
    apart = np.abs(turns - np.maximum(np.round(2.0 * turns), 1.0) / 2.0) * best > _ASIDE
    others = float(np.max(power, where=inside & apart, initial=0.0))
    # What comes again at the same places, as in a motion that is repeated, makes many lines.
    stands = power[best] > _STANDS * others
    third = int(round(1.5 * best))
    halved = power[third - 3 : third + 4].max(initial=0.0) > _HALVED * power[best]
    step = span / max(float(order[best]), 1e-300) * (2.0 if halved else 1.0)
    return step, float(power[best]), bool(stands)


def _lines(position: Array, values: Array, bins: int) -> Array:
    """Return the power of `values` at every whole number of half periods over the way."""
    span = float(np.ptp(position))
    place = ((position - position.min()) / span * (bins - 1)).astype(int)
    # Single precision tells a line as well, in half the time.
    binned = np.bincount(place, values, 2 * bins).astype(np.float32)
    line = scipy.fft.rfft(binned)
    out: Array = (line.real**2 + line.imag**2) / max(float((values**2).sum()), 1e-300)
    return out
