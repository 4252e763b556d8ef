# SPDX-License-Identifier: Apache-2.0
"""The noise floor of a log: what no model can explain.

Where the command repeats, what repeats is the model's fault and what does not is noise: half the
mean square difference of successive repeats is the noise variance, whatever the model leaves out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Literal

import numpy as np
from scipy.stats import chi2

from ros2_ident.arrays import Array
from ros2_ident.gates.scale import STEP
from ros2_ident.recording import Dataset
from ros2_ident.search.noise import NoiseModel

Method = Literal['repeats', 'prediction']

# Half a 95 % interval in standard errors.
NORMAL = 1.96
# Two stretches of command are one motion where they differ by less than this share in the square.
_SAME = 1e-3
# Squares beyond so many standard deviations are clipped: impacts do not count.
_CLIP = 2.0
# A repeat has to last so long, s.
_SHORTEST = 0.5
# Noise beyond so many times what is stated, whose samples hang together so that their own past
# leaves only this part of them open, is something that moves; so is noise of which the past leaves
# less than the last where none is stated.
_BEYOND, _OPEN, _SLOWEST = 4.0, 0.5, 0.05


@dataclass(frozen=True)
class Floor:
    """Standard deviation of what no model can explain.

    Attributes:
        per_drive: (D,) floor, in the unit of the residual.
        low: (D,) lower end of its 95 % interval.
        high: (D,) upper end.
        method: What it was estimated from.
        noise: (D,) size and colour of the noise.
    """

    per_drive: Array
    low: Array
    high: Array
    method: Method
    noise: tuple[NoiseModel, ...]

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
        spread = np.log(np.maximum(self.high, 1e-300) / np.maximum(self.low, 1e-300))
        normal = generator.standard_normal((count, self.per_drive.size))
        drawn: Array = self.per_drive * np.exp(0.5 / NORMAL * spread * normal)
        return drawn


def repeated(residuals: Sequence[Array], datasets: Sequence[Dataset]) -> Array | None:
    """Return (D,) the noise by the recordings whose command repeats; None where none does.

    Args:
        residuals: For each recording (D, K) measured less simulated output; NaN at cycles without
            a sample.
        datasets: The recordings.

    Reference:
        von Neumann (1941), Annals of Mathematical Statistics 12(4); ASME V&V 20-2009 for what is
        made of it.
    """
    differences = []
    for residual, dataset in zip(residuals, datasets, strict=True):
        period = find_repeats(dataset)
        if period is not None:
            # Successive ones, so that slow drift stays out.
            differences.append(residual[:, period:] - residual[:, :-period])
    if not differences:
        return None
    square = np.hstack(differences) ** 2
    if not np.isfinite(square).any(axis=1).all():
        return None
    most = _CLIP**2 * np.nanmedian(square, axis=1) / chi2.median(1)
    clipped = np.nanmean(np.minimum(square, most[:, None]), axis=1)
    # Mean of min(x^2, c^2) for a normal x.
    kept = chi2.cdf(_CLIP**2, 3) + _CLIP**2 * chi2.sf(_CLIP**2, 1)
    out: Array = np.sqrt(0.5 * clipped / kept)
    return out


def find_repeats(dataset: Dataset) -> int | None:
    """Find the shortest motion that the whole command consists of.

    Args:
        dataset: The recording.

    Returns:
        Cycles from one start to the next; None where there is no command or nothing repeats.
    """
    if dataset.command_velocity is None:
        return None
    stride = max(1, round(STEP / dataset.cycle))
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
    return _refine(dataset.command_velocity, coarse * stride, stride)


def _refine(velocity: Array, coarse: int, stride: int) -> int | None:
    """Return the lag in cycles near `coarse` where the command repeats best; None if badly."""
    best: tuple[float, int] = (math.inf, coarse)
    for lag in range(max(1, coarse - stride), coarse + stride + 1):
        one, two = velocity[:, :-lag], velocity[:, lag:]
        total = float((one**2).sum() + (two**2).sum())
        best = min(best, (float(((one - two) ** 2).sum()) / max(total, 1e-300), lag))
    return best[1] if best[0] < _SAME else None
