# SPDX-License-Identifier: Apache-2.0
"""Linear axes: one carriage on one motor each, through an elastic gear or rigid."""

from collections.abc import Sequence

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.kernel import rows
from ros2_ident.models.drives.separate import SeparateDrives

# A velocity gain next to nothing, and the feedforward that makes a set-point's rate the effort.
_NO_GAIN, _THROUGH = 2.0**-40, 2.0**40


class LinearAxis(SeparateDrives):
    """The tripod's drive without rods, gravity along the axis adjustable; see `DriveModel`.

    Under the law `effort` no controller is simulated: the logged effort holds from each sample to
    the next, and the motion that it causes is compared.
    """

    @property
    def pushed(self) -> bool:
        """Whether logged efforts move it, and no controllers."""
        return 'effort' in self.machine.texts('law')

    @property
    def _closed(self) -> bool:
        return self.pushed or super()._closed

    def _check_outputs(self) -> None:
        if self.pushed and 'effort' in self.signals.quantities:
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                'under `law: effort` the logged effort moves the axis and is not compared; '
                'compare the position: `--outputs position`',
            )
        if self.pushed and set(self.machine.texts('law')) != {'effort'}:
            raise IdentError(
                ErrorCode.BAD_MACHINE_FILE, '`law: effort` holds for all drives or for none'
            )
        super()._check_outputs()

    def _set_points(self, order: Sequence[int]) -> Array:
        if not self.pushed:
            return super()._set_points(order)
        if self.data.effort is None:
            raise IdentError(
                ErrorCode.MISSING_STREAM,
                'under `law: effort` the logged effort moves the axis, and none is logged; record '
                'it, or state the law and the gains of the controllers',
            )
        held = self.data.effort[order].copy()
        for row in held:
            there = np.flatnonzero(np.isfinite(row))
            last = np.searchsorted(there, np.arange(row.size), 'right') - 1
            row[:] = row[there[np.maximum(last, 0)]] if there.size else 0.0
        return np.concatenate([np.zeros(held.size), held.ravel()])

    def _start(self, command: Array, motion: Array) -> Array:
        if not self.pushed:
            return super()._start(command, motion)
        return self._seen(np.zeros(2 * len(self.machine.drives)))

    def _constants(self) -> Array:
        base = super()._constants()
        for d in range(len(self.machine.drives) if self.pushed else 0):
            for name, value in (
                ('position_gain', 0.0), ('velocity_gain', _NO_GAIN), ('feedforward', _THROUGH)
            ):  # fmt: skip
                base[rows.row_of(name, d)] = value
        return base
