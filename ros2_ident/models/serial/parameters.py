# SPDX-License-Identifier: Apache-2.0
"""The inertial parameters of an arm as parameters of a search, and its coefficients from them."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from ros2_ident.machine.machine import Machine
from ros2_ident.machine.parameter import Parameter
from ros2_ident.models.serial.arm import Arm, INERTIALS
from ros2_ident.models.serial.base import base_columns

Array = npt.NDArray[np.float64]

# Names of a link's inertial parameters in pinocchio's order, and the machine file's for their box.
NAMES = (
    ('link_mass', ''),
    *(('link_moment', f'_{axis}') for axis in 'xyz'),
    *(('link_inertia', f'_{axes}') for axes in ('xx', 'xy', 'yy', 'xz', 'yz', 'zz')),
)
PAYLOAD = ('payload_mass', 'payload_x', 'payload_y', 'payload_z')
_SOURCE = 'Gautier and Khalil, IEEE T-RA 6(3), 1990'
_PAYLOAD_SOURCE = 'Newton; a point mass in the frame of the last joint'

# Instants, speeds (rad/s or m/s) and accelerations of the motion that shows all that can be shown.
_INSTANTS, _SPEED, _BEND = 60, 2.0, 5.0


class Inertials:
    """What of an arm's inertial parameters is looked for, and what the file says of the rest.

    Args:
        machine: The machine.
        arm: Its arm.

    Attributes:
        parameters: Base parameters and payload by the names of the machine file's boxes.
    """

    def __init__(self, machine: Machine, arm: Arm) -> None:
        self._known = arm.inertials
        self._listed = np.array(
            [
                drive * INERTIALS + n
                for drive in range(len(machine.drives))
                for n, (name, _) in enumerate(NAMES)
                if name in machine.bounds
            ],
            dtype=np.int64,
        )
        kept, grouping = base_columns(*self._shown(machine, arm))
        self._base = self._listed[kept]
        self._middle = grouping @ self._known[self._listed]
        self._names = [self._name(machine, column) for column in self._base]
        self.parameters: dict[str, tuple[Parameter, ...]] = {
            name: tuple(self._declared(machine, name))
            for name in dict(NAMES)
            if name in machine.bounds
        }
        for name in PAYLOAD:
            if name in machine.bounds:
                low, high, unit = machine.bounds[name]
                own = Parameter(name, unit, low, high, 'physical', _PAYLOAD_SOURCE)
                self.parameters[name] = (own,)
        self._carries = any(name in machine.bounds for name in PAYLOAD)

    def _shown(self, machine: Machine, arm: Arm) -> tuple[Array, Array]:
        """Return terms (M, C) of what is listed, (M, D) of rotors, in motions anywhere."""
        rng = np.random.default_rng(0)
        shape = (len(machine.drives), _INSTANTS)
        place, speed, bend = rng.uniform(-1.0, 1.0, (3, *shape))
        reach = np.where(arm.prismatic, 1.0, np.pi)[:, None]
        terms = arm.terms(reach * place, _SPEED * speed, _BEND * bend)
        rotors = np.eye(shape[0])[:, None, :] * (_BEND * bend)[:, :, None]
        sought = 'drive_inertia' in machine.bounds
        rows = shape[0] * shape[1]
        return (
            terms.reshape(rows, -1)[:, self._listed],
            rotors.reshape(rows, -1)[:, : shape[0] if sought else 0],
        )

    @staticmethod
    def _name(machine: Machine, column: int) -> str:
        name, axis = NAMES[column % INERTIALS]
        return f'{machine.drives[column // INERTIALS]}.{name}{axis}'

    def _declared(self, machine: Machine, name: str) -> list[Parameter]:
        """Return the base parameters of one kind; boxes are about what the file makes of them."""
        out = []
        for full, column, middle in zip(self._names, self._base, self._middle, strict=True):
            if NAMES[column % INERTIALS][0] == name:
                low, high, unit = machine.box(name, machine.drives[column // INERTIALS])
                out.append(Parameter(full, unit, middle + low, middle + high, 'physical', _SOURCE))
        return out

    def terms(self, whole: Array) -> Array:
        """Return the terms that coefficients are multiplied with.

        Args:
            whole: (D, K, 10 D) terms of all inertial parameters.

        Returns:
            (D, K, B) those of the base parameters, of a payload, and at the end what the links
            ask that the file describes.
        """
        last = whole[:, :, -INERTIALS:] if self._carries else whole[:, :, :0]
        known = whole @ self._known
        return np.ascontiguousarray(
            np.concatenate([whole[:, :, self._base], last, known[:, :, None]], axis=2)
        )

    def coefficients(self, values: Mapping[str, Array], count: int) -> Array:
        """Return (S, B) coefficients of candidates.

        Args:
            values: (S,) parameters by name, those that are held included.
            count: Candidates S.
        """
        columns = [values[n] - m for n, m in zip(self._names, self._middle, strict=True)]
        if self._carries:
            mass, *place = (values.get(name, np.zeros(count)) for name in PAYLOAD)
            columns += point_mass(mass, np.array(place))
        return np.stack([*columns, np.ones(count)], axis=1)


def point_mass(mass: Array, place: Array) -> list[Array]:
    """Return the ten inertial parameters (S,) of point masses (S,) at places (3, S)."""
    x, y, z = place
    products = (y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y)
    return [mass, *(mass * place), *(mass * product for product in products)]
