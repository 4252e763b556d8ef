# SPDX-License-Identifier: Apache-2.0
"""Linear axes: one carriage on one motor each, through an elastic gear or rigid."""

import numpy as np
import numpy.typing as npt

from ros2_ident.models import rows
from ros2_ident.models.axis_kernel import simulate
from ros2_ident.models.drive_model import Array, DriveModel
from ros2_ident.models.machine import constant


class LinearAxis(DriveModel):
    """The tripod's drive without rods; gravity along the axis as the machine file says; see `DriveModel`."""

    name = 'linear_axis'

    @property
    def rigid(self) -> bool:
        """Whether motor and carriage move as one mass: where no gear stiffness is among the parameters."""
        return 'gear_stiffness' not in self.machine.bounds

    def _constants(self) -> Array:
        base = rows.neutral_rows(1, len(self.machine.drives))[0]
        base[rows.row_of('gravity')] = constant(self.machine.geometry, 'gravity', 'geometry', 0.0)
        self._drive_constants(base)
        return base

    def _run(
        self, blocks: Array, steps: npt.NDArray[np.int64], torque: Array, finite: Array
    ) -> None:
        simulate(
            blocks,
            steps,
            self._command,
            self._motion,
            self._mode,
            self._on,
            self._delayed,
            self.rigid,
            self.gear,
            self.eps,
            self.cycle,
            self.law,
            self.feedforward,
            torque,
            finite,
        )
