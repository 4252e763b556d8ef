# SPDX-License-Identifier: Apache-2.0
"""The tripod of Ludwig and Gerstmayr 2011, section 4, and the delta: three drives, all coupled."""

from functools import cached_property, partial
from typing import ClassVar

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.kernel import rows
from ros2_ident.kernel.drive import CLOSED_LOOP
from ros2_ident.models.drives.model import Compiled, DriveModel
from ros2_ident.models.tripod.kernel import ROOM, simulate, STATE
from ros2_ident.models.tripod.reach import sense

_DIRECTIONS = slice(rows.MACHINE.rail_x, rows.MACHINE.rail_y_3 + 1)


class Tripod(DriveModel):
    """Three motors, gears and carriages, and a platform on massless rods; see `DriveModel`."""

    features = frozenset({'platform'})
    # Whether the drives turn arms, as the kernel takes it: a type of its own.
    arms: ClassVar[bool | None] = None

    @cached_property
    def _told(self) -> Array:
        """(7 * K,) what the kernel is told: set-points, their rates, and the payload carried."""
        held = np.zeros(self.data.cycles) if self.held is None else self.held
        return np.concatenate([self.log.command.ravel(), held])

    def rows(self, theta: Array) -> Array:
        """Return (S, R) kernel rows of (S, N) candidates in physical units."""
        block = super().rows(theta)
        of = partial(self.candidates.of, block)
        of('rail_inverse_radius')[:] = 1.0 / of('rail_radius')
        azimuth = of('rail_azimuth')
        directions = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=2)
        others = directions[:, 1:] - directions[:, :1]
        block[:, _DIRECTIONS] = np.concatenate(
            [directions[:, 0], *others.swapaxes(0, 1), *np.linalg.inv(others).swapaxes(0, 1)],
            axis=1,
        )
        return block

    @property
    def _kernel(self) -> Compiled:
        effects = self.candidates
        # Without effects their hooks are not compiled.
        flags = effects.on if effects.on.any() else None
        # The usual case has a kernel of its own, without branches in a step.
        mode = self.log.mode
        usual = flags is None and (mode == CLOSED_LOOP).all()
        inputs = self._told, self.log.followed.ravel(), None if usual else mode, flags
        given = *inputs, effects.delayed, effects.frame, self.arms, self.cycle, self.law
        return simulate, (STATE, ROOM), given


class Delta(Tripod):
    """Three motors, gears and arms, and a platform on rods; see `Tripod`. Positions are angles."""

    arms: ClassVar[bool | None] = True

    def _constants(self) -> Array:
        base = super()._constants()
        base[rows.MACHINE.arm_sense] = sense(self.machine)
        return base
