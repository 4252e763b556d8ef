# SPDX-License-Identifier: Apache-2.0
"""An arm of links and joints that a recorded motion drives."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
import functools

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.effects import Context
from ros2_ident.machine.machine import Machine, Parameter
from ros2_ident.models.drives.model import Compiled, DriveModel
from ros2_ident.models.protocol import Output
from ros2_ident.models.serial.arm import Arm, arm_of
from ros2_ident.models.serial.kernel import simulate, sizes
from ros2_ident.models.serial.parameters import Inertials, Transmission

# What a model and all that extend it have in common, made once: for 20 s of seven joints it takes
# longer than a hundred candidates.
_COMMON = ('arm', 'inertials', 'transmission', '_recorded', '_driven', '_terms', '_firsts')


class Serial(DriveModel):
    """The effort of every joint along the recorded motion; see `DriveModel`.

    A set-point that the log holds is not looked at: what an arm's controllers are is not known.
    """

    @functools.cached_property
    def arm(self) -> Arm:
        """The rigid bodies."""
        return arm_of(self.machine)

    @functools.cached_property
    def inertials(self) -> Inertials:
        """Unknown part of the links."""
        return Inertials(self.machine, self.arm)

    @functools.cached_property
    def transmission(self) -> Transmission:
        """Transmission between motors and links."""
        return Transmission(self.machine)

    def as_described(self, given: Mapping[str, float]) -> dict[str, float]:
        """Return the base parameters of the links as described, see `FullModel.as_described`."""
        return self.inertials.as_described(self.machine, given)

    def _take_over(self, like: DriveModel) -> None:
        super()._take_over(like)
        self.__dict__.update({name: getattr(like, name) for name in _COMMON})

    def _inputs(self) -> tuple[Array, Array, npt.NDArray[np.int64]]:
        return self._recorded

    @functools.cached_property
    def _recorded(self) -> tuple[Array, Array, npt.NDArray[np.int64]]:
        """Set-points, motion and what drives the joints."""
        return super()._inputs()

    @property
    def _followed(self) -> Array:
        """(3, D, K) the joints' motion that drives the model, by `_lead` ahead of the log."""
        return super().motion

    @functools.cached_property
    def _driven(self) -> Array:
        """(3 * D * K,) the motion of the motors."""
        out: Array = np.einsum('de,xek->xdk', self.transmission.motors, self._followed)
        return np.ascontiguousarray(out).ravel()

    @functools.cached_property
    def _terms(self) -> Array:
        """(D, K, B) terms of the motors' efforts along the recorded motion, made once."""
        links = self.inertials.terms(self.arm.terms(*self._followed))
        balance = self.transmission.terms(self._followed[0])
        joints = np.concatenate([links, balance], axis=2)
        return np.ascontiguousarray(self.transmission.at_motors(joints))

    @property
    def motion(self) -> Array:
        """(3, D, K) the joints' motion: position, velocity, acceleration."""
        if not self._lead:
            return self._followed
        time = np.arange(self._followed.shape[2]) * self.cycle
        rows = self._followed.reshape(-1, len(time))
        back = [np.interp(time - self._lead, time, row) for row in rows]
        return np.array(back).reshape(self._followed.shape)

    @functools.cached_property
    def _lead(self) -> float:
        """How long before its motion an effort may stand in the log, s."""
        name = 'measurement_delay'
        low = self.machine.bounds[name][0] if name in self.machine.bounds else 0.0
        return max(0.0, -min(low, self.fixed.get(name, 0.0)))

    @property
    def _ahead(self) -> float:
        # Its cycle is that of the log: an arm's controllers are faster, and hold hardly anything.
        return self._lead / self.cycle

    def effort_delay(self, theta: Array) -> Array:
        """Return (D,) how late each drive's effort is logged [s], for one candidate (N,)."""
        return super().effort_delay(theta) - self._lead

    def links_effort(self, change: Array) -> Array:
        """Return (D, K) what links ask that differ from the description by (D, 10) inertials."""
        position, velocity, acceleration = self.motion
        out: Array = self.arm.efforts(position, velocity, acceleration)
        if change.any():
            out = out + self.arm.terms(position, velocity, acceleration) @ change.ravel()
        return out

    @functools.cached_property
    def _firsts(self) -> npt.NDArray[np.int64]:
        """(D,) the first of a joint's terms that is not zero."""
        return np.asarray(np.argmax((self._terms != 0.0).any(axis=1), axis=1))

    @property
    def rigid(self) -> bool:
        """A joint and its rotor move as one."""
        return True

    @property
    def _closed(self) -> bool:
        return False

    @functools.cached_property
    def travels(self) -> tuple[str, ...]:
        """(D,) `m` where a joint slides, else `rad`."""
        return tuple('m' if slides else 'rad' for slides in self.arm.prismatic)

    @property
    def outputs(self) -> tuple[Output, ...]:
        """The efforts, N m or N."""
        found = super().outputs
        units = {'m': 'N', 'rad': 'N m'}
        return tuple(
            replace(output, unit=units[self.travels[place]])
            for output, place in zip(found, self.signals.places, strict=True)
        )

    @property
    def context(self) -> Context:
        """Properties for effects; behind a flexible joint all the other links would move."""
        return replace(super().context, lifted=True)

    @property
    def _boxed(self) -> Machine:
        own = {**self.machine.own_bounds, **self.inertials.rotors}
        return replace(self.machine, own_bounds=own)

    def _own(self) -> Mapping[str, Sequence[Parameter]]:
        return {**self.inertials.parameters, **self.transmission.parameters}

    def rows(self, theta: Array) -> Array:
        """Return (S, R + B) kernel rows of (S, N) candidates, coefficients of the links behind."""
        block = self.candidates.rows(theta)
        self.candidates.of(block, 'log_delay')[:] += self._lead
        own, count = self.candidates.own_values(theta), len(block)
        balance = np.reshape(self.transmission.coefficients(own, count), (-1, count)).T
        return np.concatenate([block, self.inertials.coefficients(own, count), balance], axis=1)

    def _steps(self, block: Array, *, fast: bool = False) -> npt.NDArray[np.int64]:
        return np.ones(len(block), dtype=np.int64)

    @property
    def _kernel(self) -> Compiled:
        given = self._terms, self._firsts, self._driven, self.candidates.on, self.cycle
        return simulate, sizes(len(self.machine.drives)), given
