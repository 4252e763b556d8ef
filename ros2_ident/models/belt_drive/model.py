# SPDX-License-Identifier: Apache-2.0
"""The belt drive of Ludwig and Gerstmayr (2011), section 3, discretised exactly.

M q'' + K q = (P phi1d, 0, 0)' with q = (phi1, phi2, x - x0), eqs. 19 to 21. The set-point phi1d is
constant over a sample, so the modes of M, K turn by fixed angles from sample to sample: no
integration step, no integration error. The drive starts at rest at its first set-point.
"""

from dataclasses import dataclass

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine
from ros2_ident.machine.parameter import Parameter
from ros2_ident.models.belt_drive import cost as belt_cost
from ros2_ident.models.belt_drive import kernels as belt_kernels
from ros2_ident.models.belt_drive import KIND

PAPER = 'Ludwig and Gerstmayr (2011)'
OUTPUTS = ('phi1', 'M1')
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


@dataclass(frozen=True)
class StepReference:
    """A set-point given by its samples.

    Attributes:
        cycle: Sampling interval, s.
        command_position: (1, K) phi1d, rad.
    """

    cycle: float
    command_position: Array


class BeltDrive:
    """A batch of belt drives with different parameters and the same set-point.

    Args:
        machine: A machine file of kind `belt_drive`.
        data: Sampling interval and set-point phi1d.

    Raises:
        IdentError: UNKNOWN_MODEL, UNKNOWN_PARAMETER, BAD_MACHINE_FILE or BAD_VALUES with the
            remedy.
    """

    outputs: tuple[str, ...] = OUTPUTS

    def __init__(self, machine: Machine, data: StepReference) -> None:
        if machine.kind != KIND.name:
            raise IdentError(
                ErrorCode.UNKNOWN_MODEL,
                f'the machine is a {machine.kind} and the model a {KIND.name}; '
                'give the machine file of a belt drive',
            )
        unknown = set(machine.bounds) - set(CONSTANTS)
        if unknown:
            raise IdentError(
                ErrorCode.UNKNOWN_PARAMETER,
                f'a belt drive has no parameter {", ".join(sorted(unknown))}; '
                f'choose from {", ".join(CONSTANTS)}',
            )
        self._nominal = np.array([machine.number(name) for name in CONSTANTS])
        self._columns = np.array([list(CONSTANTS).index(n) for n in machine.bounds], dtype=np.intp)
        self.parameters: tuple[Parameter, ...] = tuple(
            Parameter(n, unit, low, high, 'physical', f'{PAPER}: {CONSTANTS[n][2]}')
            for n, (low, high, unit) in machine.bounds.items()
        )
        self.cycle = float(data.cycle)
        reference = np.asarray(data.command_position, dtype=np.float64)
        self.reference: Array = np.ascontiguousarray(np.atleast_2d(reference)[0])
        if not (self.reference.size and np.isfinite(self.reference).all() and self.cycle > 0.0):
            raise IdentError(
                ErrorCode.BAD_VALUES,
                'the set-point needs at least one finite sample and a positive cycle; '
                'check the command stream',
            )
        # The modes turn freely between changes of the set-point; most samples change nothing.
        change = np.diff(self.reference)
        self._step_at = np.append(np.flatnonzero(change) + 1, self.reference.size)
        self._step_by = np.append(change[self._step_at[:-1] - 1], 0.0)

    def constants(self, theta: Array) -> Array:
        """Return all constants (S, 10), in the order of `CONSTANTS`, of candidates (S, N)."""
        theta = np.asarray(theta, dtype=np.float64)
        if theta.ndim != 2 or theta.shape[1] != len(self.parameters):
            raise IdentError(
                ErrorCode.BAD_VALUES,
                f'candidates have the shape {theta.shape}; '
                f'give (S, {len(self.parameters)}) numbers',
            )
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
        self._check(measured)
        return belt_cost.modal_cost(
            self.constants(theta),
            self.cycle,
            np.ascontiguousarray(measured[0] - self.reference),
            np.ascontiguousarray(measured[1]),
            self._step_at,
            self._step_by,
        )

    def _check(self, measured: Array) -> None:
        if measured.shape != (2, self.reference.size) or not np.isfinite(measured).all():
            raise IdentError(
                ErrorCode.BAD_VALUES,
                f'the measured outputs have the shape {measured.shape}; '
                f'give (2, {self.reference.size}) finite numbers',
            )
