# SPDX-License-Identifier: Apache-2.0
"""Information of a planned motion about a machine's parameters."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
import functools
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.excite.course import derived
from ros2_ident.excite.limits import Moved, transmission
from ros2_ident.machine.machine import Machine, Parameter
from ros2_ident.models.protocol import FullModel
from ros2_ident.models.registry import compared_of, drives_moved, planned_model, set_points_of
from ros2_ident.search import finite_differences
from ros2_ident.search.jacobian import Box
from ros2_ident.search.least_squares import BOX_DEVIATION

# Noise of outputs for which a machine file states none, their unit.
_NOISE = 1e-3
# Steps from where a tool should be to where it is.
_NEAR = 4
# How far a machine may be off what is expected, and still has to keep to its limits.
_OFF = 0.25


@dataclass(frozen=True, eq=False)
class Shown:
    """Information of a motion.

    Attributes:
        covariance: (N, N) of an estimate of the parameters at best, in widths of their boxes.
        moved: What the drives do, efforts included; set-points where nothing follows them.
    """

    covariance: Array
    moved: Moved


class Sensitivity:
    """A machine whose parameters have the values that are expected.

    Args:
        values: Expected parameters by name, `gear_stiffness` meaning that of every drive; the
            machine file's, or the middle of the box, where not given.
        drives: Drives that are identified; all where None.
        fixed: Parameters that are known, by name.
        rate: Samples of the log a second; one in every cycle where None.
    """

    def __init__(
        self,
        machine: Machine,
        *,
        values: Mapping[str, float] | None = None,
        drives: Sequence[str] | None = None,
        fixed: Mapping[str, float] | None = None,
        rate: float | None = None,
    ) -> None:
        self.machine = machine
        self._asked: dict[str, Any] = {'drives': drives, 'fixed': fixed}
        self._compared = compared_of(machine)
        cycle = machine.number('cycle')
        self._every = 1 if rate is None else max(1, round(1.0 / (rate * cycle)))
        still = np.zeros((len(machine.drives), 8))
        model = self._model(derived(still, still, cycle))
        self._quantities = tuple(dict.fromkeys(o.quantity for o in model.outputs))
        self.parameters: tuple[Parameter, ...] = model.parameters
        self.values = self._expected(values or {})
        self.box = Box.of([p.low for p in self.parameters], [p.high for p in self.parameters])

    @functools.cached_property
    def _back(self) -> Array:
        """(M, D) speeds of the tool by those of the drives, in the middle of the room."""
        return np.asarray(np.linalg.inv(transmission(self.machine)).astype(np.float64))

    def meant(self, names: Collection[str]) -> npt.NDArray[np.bool_]:
        """Return (N,) which parameters are meant; `gear_stiffness` is that of every drive.

        Raises:
            IdentError: UNKNOWN_PARAMETER for a strange name.
        """
        known = [{p.name, p.name.rpartition('.')[2]} for p in self.parameters]
        for name in names:
            if not any(name in both for both in known):
                raise ErrorCode.UNKNOWN_PARAMETER.error(
                    f'{name!r} is no parameter that is looked for; choose from '
                    f'{", ".join(p.name for p in self.parameters)}'
                )
        return np.array([not both.isdisjoint(names) for both in known])

    def _expected(self, given: Mapping[str, float]) -> Array:
        """Return (N,) the values at which the information is worked out."""
        self.meant(given)
        out = np.empty(len(self.parameters))
        for n, p in enumerate(self.parameters):
            drive, _, base = p.name.rpartition('.')
            named = next((name for name in (p.name, base) if name in given), None)
            if named is not None:
                out[n] = given[named]
            elif base in self.machine.constants and self.machine.stated(base):
                out[n] = self.machine.number(base, drive or None)
            else:
                out[n] = 0.5 * (p.low + p.high)
        return out

    def _model(self, planned: Moved, quantities: Sequence[str] | None = None) -> FullModel:
        at = planned.position, planned.velocity
        return planned_model(self.machine, *at, quantities, **self._asked)

    def of(self, planned: Moved) -> Shown:
        """Return what a log of set-points shows.

        Raises:
            IdentError: DIVERGED where the machine cannot be simulated at the expected values.
        """
        model = self._model(planned, self._quantities)
        told = model.simulate(self.values[None])[0]
        if not np.isfinite(told).all():
            raise ErrorCode.DIVERGED.error(
                'the simulation diverges at the expected parameters; give others with --set'
            )
        moved = self._moved(model, planned, told)
        there = np.zeros(told.shape, dtype=bool)
        compared = [o.quantity in self._compared for o in model.outputs]
        there[compared, :: self._every] = True
        slopes = finite_differences(
            lambda theta: model.simulate_at(theta, there),
            self.box.inside(self.values),
            told[there],
            self.box,
        )
        efforts = self.machine.effort_noise or _NOISE
        noise = np.array([efforts if o.quantity == 'effort' else _NOISE for o in model.outputs])
        slopes /= np.repeat(noise[compared], there[compared].sum(axis=1))[:, None]
        # Fisher information; without any log an even distribution over the box is known.
        known = slopes.T @ slopes + np.eye(len(self.values)) / BOX_DEVIATION**2
        scale = 1.0 / np.sqrt(np.diag(known))
        inverse = np.linalg.inv(known * np.outer(scale, scale)) * np.outer(scale, scale)
        return Shown(np.asarray(inverse), moved)

    def elsewhere(self, planned: Moved) -> tuple[Moved, ...]:
        """Return what the drives do where all parameters are a quarter lower, and higher."""
        model = self._model(planned, self._quantities)
        low, high = self.box.low, self.box.low + self.box.width
        both = [np.clip(x * self.values, low, high) for x in (1.0 - _OFF, 1.0 + _OFF)]
        told = model.simulate(np.array(both))
        return tuple(self._moved(model, planned, one) for one in told if np.isfinite(one).all())

    def _moved(self, model: FullModel, planned: Moved, told: Array) -> Moved:
        """Return what the drives do: what the model does not tell is as planned."""
        rows = drives_moved(model, planned.position, planned.velocity, told)
        seen = derived(rows['position'], rows['velocity'], model.cycle)
        tool = planned.tool
        if tool is not None:
            # By Newton's method from the plan on, with the slopes in the middle of the room.
            for _ in range(_NEAR):
                there = set_points_of(self.machine, tool, np.zeros_like(tool))[0]
                tool = tool + self._back @ (rows['position'] - there)
        return replace(seen, jerk=None, effort=rows['effort'], tool=tool)

    def half_widths(self, shown: Shown) -> Array:
        """Return (N,) half the 95 % intervals that a log of a motion will give at best."""
        quantile = float(scipy.special.ndtri(0.975))
        return np.asarray(quantile * np.sqrt(np.diag(shown.covariance)) * self.box.width)
