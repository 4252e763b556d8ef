# SPDX-License-Identifier: Apache-2.0
"""An arm of links and joints that a recorded motion drives."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
import functools

import numpy as np
import numpy.typing as npt

from ros2_ident.effects import Context
from ros2_ident.kernel import rows
from ros2_ident.kernel.group import Group, Task
from ros2_ident.lanes import room
from ros2_ident.machine.parameter import Parameter
from ros2_ident.models.drives.model import Array, DriveModel
from ros2_ident.models.protocol import Output
from ros2_ident.models.serial.arm import Arm, arm_of
from ros2_ident.models.serial.kernel import room_for, simulate, state_for
from ros2_ident.models.serial.parameters import Inertials


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
        """What of the links is looked for."""
        return Inertials(self.machine, self.arm)

    @functools.cached_property
    def _terms(self) -> Array:
        """(D, K, B) terms along the recorded motion, made once."""
        return self.inertials.terms(self.arm.terms(*self.motion))

    @property
    def motion(self) -> Array:
        """(3, D, K) the motion that drives the model: position, velocity, acceleration."""
        out: Array = self._motion.reshape(3, len(self.machine.drives), -1)
        return out

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
        first: npt.NDArray[np.int64] = np.argmax((self._terms != 0.0).any(axis=1), axis=1)
        return first

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
        """What an arm offers effects; behind a flexible joint all the other links would move."""
        return replace(super().context, lifted=True)

    def _own(self) -> Mapping[str, Sequence[Parameter]]:
        return self.inertials.parameters

    def _constants(self) -> Array:
        base: Array = rows.neutral_rows(1, len(self.machine.drives))[0]
        self._drive_constants(base)
        return base

    def rows(self, theta: Array) -> Array:
        """Return (S, R + B) kernel rows of (S, N) candidates, coefficients of the links behind."""
        block = self.candidates.rows(theta)
        own = self.candidates.own_values(theta)
        return np.concatenate([block, self.inertials.coefficients(own, len(block))], axis=1)

    def finer(self, theta: Array) -> None:
        """Return None: nothing is integrated."""
        return None

    def _steps(self, block: Array, *, fast: bool = False) -> npt.NDArray[np.int64]:
        return np.ones(len(block), dtype=np.int64)

    @property
    def _state(self) -> int:
        return state_for(len(self.machine.drives))

    def _run(self, group: Group, begin: int, end: int, task: Task) -> None:
        simulate(
            *group,
            room(room_for(len(self.machine.drives))),
            begin,
            end,
            self._terms,
            self._firsts,
            self._motion,
            self._flags,
            self.cycle,
            *task,
        )
