# SPDX-License-Identifier: Apache-2.0
"""Efforts as they are compared where the recorded motion drives a model.

Measured and simulated efforts pass the same low-pass without phase, as the motion does, and the
rows that are left are as many as are independent: identification by inverse dynamics as in
Gautier, Janot, Vandanjon, IEEE TCST 21(2), 2013, section III. Samples at which a drive stands are
left out before, for what friction is at rest no motion tells: it is what holds the drive.
"""

from dataclasses import dataclass
import functools

import numpy as np
import numpy.typing as npt

from ros2_ident.recording.smooth import low_pass

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# Rows that are kept for a period of the band's end: so many are independent.
_KEPT = 2.0
# A row has at least this share of the samples about it.
_LEAST = 0.5


@dataclass(frozen=True, eq=False)
class Band:
    """A low-pass of the samples that tell something.

    Attributes:
        cutoff: Frequency of gain one half, Hz.
        cycle: Time from cycle to cycle, s.
        there: (O, K) the samples.
    """

    cutoff: float
    cycle: float
    there: Mask

    @functools.cached_property
    def _share(self) -> Array:
        """(O, K) share of the cycles about each that are samples."""
        return low_pass(self.there.astype(float), self.cycle, self.cutoff)

    @functools.cached_property
    def _usual(self) -> Array:
        """(O, 1) cycles from one sample to the next."""
        steps = [np.diff(np.flatnonzero(row)) for row in self.there]
        return np.array([[np.median(s) if s.size else 1.0] for s in steps])

    @property
    def passes(self) -> float:
        """Share of white noise that passes, by its standard deviation."""
        return float(np.sqrt(min(1.0, 2.0 * self.cutoff * self.cycle * self._usual.max())))

    @functools.cached_property
    def _told(self) -> Mask:
        """(O, K) where there are samples enough."""
        told: Mask = self._share * self._usual > _LEAST
        return told

    @functools.cached_property
    def rows(self) -> Mask:
        """(O, K) what is compared."""
        stride = max(1, int(1.0 / (_KEPT * self.cutoff * self.cycle)))
        out = np.zeros_like(self.there)
        out[:, ::stride] = True
        return out & self._told

    def passed(self, efforts: Array) -> Array:
        """Return efforts (..., O, K) behind the low-pass; as they are where samples are few."""
        low = low_pass(np.where(self.there, efforts, 0.0), self.cycle, self.cutoff)
        return np.where(self._told, low / np.where(self._told, self._share, 1.0), efforts)
