# SPDX-License-Identifier: Apache-2.0
"""Servos: what their motors make of a share of the supply voltage, and the arms they turn.

The torque at the output is k_t (V u - k_t q') / R with the duty u = k_p (q_ref - q) + k_d (k_ff
q_ref' - q'), clipped; the arm's inertia is J + (m + m_a / 3) l^2, its weight (m + m_a / 2) g l
sin(q - q_0). Source of motor, law and arm: Duclusaud, Passault, Padois, Ly, Extended Friction
Models for the Physics Simulation of Servo Actuators, ICRA 2025.
"""

import copy
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode, IdentError
from ros2_ident.kernel import rows
from ros2_ident.machine.machine import Machine
from ros2_ident.models.drives.separate import SeparateDrives
from ros2_ident.models.kinds import CURRENT, DUTY, VOLTAGE
from ros2_ident.models.protocol import Output

# Share of the stall torque that presses a gear where steps are chosen; with their margin,
# Runge-Kutta stays stable up to nine tenths of it.
_PRESSED = 0.5
# Steps while fast, as a share of those near standstill.
_LONGER = 0.4


def stall_torque(machine: Machine) -> Array:
    """Return (D,) the torque that motors make at their full duty, standing still [N m]."""
    per_volt = machine.numbers('torque_constant') / machine.numbers('resistance')
    out: Array = per_volt * machine.numbers('supply_voltage') * machine.numbers('duty_limit')
    return out


class Servo(SeparateDrives):
    """Servos that do not know of each other; see `DriveModel`.

    Without a stated quantity their positions are compared: what most of them log.
    """

    features = frozenset({'motor_torque'})
    gains = ('position_gain',)

    def _own_efforts(self) -> Array:
        return stall_torque(self.machine)

    def effort_limit(self, place: str) -> float:
        """Return the torque that a share of a servo's limit refers to [N m]."""
        return float(stall_torque(self.machine)[self.machine.drives.index(place)])

    @property
    def outputs(self) -> tuple[Output, ...]:
        """Compared outputs: quantity by quantity, drive by drive within."""
        return self.signals.described(self.machine.effort_unit, self.machine.travel_unit)

    def simulated_effort(self, theta: Array) -> Array:
        """Return (D, K) the torque of the motors [N m], for one candidate (N,)."""
        if self.machine.effort_unit == self.effort_unit:
            return super().simulated_effort(theta)
        other = copy.copy(self)
        other.machine = replace(self.machine, effort_unit=self.effort_unit)
        other.candidates = other._candidates()
        return other.simulated_effort(theta)

    def _check_outputs(self) -> None:
        if not self._closed:
            raise IdentError(
                ErrorCode.MISSING_STREAM,
                'a servo is simulated from its set-points, and the recording holds none; record '
                'the goal positions, or name the topic that carries them',
            )

    # ------------------------------------------------------------------ candidates to rows

    def _derive(self, block: Array, d: int) -> None:
        def of(name: str) -> Array:
            return block[:, rows.row_of(name, d)]

        constant, resistance = of('torque_constant'), of('resistance')
        supply = of('supply_voltage')
        length = of('load_length')
        weighing = (of('load_mass') + 0.5 * of('arm_mass')) * length
        derived = {
            'rail_mass': of('load_inertia') + (of('load_mass') + of('arm_mass') / 3.0) * length**2,
            'load_moment': weighing * block[:, rows.row_of('gravity')],
            'drive_gain': constant * supply / resistance,
            'back_emf': constant**2 / resistance,
        }
        one = np.ones(len(block))
        logged = {
            DUTY: (one, 0.0 * one),
            VOLTAGE: (supply, 0.0 * one),
            CURRENT: (supply / resistance, constant / resistance),
        }
        torque = derived['drive_gain'], derived['back_emf']
        pair = logged.get(self.machine.effort_unit, torque)
        derived['log_duty'], derived['log_speed'] = pair
        for name, value in derived.items():
            block[:, rows.row_of(name, d)] = value

    def _dry(self, block: Array, d: int) -> Array:
        limit = block[:, rows.row_of('drive_gain', d)] * block[:, rows.row_of('torque_limit', d)]
        return self.candidates.dry_friction(block, d, _PRESSED * limit)

    def _steps(self, block: Array, *, fast: bool = False) -> npt.NDArray[np.int64]:
        """Return (S,) integration steps in a cycle; see `DriveModel`.

        Friction under load may be so large that a servo which is fast at a step's start has turned
        round at its end, so that these steps may not be much longer.
        """
        steps = super()._steps(block, fast=fast)
        if not fast:
            return steps
        whole: npt.NDArray[np.int64] = np.ceil(_LONGER * super()._steps(block)).astype(np.int64)
        return np.maximum(steps, whole)

    # ------------------------------------------------------------------ inputs and simulation

    @property
    def _supply(self) -> Array:
        on = np.ones((len(self.machine.drives), self._cycles))
        if self.data.released is not None:
            on[:, self.data.released :] = 0.0
        return on.ravel()

    def _start(self, command: Array, motion: Array) -> Array:
        """Return (2 * D,) where the servos start and how fast, as their first samples say.

        A law without an integral part never stands where its set-point is.
        """
        return self._seen(super()._start(command, motion))
