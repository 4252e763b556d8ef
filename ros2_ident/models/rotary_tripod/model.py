# SPDX-License-Identifier: Apache-2.0
"""A tripod with rotary drives: three arms on shafts, rods and a platform, all coupled."""

from typing import ClassVar

from ros2_ident.arrays import Array
from ros2_ident.kernel import rows
from ros2_ident.models.tripod.model import Tripod

# Constants by the rows they fill, of the machine and of each drive.
_MACHINE = {
    'shaft_radius': 'rail_radius',
    'rod_length': 'rod_length',
    'arm_length': 'arm_length',
    'gravity': 'gravity',
}
_DRIVE = {
    'shaft_azimuth': 'rail_azimuth',
    'arm_inertia': 'rail_mass',
    'arm_moment': 'arm_moment',
    'arm_zero': 'arm_zero',
}


class Delta(Tripod):
    """Three motors, gears and arms, and a platform on rods; see `Tripod`. Positions are angles."""

    arms: ClassVar[bool | None] = True

    def _constants(self) -> Array:
        base: Array = rows.neutral_rows(1, 3)[0]
        for key, row in _MACHINE.items():
            base[rows.row_of(row)] = self.machine.number(key)
        base[rows.row_of('arm_sense')] = 1.0 if self.machine.text('positive') == 'up' else -1.0
        self._drive_constants(base)
        for key, row in _DRIVE.items():
            for d, value in enumerate(self.machine.numbers(key)):
                base[rows.row_of(row, d)] = value
        return base
