# SPDX-License-Identifier: Apache-2.0
"""The tripod of Ludwig and Gerstmayr 2011, section 4: three vertical drives, all coupled."""

import numpy as np

from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.kernel import rows
from ros2_ident.kernel.drive import CLOSED_LOOP
from ros2_ident.kernel.group import Group, Task
from ros2_ident.lanes import room
from ros2_ident.machine.machine import constant
from ros2_ident.models.drives.model import Array, DriveModel
from ros2_ident.models.tripod.kernel import ROOM, simulate, STATE


class Tripod(DriveModel):
    """Three motors, gears and carriages, and a platform on massless rods; see `DriveModel`."""

    name = 'tripod'

    def _constants(self) -> Array:
        base: Array = rows.neutral_rows(1, 3)[0]
        geometry = self.machine.geometry
        for key in ('rail_radius', 'rod_length', 'gravity'):
            base[rows.row_of(key)] = constant(geometry, key, 'geometry')
        azimuth = np.asarray(geometry.get('rail_azimuth', ()), dtype=float)
        if azimuth.shape != (3,):
            raise IdentError(
                ErrorCode.BAD_MACHINE_FILE,
                'machine file: geometry.rail_azimuth needs three angles in rad',
            )
        direction = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
        difference = np.linalg.inv(direction[1:] - direction[0])
        self._grid = np.concatenate([difference.ravel(), direction.ravel()])
        self._drive_constants(base)
        return base

    @property
    def _state(self) -> int:
        return STATE

    def _run(self, group: Group, begin: int, end: int, task: Task) -> None:
        flags = self._flags
        # The usual case has a kernel of its own, without branches in a step.
        usual = flags is None and (self._mode == CLOSED_LOOP).all()
        simulate(
            *group,
            room(ROOM),
            begin,
            end,
            self._command,
            self._motion,
            None if usual else self._mode,
            flags,
            self.candidates.delayed,
            self.candidates.frame,
            self._grid,
            self.gear,
            self.eps,
            self.cycle,
            self.law,
            self.feedforward,
            *task,
        )
