# SPDX-License-Identifier: Apache-2.0
"""Prior knowledge of the parameters of a machine, from an earlier result."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
import math

import numpy as np
import numpy.typing as npt

from ros2_ident.errors import ErrorCode
from ros2_ident.machine.units import plain_unit

Array = npt.NDArray[np.float64]

# An eigenvalue of a correlation matrix below this is rounding, as is a deviation below this share
# of its value.
_ROUNDED = 1e-9


@dataclass(frozen=True)
class Prior:
    """Normal distribution of parameters, from an earlier result.

    A fit counts it as it counts its own samples, by noise alone: so one log after the other gives
    what both together give. Intervals allow for what the earlier model may have lacked.

    Attributes:
        sha256: Hash of the log that it was found from; empty where it is not known.
        deviations: Standard deviations by name; inf where nothing is known.
        noise: The same for noise alone.
        correlation: (N, N) correlations in the order of `values`; NaN where they are not known.
    """

    source: str = ''
    sha256: str = ''
    values: Mapping[str, float] = field(default_factory=dict)
    deviations: Mapping[str, float] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    correlation: tuple[tuple[float, ...], ...] = ()

    def without(self, starts: tuple[str, ...]) -> 'Prior':
        """Return it without the parameters whose names start like one of these."""
        kept = [not name.startswith(starts) for name in self.values]
        values = {n: v for (n, v), k in zip(self.values.items(), kept, strict=True) if k}
        rows = [tuple(compress(row, kept)) for row in compress(self.correlation, kept)]
        return replace(self, values=values, correlation=tuple(rows))

    def rows(self, names: Sequence[str], *, noise: bool) -> tuple[Array, Array]:
        """Return rows (L, N) and a mean (N,): their product with a deviation from it is of size 1.

        Args:
            names: The N parameters; the mean of one that nothing is known of is NaN.
        """
        deviations = self.noise if noise else self.deviations
        known = [name for name in self.values if name in names and self._known(name)]
        at = [list(self.values).index(name) for name in known]
        mean, columns = np.full(len(names), np.nan), [names.index(name) for name in known]
        mean[columns] = [self.values[name] for name in known]
        sizes = [max(deviations[n], _ROUNDED * abs(self.values[n])) for n in known]
        alike = np.reshape(self.correlation, (len(self.values),) * 2)[np.ix_(at, at)]
        values, vectors = np.linalg.eigh(np.where(np.isnan(alike), np.eye(len(at)), alike))
        rows = np.zeros((len(at), len(names)))
        rows[:, columns] = (vectors / np.sqrt(np.maximum(values, _ROUNDED))).T / np.array(sizes)
        return rows, mean

    def _known(self, name: str) -> bool:
        deviation = self.deviations[name]
        return math.isfinite(deviation) and max(deviation, abs(self.values[name])) > 0.0

    def check(self, free: Mapping[str, tuple[float, float, str]], drives: Sequence[str]) -> None:
        """Hold it against the parameters of a machine.

        Args:
            free: (low, high, unit) of each parameter of the machine by name.
            drives: Drives that are not looked at, whose parameters may be missing there.

        Raises:
            IdentError: INVALID_GOAL where it is of another machine.
        """
        remedy = 'give a result of this machine, or leave out --from'
        for name, value in self.values.items():
            if name not in free:
                if name.startswith(tuple(f'{drive}.' for drive in drives)):
                    continue
                raise ErrorCode.INVALID_GOAL.error(
                    f'{self.source} holds {name}, which is no parameter of this machine; {remedy}'
                )
            low, high, unit = free[name]
            if plain_unit(unit) != plain_unit(self.units[name]):
                raise ErrorCode.INVALID_GOAL.error(
                    f'{self.source} holds {name} in {self.units[name]}, and the machine file has '
                    f'it in {unit}; {remedy}'
                )
            if not low <= value <= high:
                raise ErrorCode.INVALID_GOAL.error(
                    f'{self.source} holds {name} = {value:.6g}, and the machine file bounds it '
                    f'from {low:.6g} to {high:.6g}; widen its bounds, or leave out --from'
                )
