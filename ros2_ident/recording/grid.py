# SPDX-License-Identifier: Apache-2.0
"""Which controller cycle each sample was taken at.

Samples are taken at controller instants, usually at every m-th; their stamps scatter around them.
The stamps give m from their typical spacing, the phase of the grid, and the number of every
sample.
"""

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording.streams import FloatArray, IntArray

# A stream counts as sampled every m-th cycle where its spacing is within this share of a multiple
# of the cycle.
_RATE_TOLERANCE = 0.02
# Clocks of controller and stamps may run apart by this share before the given cycle must be wrong.
_DRIFT_LIMIT = 1e-3
# Cycles of one recording: 28 hours at 1 kHz.
_MOST_CYCLES = 1e8
# From this share on it is said that the cycle is another one on the clock of the stamps. By hand.
TOLD_DRIFT = 2e-5
# No controller is faster or slower, s.
_SHORTEST_CYCLE, _LONGEST_CYCLE = 1e-12, 1e3
# A period of uneven samples is divided by so much.
_PARTS = 1, 2, 4, 8, 16
# Share of samples that may share a cycle: shorter ones cost more than these tell. By hand.
SHARED = 0.01
# So many multiples of the cycle to either side of a stream's spacing are tried.
_MOST_STRIDES = 500
# Length of the mean phase vector below which the stamps do not cluster on the grid.
_CLUSTERED = 0.1
# From this length on rounding to the next cycle is right to five standard deviations.
_SHARP = 0.8


@dataclass(frozen=True)
class Ticks:
    """The cycle numbers of one stream's samples."""

    tick: IntArray  # cycle of each sample (T,), strictly increasing over the kept samples
    raw: FloatArray  # the stamps themselves in cycles since the reference (T,)
    keep: NDArray[np.bool_]  # (T,) False where two samples share a cycle and the later one counts
    stride: int  # cycles between two samples; 0 where the stream does not keep to the grid
    phase: float  # stamp of cycle 0 less the reference, s
    drift: float  # share by which the cycle is longer on the stamps' clock than stated
    jitter: float  # standard deviation of the stamps about the grid, s


def sample_period(stamp: IntArray) -> float:
    """Return the typical spacing of samples, s: robust against drops and jitter; 0 for one sample.

    Args:
        stamp: Stamps (T,), ns, increasing.
    """
    steps = np.diff(stamp)
    if not steps.size:
        return 0.0
    # below the median, which in a short stream with many drops is two periods long
    usual = float(np.quantile(steps, 0.35, method='nearest'))
    # a quantile of jittered steps is biased; the mean of those that are one period long is not
    for _ in range(3):
        usual = float(np.mean(steps[np.abs(steps - usual) < 0.5 * usual]))
    return usual * 1e-9


def missing_samples(stamp: IntArray) -> int | None:
    """Return how many samples did not come, None where they come unevenly, so that none is due.

    They come evenly where they keep to a grid of their own period.

    Args:
        stamp: Stamps (T,), ns, increasing.
    """
    if not (period := sample_period(stamp)):
        return 0
    with suppress(IdentError):  # so slow, or so far apart, that no grid holds them
        ticks = find_ticks(stamp, int(stamp[0]), period)
        return int(np.ptp(ticks.tick)) + 1 - stamp.size if ticks.stride else None
    return None


def cycle_of(stamp: IntArray) -> str:
    """Return the cycle that a machine file states for samples, s, with the digits it needs.

    That is their period where they come evenly, else so short a cycle that hardly two share one.

    Args:
        stamp: Stamps (T,), ns, increasing, at least two.
    """
    cycle = period = sample_period(stamp)
    for parts in _PARTS:
        ticks = find_ticks(stamp, int(stamp[0]), period / parts)
        cycle = period / parts * (1.0 + ticks.drift)
        if ticks.stride or ticks.keep.mean() >= 1.0 - SHARED:
            break
    return short_number(cycle)


def short_number(cycle: float) -> str:
    """Return a cycle, s, with the fewest digits that leave no drift to tell of."""
    texts = (f'{cycle:.{digits}g}' for digits in range(1, 18))
    return next(x for x in texts if abs(float(x) / cycle - 1.0) < 0.5 * TOLD_DRIFT)


