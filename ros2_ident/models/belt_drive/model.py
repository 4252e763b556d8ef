# SPDX-License-Identifier: Apache-2.0
"""The belt drive of Ludwig and Gerstmayr (2011), section 3, discretised exactly.

M q'' + K q = (P phi1d, 0, 0)' with q = (phi1, phi2, x - x0), eqs. 19 to 21. The set-point phi1d is
constant over a sample, so the modes of M, K turn by fixed angles from sample to sample: no
integration step, no integration error. The drive starts at rest at its first set-point.
"""

from collections.abc import Mapping
import math

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.machine.machine import Machine, Parameter
from ros2_ident.models.belt_drive import kernels as belt_kernels
from ros2_ident.models.drives.outputs import MachineModel
from ros2_ident.models.kinds import BELT_DRIVE as KIND
from ros2_ident.models.protocol import Stop

PAPER = 'Ludwig and Gerstmayr (2011)'
# Rows of what a `BeltDrive` simulates, by the quantity of a log that they are.
_ROWS = {'effort': 1, 'position': 0}
# Where the machine file keeps each constant, in the order the kernels take them.
CONSTANTS = {
    'axial_stiffness': ('drive', 'N', 'EA, eq. 11'),
    'position_gain': ('controller', 'N m/rad', 'P, eq. 20'),
    'driving_inertia': ('drive', 'kg m^2', 'J1, eq. 15'),
    'driven_inertia': ('drive', 'kg m^2', 'J2, eq. 15'),
    'rail_mass': ('drive', 'kg', 'm, eq. 15'),
    'radius': ('geometry', 'm', 'r, eq. 10'),
    'rail_position': ('geometry', 'm', 'x0, eq. 10'),
    'length_1': ('geometry', 'm', 'l1,0 at x0 = 0, Table 1'),
    'length_2': ('geometry', 'm', 'l2,0 at x0 = 0, Table 1'),
    'length_3': ('geometry', 'm', 'l3,0, eq. 11'),
}


class BeltDrive:
    """A batch of belt drives with different parameters and the same set-point.

    Args:
        machine: A machine file of kind `belt_drive`.
        cycle: Sampling interval, s.
        set_point: (K,) phi1d, rad.
        fixed: Values of parameters that are not free, by name.

    Raises:
        IdentError: UNKNOWN_PARAMETER, BAD_MACHINE_FILE or BAD_VALUES with the remedy.
    """

    def __init__(
        self,
        machine: Machine,
        cycle: float,
        set_point: Array,
        fixed: Mapping[str, float] | None = None,
    ) -> None:
        fixed = fixed or {}
        for name in fixed:
            if name not in machine.bounds:
                raise ErrorCode.UNKNOWN_PARAMETER.error(
                    f'{name!r} cannot be fixed: no such parameter; the model has '
                    f'{", ".join(machine.bounds)}'
                )
        self._nominal = np.array([fixed.get(n, machine.number(n)) for n in CONSTANTS])
        self.parameters: tuple[Parameter, ...] = tuple(
            Parameter(n, unit, low, high, 'physical', f'{PAPER}: {CONSTANTS[n][2]}')
            for n, (low, high, unit) in machine.bounds.items()
            if n not in fixed
        )
        self._columns = [list(CONSTANTS).index(p.name) for p in self.parameters]
        self.cycle = float(cycle)
        self.reference: Array = np.ascontiguousarray(set_point, dtype=np.float64)
        if not (self.reference.size and np.isfinite(self.reference).all() and self.cycle > 0.0):
            raise ErrorCode.BAD_VALUES.error(
                'the set-point needs at least one finite sample and a positive cycle; '
                'check the command stream'
            )
        # The modes turn freely between changes of the set-point; most samples change nothing.
        change = np.diff(self.reference)
        self._step_at = np.append(np.flatnonzero(change) + 1, self.reference.size)
        self._step_by = np.append(change[self._step_at[:-1] - 1], 0.0)

    def constants(self, theta: Array) -> Array:
        """Return all constants (S, 10), in the order of `CONSTANTS`, of candidates (S, N)."""
        theta = np.atleast_2d(np.asarray(theta, dtype=np.float64))
        full = np.repeat(self._nominal[None, :], len(theta), axis=0)
        full[:, self._columns] = theta
        return full

    def simulate(self, theta: Array) -> Array:
        """Simulate candidates.

        Args:
            theta: (S, N) parameters, physical units.

        Returns:
            (S, 2, K): phi1 [rad] and M1 [Nm] at every sample; inf where a candidate is no stable
            drive (a stiffness, inertia or gain that is not positive).
        """
        return belt_kernels.modal_response(
            self.constants(theta), self.cycle, self.reference, self._step_at, self._step_by
        )

    def cost(self, theta: Array, measured: Array) -> Array:
        """Return the cost of candidates, eq. 2, without storing a trajectory.

        Args:
            theta: (S, N) parameters, physical units.
            measured: (2, K) phi1 [rad] and M1 [Nm], finite.

        Returns:
            (S,) RMS error averaged over the two outputs; inf as in `simulate`.
        """
        return belt_kernels.modal_cost(
            self.constants(theta), self.cycle, measured[0] - self.reference,
            np.ascontiguousarray(measured[1]), self._step_at, self._step_by,
        )  # fmt: skip


class RecordedBelt(MachineModel):
    """A belt drive along the set-point of a log, at rest at its first sample.

    No effect can sit here, and no recorded motion drives it: `cutoff` and `efforts` are not read.

    The recording holds set-point and angle of the driving gear [rad], its moment as the effort
    [N m].

    Raises:
        IdentError: INVALID_GOAL, UNKNOWN_PARAMETER or MISSING_STREAM with the remedy.
    """

    compares = KIND.compares

    def __post_init__(self) -> None:
        super().__post_init__()
        self.extended(self.effects)
        data, self.noise = self.data, self.machine.effort_noise
        if 'velocity' in self.signals.quantities:
            raise ErrorCode.INVALID_GOAL.error(
                "a belt drive's velocity is not simulated; compare effort and position"
            )
        if data.command_position is None:
            raise ErrorCode.MISSING_STREAM.error(
                'the recording holds no set-point, which drives a belt drive; record it too'
            )
        self.belt = BeltDrive(self.machine, data.cycle, data.command_position[0], self.fixed)
        complete = bool(np.isfinite(self.measured).all())
        self._fused = complete and self.signals.weights == (1.0, 1.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The free parameters, in the order of theta's columns."""
        return self.belt.parameters

    def free_run(self) -> 'RecordedBelt':
        """Return the model itself: it runs by its set-point alone."""
        return self

    def simulate(self, theta: Array) -> Array:
        """Return (S, O, K) outputs of candidates (S, N); inf where one is no stable drive."""
        rows = [_ROWS[quantity] for quantity in self.signals.quantities]
        return self.belt.simulate(theta)[:, rows]

    def costs(
        self, theta: Array, limit: float | Array = math.inf, stop: Stop | None = None
    ) -> Array:
        """Return (S,) costs of candidates (eq. 2); arguments as of `FullModel.costs`."""
        if not self._fused or (stop is not None and stop()):
            return super().costs(theta, limit, stop)
        rows = [self.signals.quantities.index('position'), self.signals.quantities.index('effort')]
        return self.belt.cost(theta, self.measured[rows])
