# SPDX-License-Identifier: Apache-2.0
"""Transmission between motors and links: couplings of joints, and counterbalances."""

from collections.abc import Mapping
import functools

import numpy as np

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.machine.machine import Machine, Parameter

BALANCE = ('balance_force', 'balance_rate')
_SOURCE = 'a cylinder or spring between two links, by virtual work'


class Transmission:
    """The couplings and counterbalances of a machine file.

    A motor's angle is that of its joint and, where a belt or a hollow wrist passes another joint,
    a share of that joint's: theta = C q. Efforts of motors are C^-T times those of the joints, for
    the power is the same. A counterbalance pulls at two points, each at a distance from the
    joint's axis; its length l follows from the cosine rule, and it asks F dl/dq of the joint.

    Args:
        machine: The machine.

    Attributes:
        motors: (D, D) C, angles of the motors by those of the joints.
        parameters: Those of counterbalances that are looked for, by the machine file's names.

    Raises:
        IdentError: BAD_MACHINE_FILE where a joint is coupled to none that is there, or a cylinder
            has no way left.
    """

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._base, self._arm, self._angle, self._stroke = (
            machine.numbers(f'balance_{name}') for name in ('base', 'arm', 'angle', 'stroke')
        )
        self._joints = np.flatnonzero((self._base > 0.0) & (self._arm > 0.0))
        self.motors = _coupled(machine)
        self.parameters: dict[str, tuple[Parameter, ...]] = {
            name: tuple(self._declared(name)) for name in BALANCE if name in machine.bounds
        }

    def _declared(self, name: str) -> list[Parameter]:
        out = []
        for d in self._joints:
            drive = self._machine.drives[d]
            low, high, unit = self._machine.box(name, drive)
            out.append(Parameter(f'{drive}.{name}', unit, low, high, 'physical', _SOURCE))
        return out

    @functools.cached_property
    def coupled(self) -> bool:
        """Whether a motor turns with another joint than its own."""
        return bool((self.motors != np.eye(len(self.motors))).any())

    @property
    def balanced(self) -> bool:
        """Whether a joint has a counterbalance."""
        return bool(len(self._joints))

    def at_motors(self, joints: Array) -> Array:
        """Return efforts (D, ...) of the motors by those of the joints."""
        return np.asarray(np.tensordot(np.linalg.inv(self.motors).T, joints, 1))

    def terms(self, position: Array) -> Array:
        """Return what a force of 1 N and a rate of 1 N/m ask of the joints.

        Args:
            position: (D, K) of the joints, rad.

        Returns:
            (D, K, 2 P) N m, force and rate of each of the P counterbalances in turn.
        """
        out = np.zeros((*position.shape, 2 * len(self._joints)))
        for number, d in enumerate(self._joints):
            a, b, turned = self._base[d], self._arm[d], position[d] - self._angle[d]
            length = np.sqrt(a * a + b * b - 2.0 * a * b * np.cos(turned))
            lever = a * b * np.sin(turned) / np.maximum(length, 1e-9)
            way = length - abs(a - b)
            left = 1.0 - way / self._stroke[d]
            if (left <= 0.0).any():
                raise IdentError(
                    ErrorCode.BAD_MACHINE_FILE,
                    f'the counterbalance of {self._machine.drives[d]} is drawn out by '
                    f'{way.max():.3g} m, its balance_stroke is {self._stroke[d]:g} m; '
                    'correct balance_stroke, balance_base, balance_arm or balance_angle',
                )
            out[d, :, 2 * number] = lever / left
            out[d, :, 2 * number + 1] = lever * way
        return out

    def coefficients(self, values: Mapping[str, Array], count: int) -> list[Array]:
        """Return the (S,) forces and rates of candidates, as `terms` has them.

        Args:
            values: (S,) parameters by name; what is not looked for stands in the machine file.
            count: Candidates S.
        """
        return [
            values.get(f'{drive}.{name}', np.full(count, self._machine.number(name, drive)))
            for drive in (self._machine.drives[d] for d in self._joints)
            for name in BALANCE
        ]


def _coupled(machine: Machine) -> Array:
    """Return C of theta = C q."""
    out = np.eye(len(machine.drives))
    for d, drive in enumerate(machine.drives):
        other, share = machine.text('coupled_to', drive), machine.number('coupling', drive)
        if other == 'none':
            continue
        if other not in machine.drives or other == drive:
            raise IdentError(
                ErrorCode.BAD_MACHINE_FILE,
                f'{drive} is coupled_to {other!r}, which is no other joint of the file; choose '
                f'from {", ".join(n for n in machine.drives if n != drive)}',
            )
        out[d, machine.drives.index(other)] = share
    if abs(np.linalg.det(out)) < 1e-6:
        raise IdentError(
            ErrorCode.BAD_MACHINE_FILE,
            'the couplings leave a joint that no motor moves; correct coupled_to and coupling',
        )
    return out