def find_ticks(stamp: IntArray, reference: int, cycle: float) -> Ticks:
    """Number the samples of a stream in controller cycles.

    Where the stamps are sharp on the cycles, or the spacing is a multiple of the cycle, numbers
    are the increasing integers nearest to the stamps (isotonic regression, so that no two samples
    share a cycle and jitter averages out); else each stamp is rounded to the next cycle by itself.

    Args:
        stamp: Stamps (T,), ns, strictly increasing.
        reference: The stamp that phases and numbers count from, ns.
        cycle: Controller cycle, s.

    Returns:
        The numbers, counted from the cycle nearest to the reference.

    Raises:
        IdentError: BAD_VALUES where the cycle is no positive time.
    """
    if not _SHORTEST_CYCLE < cycle < _LONGEST_CYCLE:
        text = f'controller cycle is {cycle} s; give a positive time in the machine file'
        raise ErrorCode.BAD_VALUES.error(text)
    time = (stamp - reference).astype(np.float64) * 1e-9
    if (cycles := (time[-1] - time[0]) / cycle) > _MOST_CYCLES:
        text = f'{time[-1] - time[0]:.4g} s are {cycles:.3g} controller cycles of {cycle:g} s, '
        text += f'more than {_MOST_CYCLES:g}; cut the log, or correct its stamps or the cycle'
        raise ErrorCode.BAD_VALUES.error(text)
    if period := sample_period(stamp):
        stride = _stride(time, period, cycle)
        # stamps that are sharp on the cycles themselves need no help from an even spacing, and a
        # recorder that takes now every tenth, now every eleventh cycle would be bent by it
        if (sharp := _regular(time, 1, cycle, _SHARP)) is not None:
            return replace(sharp, stride=stride or max(1, round(period / cycle)))
        even = _regular(time, stride, cycle, _CLUSTERED)
        if even is not None and not _wanders(even):
            return even
    tick = np.round(time / cycle).astype(np.int64)
    keep = np.ones(stamp.size, dtype=np.bool_)
    keep[:-1] = np.diff(tick) > 0
    return Ticks(tick, time / cycle, keep, 0, 0.0, 0.0, float(np.std(time - tick * cycle)))


def _stride(time: FloatArray, period: float, cycle: float) -> int:
    """Return the number of cycles between samples that their times fit best; 0 where none does."""
    steps = np.diff(time)
    single = steps[np.abs(steps - period) < 0.5 * period]
    # two steps have no scatter to go by: allow for a tenth
    scatter = float(np.std(single)) / period if single.size > 2 else 0.1
    slack = _RATE_TOLERANCE + min(0.25, 4.0 * scatter / float(np.sqrt(max(1, single.size))))
    slack = min(slack, _MOST_STRIDES * cycle / period)
    low = max(1, int(np.ceil(period / cycle * (1.0 - slack))))
    able = range(low, int(np.floor(period / cycle * (1.0 + slack))) + 1)
    if len(able) < 2:
        return max(able, default=0)
    return max(able, key=lambda stride: _search(time, stride * cycle)[2])


def _regular(time: FloatArray, stride: int, cycle: float, least: float) -> Ticks | None:
    """Fit phase, drift and numbers of a stream with a sample every `stride` cycles, or None."""
    if not stride:
        return None
    step = stride * cycle
    drift, phase, clustered = _search(time, step)
    # a few random phases cluster too, the fewer the more
    if clustered < max(least, min(0.7, 5.0 / np.sqrt(time.size))):
        return None
    number = _number((time - phase) / (step * (1.0 + drift)))
    for _ in range(4):
        model = step * number.astype(np.float64)
        drift, phase = _line(model, time)
        jitter = float(np.std(time - phase - model * (1.0 + drift)))
        chance = 5.0 * jitter / max(float(np.std(model)) * np.sqrt(time.size), 1e-300)
        if time.size < 3 or abs(drift) < max(chance, 1e-9):
            # no more than chance: two streams of one controller must not differ from noise
            phase += drift * float(np.mean(model))
            drift = 0.0
        elif abs(drift) > _DRIFT_LIMIT:
            return None
        again = _number((time - phase) / (step * (1.0 + drift)))
        if np.array_equal(again, number):
            break
        number = again
    # what lies on no grid scatters evenly over a step, by a step over the root of 12
    if jitter > step / np.sqrt(12.0):
        return None
    # numbers count from the cycle nearest to the reference
    shift = round(phase / (cycle * (1.0 + drift)))
    phase -= shift * cycle * (1.0 + drift)
    tick, keep = number * stride + shift, np.ones(time.size, dtype=np.bool_)
    return Ticks(tick, time / cycle, keep, stride, phase, drift, jitter)


