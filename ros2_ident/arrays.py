# SPDX-License-Identifier: Apache-2.0
"""The type of most arrays, their values as plain data, and the width of intervals."""

from collections.abc import Mapping
import math
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
# Half a 95 % interval in standard errors.
NORMAL = 1.96
# Median of the size of a normal number, in standard deviations.
MEDIAN = 0.6744897501960817
# Differences of fourth order keep the noise and lose the motion; their gain on white noise.
_ORDER = 4
_GAIN = math.sqrt(math.comb(2 * _ORDER, _ORDER))
# Numbers of results for which null in a file stands for infinity, not for NaN.
Above = Annotated[float, math.inf]
Below = Annotated[float, -math.inf]


def plain(value: Any) -> Any:
    """Return a value as what JSON can hold: NaN and infinity become None, arrays lists."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def rms(values: Array) -> float:
    """Return the root mean square of values, of which NaN are left out."""
    return float(np.sqrt(np.nanmean(values**2)))


def fast_noise(*series: Array) -> float:
    """Return the standard deviation of what is fast in series of samples, taken as white.

    Args:
        series: Each (R,) a time series; those too short for a difference tell nothing.

    Returns:
        By the median, so that impacts do not count; 0 where there is no difference.

    Reference:
        Hall, Kay and Titterington (1990), Biometrika 77(3).
    """
    fast = np.abs(np.concatenate([np.empty(0), *(np.diff(row, _ORDER) for row in series)]))
    return float(np.median(fast / _GAIN)) / MEDIAN if fast.size else 0.0


def highest(height: Array, peak: int) -> float:
    """Return where a peak is highest, in steps from it, by a parabola through its neighbours."""
    if not 0 < peak < height.size - 1:
        return 0.0
    before, top, after = height[peak - 1 : peak + 2]
    bend = before - 2.0 * top + after
    return float(0.5 * (before - after) / bend) if bend < 0.0 else 0.0
