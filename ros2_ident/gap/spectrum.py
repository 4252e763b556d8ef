# SPDX-License-Identifier: Apache-2.0
"""Peaks in the spectrum of a residual: oscillations that the motion does not ask for."""

from dataclasses import dataclass
import math

import numpy as np
import scipy

from ros2_ident.arrays import Array
from ros2_ident.gates.scale import MOSTLY
from ros2_ident.recording.motion import LOWEST

# Segments of about a second, but so many at least: a density is then known to a third. By hand.
_SEGMENTS = 6
# A coordinate is cut into so many bins; a line goes round so often over it at least; its frequency
# is found to such a part of one round. A grid; the least number of rounds by hand.
_BINS, _FEWEST, _FINER = 8192, 4, 16
# Of the motion's acceleration this share of the power lies below its band's end. By hand.
_POWER = 0.95


@dataclass(frozen=True)
class Peak:
    """A band that stands above its surroundings.

    Attributes:
        frequency: Where it is highest, Hz.
        low: Lower end of the band, Hz.
        high: Upper end, Hz.
        size: RMS of what stands above the surroundings, in the residual's unit.
        p_value: Probability of so high a peak anywhere by chance.
    """

    frequency: float
    low: float
    high: float
    size: float
    p_value: float


def spectrum(row: Array, cycle: float) -> tuple[Array, Array, int]:
    """Return frequencies [Hz], a residual's averaged periodogram and the segments averaged.

    Args:
        row: (K,) residual, NaN where there is no sample.
        cycle: Time from column to column, s.

    Returns:
        (F,) frequencies, (F,) periodogram, 1 for white noise of variance 1; and the segments, 0
        where the row is too short.

    Reference:
        Welch (1967), IEEE Transactions on Audio and Electroacoustics 15(2).
    """
    there = np.flatnonzero(np.isfinite(row))
    if there.size < 64:
        return np.zeros(0), np.zeros(0), 0
    stride = int(np.bincount(np.diff(there)).argmax())
    even = row[int(there[0]) % stride :: stride]
    even = np.where(np.isfinite(even), even, 0.0)
    rate = 1.0 / (stride * cycle)
    length = int(min(rate, even.size // _SEGMENTS))
    # The numbers of `scipy.signal.welch`: to import that package takes longer than all this.
    window = 0.5 + 0.5 * np.cos(np.linspace(-np.pi, np.pi, length + 1)[:-1])
    window *= 1.0 / math.sqrt(sum(window**2) / (1.0 / rate))
    parts = np.lib.stride_tricks.sliding_window_view(even, length)[:: length - length // 2]
    found = scipy.fft.rfft(parts * window).T
    power = np.ascontiguousarray(found.real**2 + found.imag**2).mean(axis=1)
    return scipy.fft.rfftfreq(length, 1.0 / rate), rate * power, len(parts)


def find_peak(row: Array, cycle: float, noise: float, low: float) -> Peak | None:
    """Find the highest peak above its surroundings, beyond a frequency.

    Args:
        row: (K,) residual, NaN where there is no sample.
        cycle: Time from column to column, s.
        noise: Noise floor; its density is the least that the surroundings are taken for.
        low: Frequency from which on to look, Hz.

    Returns:
        The peak, significant or not; None where there is nothing to look at.
    """
    frequency, power, segments = spectrum(row, cycle)
    if not segments or noise <= 0.0:
        return None
    power = power / noise**2
    inside = np.flatnonzero((frequency > low) & (frequency < MOSTLY * frequency[-1]))
    if inside.size < 8:
        return None
    around = np.array([_beside(power, frequency, float(f)) for f in frequency[inside]])
    ratio = power[inside] / around
    # Hann windows that overlap by half share a sixth of their amplitude.
    freedom = 2.0 * segments / (1.0 + 2.0 / 36.0)
    top = int(np.argmax(ratio))
    p_value = float(min(1.0, inside.size * scipy.special.chdtrc(freedom, ratio[top] * freedom)))
    # Down to a quarter of its height, half its amplitude.
    high = ratio > max(1.0, 0.25 * ratio[top])
    high[top] = True
    bands = scipy.ndimage.label(high)[0]
    here = bands == bands[top]
    band = inside[here]
    excess = float((power[band] - around[here]).sum())
    size = noise * math.sqrt(max(0.0, excess / (frequency.size - 1)))
    peak = float(frequency[band[int(np.argmax(power[band]))]])
    return Peak(peak, float(frequency[band[0]]), float(frequency[band[-1]]), size, p_value)


def lines(values: Array, place: Array, count: int = 4) -> Array:
    """Return the strongest periodic functions of a coordinate in a residual.

    Args:
        values: (T,) residual.
        place: (T,) the coordinate: time, or a position.
        count: How many.

    Returns:
        (T, 2 L) a cosine and a sine of each; none where the coordinate does not change.
    """
    span = float(np.ptp(place)) if place.size else 0.0
    if span <= 0.0:
        return np.empty((place.size, 0))
    turn = (place - place.min()) / span
    number = np.minimum((turn * _BINS).astype(np.int64), _BINS - 1)
    columns = np.ones((place.size, 1))
    for _ in range(count):
        left = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
        power = np.abs(np.fft.rfft(np.bincount(number, left, _BINS), _FINER * _BINS))
        power[: _FINER * _FEWEST] = 0.0
        wave = 2.0 * np.pi * int(power.argmax()) / _FINER * turn
        columns = np.column_stack([columns, np.cos(wave), np.sin(wave)])
    out: Array = columns[:, 1:]
    return out


def motion_band(acceleration: Array, cycle: float) -> float:
    """Return the frequency below which an acceleration has nearly all its power, Hz.

    Args:
        acceleration: (K,).
        cycle: Time from column to column, s.
    """
    power = np.abs(np.fft.rfft(acceleration - acceleration.mean())) ** 2
    total = np.cumsum(power) / max(float(power.sum()), 1e-300)
    frequency = np.fft.rfftfreq(acceleration.size, cycle)
    return max(LOWEST, float(frequency[int(np.argmax(total > _POWER))]))


def _beside(power: Array, frequency: Array, at: float) -> float:
    """Return the higher of the median densities below and above a frequency, at least 1.

    A peak stands above both of its sides; a slope, as coloured noise has, only above one.
    The sides are 0.4 to 1.2 octaves away: by hand.
    """
    medians = [1.0]
    for low, high in ((0.4, 0.75), (1.35, 2.2)):
        side = power[(frequency >= low * at) & (frequency <= high * at)]
        if side.size:
            medians.append(float(np.median(side)))
    return max(medians)
