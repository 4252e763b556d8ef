# SPDX-License-Identifier: Apache-2.0
"""The belt drive on a recording: the driving gear's angle and moment against a log of both."""

import math
from typing import Any

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine
from ros2_ident.machine.parameter import Parameter
from ros2_ident.models.belt_drive import KIND
from ros2_ident.models.belt_drive.model import BeltDrive, StepReference
from ros2_ident.models.drives.outputs import MachineModel
from ros2_ident.models.protocol import Output, Stop
from ros2_ident.recording import Dataset

# Rows of what a `BeltDrive` simulates, by the quantity of a log that they are.
_ROWS = {'effort': 1, 'position': 0}


class RecordedBelt(MachineModel):
    """A belt drive along the set-point of a log, at rest at its first sample.

    No effect can sit here, and no recorded motion drives it: `cutoff` and `efforts` are not read.

    Args:
        machine: A belt drive.
        data: The recording: set-point and angle of the driving gear [rad], its moment as the
            effort [N m].
        asked: As of `MachineModel`; the weights of the paper are 1.

    Raises:
        IdentError: INVALID_GOAL, UNKNOWN_PARAMETER or MISSING_STREAM with the remedy.
    """

    compares = KIND.compares

    def __init__(self, machine: Machine, data: Dataset, **asked: Any) -> None:
        super().__init__(machine, data, **asked)
        self.extended(self.effects)
        self.noise = machine.effort_noise
        if 'velocity' in self.signals.quantities:
            raise IdentError(
                ErrorCode.INVALID_GOAL,
                "a belt drive's velocity is not simulated; compare effort and position",
            )
        if data.command_position is None:
            raise IdentError(
                ErrorCode.MISSING_STREAM,
                'the recording holds no set-point, which drives a belt drive; record it too',
            )
        self.belt = BeltDrive(machine, StepReference(data.cycle, data.command_position))
        names = [p.name for p in self.belt.parameters]
        unknown = [name for name in self.fixed if name not in names]
        if unknown:
            raise IdentError(
                ErrorCode.UNKNOWN_PARAMETER,
                f'{unknown[0]!r} cannot be fixed: no such parameter; the model has '
                f'{", ".join(names)}',
            )
        self._free = [n for n, name in enumerate(names) if name not in self.fixed]
        self._measured = self.signals.measured(data)
        complete = bool(np.isfinite(self._measured).all())
        self._fused = complete and self.signals.weights == (1.0, 1.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The free parameters, in the order of theta's columns."""
        return tuple(self.belt.parameters[n] for n in self._free)

    @property
    def outputs(self) -> tuple[Output, ...]:
        """Moment and angle of the driving gear, what of them is compared."""
        return self.signals.described('N m', 'rad')

    @property
    def measured(self) -> Array:
        """(O, K) measured outputs, NaN where there is no sample."""
        return self._measured

    def free_run(self) -> 'RecordedBelt':
        """Return the model itself: it runs by its set-point alone."""
        return self

    def _whole(self, theta: Array) -> Array:
        """Return (S, P) all of the belt's parameters, those that are held with their values."""
        theta = np.atleast_2d(theta)
        whole = np.empty((len(theta), len(self.belt.parameters)))
        for n, p in enumerate(self.belt.parameters):
            whole[:, n] = self.fixed.get(p.name, math.nan)
        whole[:, self._free] = theta
        return whole

    def simulate(self, theta: Array) -> Array:
        """Return (S, O, K) outputs of candidates (S, N); inf where one is no stable drive."""
        rows = [_ROWS[quantity] for quantity in self.signals.quantities]
        return self.belt.simulate(self._whole(theta))[:, rows]

    def costs(
        self, theta: Array, limit: float | Array = math.inf, stop: Stop | None = None
    ) -> Array:
        """Return (S,) costs of candidates (eq. 2); arguments as of `FullModel.costs`."""
        if not self._fused or (stop is not None and stop()):
            return super().costs(theta, limit, stop)
        rows = [self.signals.quantities.index('position'), self.signals.quantities.index('effort')]
        return self.belt.cost(self._whole(theta), self._measured[rows])