def _wanders(ticks: Ticks) -> bool:
    """Return whether samples came when they did, and only lie near a grid now and then.

    Stamps that scatter about a grid differ more from one to the next than from the grid, sums of
    uneven steps do not: the ratio of their squares, 2 of independent scatter, is von Neumann's
    (1941, Ann. Math. Statist. 12(4)), and 1 is a correlation of one half. Such sums come anywhere
    between two ticks; a loop that is late for a while stays near them. Half the variance of what
    comes anywhere parts these, by hand.
    """
    late = ticks.raw - ticks.tick * (1.0 + ticks.drift)
    anywhere = ticks.stride**2 / 12.0
    return float(np.mean(np.diff(late) ** 2)) < float(np.var(late)) > 0.5 * anywhere


def _search(time: FloatArray, step: float) -> tuple[float, float, float]:
    """Find the grid on which the times cluster best.

    The mean phase vector of short windows turns at a constant rate where the step is longer or
    shorter than stated; the strongest line of its spectrum is that rate.

    Args:
        time: Times (T,), s.
        step: Stated step of the grid, s.

    Returns:
        Drift (a share of the step), phase of the grid, s, and the length of the mean phase vector,
        0 to 1.
    """
    # within a window the largest drift turns the phase by a fifth of a turn
    width = 0.2 * step / _DRIFT_LIMIT
    window = np.floor((time - time[0]) / width).astype(np.int64)
    turned = np.exp(2j * np.pi * time / step)
    count = int(window[-1]) + 1
    sums = np.bincount(window, turned.real, count) + 1j * np.bincount(window, turned.imag, count)
    size = 8 * max(8, 1 << (count - 1).bit_length())
    power = np.abs(np.fft.fft(sums, size))
    # a step longer by the share d makes the phase advance by d * width / step turns per window
    drifts = np.fft.fftfreq(size) * step / width
    power[np.abs(drifts) > _DRIFT_LIMIT] = 0.0
    drift = float(drifts[int(np.argmax(power))])
    # windows cannot tell a drift from none within their resolution; none is likelier
    if np.abs(turned.mean()) * time.size > 0.98 * power.max():
        drift = 0.0
    long = step * (1.0 + drift)
    mean = np.exp(2j * np.pi * time / long).mean()
    return drift, float(np.angle(mean)) / (2.0 * np.pi) * long, float(np.abs(mean))


def _number(position: FloatArray) -> IntArray:
    """Return the strictly increasing integers nearest to positions, by least squares."""
    order = np.arange(position.size)
    rounded = np.round(position).astype(np.int64)
    if (np.diff(rounded) > 0).all() and np.abs(position - rounded).max() < 0.25:
        return rounded
    # strictly increasing integers less their index never decrease: isotonic regression, which
    # SciPy has from 1.12 on only, rounded
    runs: list[tuple[float, int]] = []  # mean and size
    for mean in (position - order).tolist():
        size = 1
        while runs and runs[-1][0] >= mean:
            last, before = runs.pop()
            mean = (last * before + mean * size) / (before + size)
            size += before
        runs.append((mean, size))
    means, sizes = zip(*runs, strict=True)
    return np.asarray(np.round(np.repeat(means, sizes)).astype(np.int64) + order)


def _line(model: FloatArray, time: FloatArray) -> tuple[float, float]:
    """Return slope less one and offset of the line through (model, time), outliers clipped."""
    centre, rest = model.mean(), time - model
    span = model - centre
    slope, level = 0.0, float(np.median(rest))
    spread = float(np.median(np.abs(rest - level)))
    for _ in range(3 if span.any() else 0):
        off = rest - level - slope * span
        bound = max(5.0 * spread, 3.0 * float(np.median(np.abs(off))), 1e-12)
        inside = np.abs(off) <= bound
        x, y = span[inside], rest[inside]
        x0, y0 = x.mean(), y.mean()
        slope = float((x - x0) @ (y - y0) / max(float((x - x0) @ (x - x0)), 1e-30))
        level = float(y0 - slope * x0)
    return slope, level - slope * float(centre)
