# SPDX-License-Identifier: Apache-2.0
"""Linear axes: one carriage on one motor each, through an elastic gear or rigid."""

from ros2_ident.arrays import Array
from ros2_ident.kernel import rows
from ros2_ident.models.drives.separate import SeparateDrives


class LinearAxis(SeparateDrives):
    """The tripod's drive without rods, gravity along the axis adjustable; see `DriveModel`."""

    def _constants(self) -> Array:
        base: Array = rows.neutral_rows(1, len(self.machine.drives))[0]
        base[rows.row_of('gravity')] = self.machine.number('gravity')
        self._drive_constants(base)
        return base
