# SPDX-License-Identifier: Apache-2.0
"""The noise floor of a log: what no model can explain, estimated from the residual itself.

Where the command repeats, what repeats is the model's fault and what does not is noise: half the
mean square difference of successive repeats is the noise variance, whatever the model leaves out.
Where nothing repeats, the residual's high-frequency part tells: differences of fourth order
suppress what is smooth from sample to sample; taken as white, the rest is scaled up to the band.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Literal

import numpy as np
from scipy.special import gammainc, ndtr
from scipy.stats import t as student

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.recording import Dataset
from ros2_ident.search.noise import NoiseModel, white

Method = Literal['repeats', 'prediction', 'high frequency']

# Differences of this order: the square gain at a fifth of the Nyquist frequency is below 1e-3.
_ORDER = 4
# Squares beyond this many standard deviations are clipped: spikes and impacts do not count.
_CLIP = 3.0
# Samples apart by the usual step, give or take a cycle or this share of it, are as good as even.
_UNEVEN = 0.34
# Squares are averaged over stretches of this many samples, to judge their scatter.
_STRETCH = 50
# Stretches noisier than the quiet ones by this many standard errors hold an effect, not noise.
_LOUD = 3.0
# Two stretches of command are one motion where they differ by less than this share in the square.
_SAME = 1e-3
# A repeat has to last so long, s.
_SHORTEST = 0.5
# The command is compared at this rate, Hz.
_RATE = 200.0
# Noise beyond so many times what is stated, whose samples hang together so that their own past
# leaves only this part of them open, is something that moves; so is noise of which the past leaves
# less than the last where none is stated.
_BEYOND, _OPEN, _SLOWEST = 4.0, 0.5, 0.05


@dataclass(frozen=True)
class Repeats:
    """A motion that the command holds more than once.

    Attributes:
        period: Cycles from one start to the next.
        count: Repeats, counting a last one that is cut short.
    """

    period: int
    count: int


@dataclass(frozen=True)
class Floor:
    """Standard deviation of what no model can explain.

    Attributes:
        per_drive: (D,) floor, in the unit of the residual.
        low: (D,) lower end of its 95 % interval.
        high: (D,) upper end.
        method: What it was estimated from.
        repeats: The repeated motion, where `method` is `repeats`.
        step: (D,) step of the logged effort, 0 where none can be seen.
        noise: (D,) size and colour of the noise.
        sentence: In words.
    """

    per_drive: Array
    low: Array
    high: Array
    method: Method
    repeats: Repeats | None
    step: Array
    noise: tuple[NoiseModel, ...]
    sentence: str

    @property
    def together(self) -> float:
        """Root mean square over the drives, in the unit of the residual."""
        return float(np.sqrt(np.mean(self.per_drive**2)))

    def restless(self, drives: Sequence[str], stated: float) -> dict[str, float]:
        """Return drives whose floor is too large and too slow to be noise, and their floors.

        Args:
            drives: (D,) their names.
            stated: Noise that somebody stated, in the unit of the residual; 0 where nobody did.
        """
        least = _BEYOND * stated
        open_part = _OPEN if stated else _SLOWEST
        return {
            name: float(value)
            for name, value, model in zip(drives, self.per_drive, self.noise, strict=True)
            if value > least and model.innovation < open_part**2 * model.variance
        }

    def draw(self, count: int, generator: np.random.Generator) -> Array:
        """Return (count, D) floors as uncertain as the estimate, for a bootstrap."""
        spread = np.log(np.maximum(self.high, 1e-300) / np.maximum(self.low, 1e-300)) / 3.92
        factor = np.exp(spread * generator.standard_normal((count, self.per_drive.size)))
        drawn: Array = self.per_drive * factor
        return drawn


def noise_floor(
    residual: Array,
    dataset: Dataset,
    drives: Sequence[str] | None = None,
    unit: str = '',
    quantity: str = 'effort',
) -> Floor:
    """Estimate the noise floor of each drive.

    Args:
        residual: (D, K) measured less simulated output; NaN at cycles without a sample.
        dataset: The recording; its command shows what repeats, its samples the step of the log.
        drives: The D drives of the residual; all of the data set's where None.
        unit: Unit of the residual, for the sentence.
        quantity: What of the recording it is a residual of.

    Returns:
        The floor with a 95 % interval.

    Raises:
        IdentError: NO_DATA where a drive has fewer than a hundred samples in a row of even steps.

    Reference:
        Differences: Hall, Kay and Titterington (1990), Biometrika 77(3). Repeats: von Neumann
        (1941), Annals of Mathematical Statistics 12(4); ASME V&V 20-2009 for what is made of it.
    """
    names = dataset.names if drives is None else tuple(drives)
    count = len(residual)
    step = np.zeros(count)
    logged = getattr(dataset, quantity, None)
    if logged is not None:
        step = np.array([step_of(logged[dataset.names.index(n)]) for n in names])
    repeats = find_repeats(dataset)
    value, low, high = (np.full(count, math.nan) for _ in range(3))
    for d, row in enumerate(residual):
        if repeats is not None:
            squares = 0.5 * _successive(row, repeats.period) ** 2
            value[d], low[d], high[d] = _robust(squares)
        else:
            value[d], low[d], high[d] = _high_frequency(row, names[d])
        # Where the step hides the noise, neighbours are equal and their differences tell nothing.
        least = step[d] / math.sqrt(12.0)
        value[d], low[d], high[d] = (max(x, least) for x in (value[d], low[d], high[d]))
    method: Method = 'high frequency' if repeats is None else 'repeats'
    return Floor(
        value, low, high, method, repeats, step, tuple(white(v) for v in value),
        _sentence(value, names, repeats, dataset.cycle, unit),
    )


def pooled_floor(
    residuals: Sequence[Array],
    datasets: Sequence[Dataset],
    drives: Sequence[str] | None = None,
    unit: str = '',
    quantity: str = 'effort',
) -> Floor:
    """Estimate the floor on several recordings of a machine; on those that repeat where some do.

    Args:
        residuals: For each recording (D, K) as for `noise_floor`.
        datasets: The recordings.
        drives: As for `noise_floor`.
        unit: As for `noise_floor`.
        quantity: As for `noise_floor`.

    Returns:
        The mean of the logarithms, weighted by their certainty.

    Raises:
        IdentError: NO_DATA where no recording is long enough.
    """
    found: list[tuple[Floor, Dataset]] = []
    short: IdentError | None = None
    for residual, dataset in zip(residuals, datasets, strict=True):
        try:
            found.append((noise_floor(residual, dataset, drives, unit, quantity), dataset))
        except IdentError as exc:
            short = exc
    if not found:
        raise short or IdentError(ErrorCode.NO_DATA, 'there is no recording; give one')
    found = [f for f in found if f[0].method == 'repeats'] or found
    (first, dataset), *others = found
    if not others:
        return first
    values, low, high = (
        np.array([getattr(f, name) for f, _ in found]) for name in ('per_drive', 'low', 'high')
    )
    half = np.maximum(0.5 * np.log(np.maximum(high, 1e-300) / np.maximum(low, 1e-300)), 1e-6)
    weight = half**-2 / (half**-2).sum(axis=0)
    value = np.exp((weight * np.log(np.maximum(values, 1e-300))).sum(axis=0))
    step = np.max([f.step for f, _ in found], axis=0)
    value = np.maximum(value, step / math.sqrt(12.0))
    factor = np.exp((half**-2).sum(axis=0) ** -0.5)
    names = dataset.names if drives is None else tuple(drives)
    sentence = _sentence(value, names, first.repeats, dataset.cycle, unit)
    return Floor(
        value, value / factor, value * factor, first.method, first.repeats, step,
        tuple(white(v) for v in value), sentence,
    )


def find_repeats(dataset: Dataset) -> Repeats | None:
    """Find the shortest motion that the whole command consists of.

    Args:
        dataset: The recording.

    Returns:
        The repeats, or None where there is no command or nothing repeats.
    """
    if dataset.command_velocity is None:
        return None
    stride = max(1, round(1.0 / (_RATE * dataset.cycle)))
    velocity = dataset.command_velocity[:, ::stride]
    scale = np.sqrt(np.mean(velocity**2, axis=1, keepdims=True))
    velocity = velocity[scale[:, 0] > 0.0] / scale[scale[:, 0] > 0.0]
    size = velocity.shape[1]
    if not velocity.size or size < 8:
        return None
    # Mean square difference of the command and itself, later by each lag, against their squares.
    spectrum = np.fft.rfft(velocity, 2 * size, axis=1)
    product = np.fft.irfft(np.abs(spectrum) ** 2, axis=1)[:, :size].sum(axis=0)
    square = np.concatenate([[0.0], np.cumsum((velocity**2).sum(axis=0))])
    both = square[size : 0 : -1] + (square[size] - square[:size])
    different = 1.0 - 2.0 * product / np.maximum(both, 1e-9 * square[-1])
    # Beyond the command's own smoothness, with at least half of its motion in the overlap.
    apart = int(np.argmax(different > 0.5)) if (different > 0.5).any() else size
    lags = np.arange(size)
    fits = (
        (lags > max(apart, _SHORTEST / (stride * dataset.cycle)))
        & (different < 10.0 * _SAME)
        & (both > square[-1])
    )
    if not fits.any():
        return None
    first = int(np.argmax(fits))
    end = first + int(np.argmin(np.append(fits[first:], False)))
    coarse = first + int(np.argmin(different[first:end]))
    period = _refine(dataset.command_velocity, coarse * stride, stride)
    if period is None:
        return None
    return Repeats(period, math.ceil(dataset.cycles / period - 0.05))


def _refine(velocity: Array, coarse: int, stride: int) -> int | None:
    """Return the lag in cycles near `coarse` where the command repeats best; None if badly."""
    best: tuple[float, int] = (math.inf, coarse)
    for lag in range(max(1, coarse - stride), coarse + stride + 1):
        one, two = velocity[:, :-lag], velocity[:, lag:]
        total = float((one**2).sum() + (two**2).sum())
        best = min(best, (float(((one - two) ** 2).sum()) / max(total, 1e-300), lag))
    return best[1] if best[0] < _SAME else None


def _successive(row: Array, period: int) -> Array:
    """Return differences of successive repeats; successive ones, so that slow drift stays out."""
    difference = row[period:] - row[:-period]
    out: Array = difference[np.isfinite(difference)]
    return out


def _high_frequency(row: Array, name: str) -> tuple[float, float, float]:
    """Return the floor and its interval from what is fast, taken as white."""
    there = np.flatnonzero(np.isfinite(row))
    steps = np.diff(there)
    stride = int(np.bincount(steps).argmax()) if steps.size else 1
    fourth = _differences(row, stride, _ORDER) if there.size else row[:0]
    if fourth.size < 2 * _STRETCH:
        raise IdentError(
            ErrorCode.NO_DATA,
            f'{name}: {there.size} samples are too few or too irregular to tell noise from '
            'motion; record a longer motion at an even rate',
        )
    gain = float(math.comb(2 * _ORDER, _ORDER))
    return _robust(fourth**2 / gain)


def _differences(row: Array, stride: int, order: int) -> Array:
    """Return the differences of samples `stride` cycles apart, only where none is missing.

    Where hardly any keep to that, as in a log by a clock of its own, those of neighbours that are
    apart by about as much.
    """
    there = np.flatnonzero(np.isfinite(row))
    out: Array = np.diff(row[int(there[0]) % stride :: stride], order)
    out = out[np.isfinite(out)]
    if out.size >= 2 * _STRETCH:
        return out
    if there.size <= order:
        return out
    near = np.abs(np.diff(there) - stride) <= max(1.0, _UNEVEN * stride)
    whole = np.lib.stride_tricks.sliding_window_view(near, order).all(axis=1)
    uneven: Array = np.diff(row[there], order)[whole]
    return uneven if uneven.size > out.size else out


def _robust(squares: Array) -> tuple[float, float, float]:
    """Return the root mean of squares of normal numbers; spikes and loud stretches left out.

    Args:
        squares: Squares in order of time, with expectation sigma^2.

    Returns:
        sigma and the ends of its 95 % interval, from the scatter of stretches.
    """
    median = float(np.median(squares))
    if median <= 0.0:
        # More than half the neighbours are equal: a coarse step. The mean still tells its size.
        median = float(np.mean(squares))
        if median <= 0.0:
            return 0.0, 0.0, 0.0
    variance = median / 0.4549364231195724  # the median of a squared normal number
    keep = 1.0 - 2.0 * float(ndtr(-_CLIP))
    # Mean of min(x^2, c^2) for a normal x.
    density = math.exp(-0.5 * _CLIP**2) / math.sqrt(2.0 * math.pi)
    clipped_mean = keep - 2.0 * _CLIP * density + _CLIP**2 * (1.0 - keep)
    groups = max(1, squares.size // _STRETCH)
    ordered = squares[: groups * _STRETCH].reshape(groups, -1)
    mean = np.full(groups, variance)
    quiet = np.ones(groups, dtype=bool)
    for _ in range(20):
        mean = np.minimum(ordered, _CLIP**2 * variance).mean(axis=1) / clipped_mean
        # Where an effort hardly ever changes, again the mean.
        centre = float(np.median(mean)) or float(np.mean(mean))
        scatter = 1.4826 * float(np.median(np.abs(mean - centre)))
        limit = centre + _LOUD * max(scatter, 0.02 * centre)
        quiet = mean <= limit
        # Means of squares are about gamma distributed; what the limit cuts off them is put back.
        shape = (centre / max(scatter, 0.02 * centre)) ** 2
        scaled = shape * limit / centre
        new = float(mean[quiet].mean() * gammainc(shape, scaled) / gammainc(shape + 1.0, scaled))
        if abs(new - variance) < 1e-6 * variance:
            break
        variance = new
    chosen = mean[quiet]
    error = float(chosen.std(ddof=1)) / math.sqrt(chosen.size) if chosen.size > 1 else variance
    half = 0.5 * float(student.ppf(0.975, max(1, chosen.size - 1))) * error / variance
    sigma = math.sqrt(variance)
    return sigma, sigma * math.exp(-half), sigma * math.exp(half)


def step_of(row: Array) -> float:
    """Return the step of a quantised signal, 0 where there is none to be seen."""
    values = np.unique(row[np.isfinite(row)])
    if values.size < 3 or values.size > 0.5 * np.isfinite(row).sum():
        return 0.0
    gaps = np.diff(values)
    gaps = gaps[gaps > 1e-9 * np.abs(values).max()]
    if not gaps.size:
        return 0.0
    step = float(np.percentile(gaps, 5))
    whole = gaps / step
    return step if float(np.abs(whole - np.round(whole)).mean()) < 0.05 else 0.0


def _sentence(
    value: Array,
    names: Sequence[str],
    repeats: Repeats | None,
    cycle: float,
    unit: str,
) -> str:
    parts = ', '.join(f'{n} {v:.3g}' for n, v in zip(names, value, strict=True))
    tail = f' {unit}' if unit else ''
    if repeats is not None:
        return (
            f'noise floor {parts}{tail}: what differs between {repeats.count} repeats of a motion '
            f'of {repeats.period * cycle:.4g} s'
        )
    return f'noise floor {parts}{tail}: from the fast part of the residual, taken as white noise'
