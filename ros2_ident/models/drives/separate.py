# SPDX-License-Identifier: Apache-2.0
"""Drives that do not know of each other: linear axes and servos.

The torque of a servo at its output is k_t (V u - k_t q') / R with the duty u = k_p (q_ref - q) +
k_d (k_ff q_ref' - q'), clipped; its arm's inertia is J + (m + m_a / 3) l^2, its weight
(m + m_a / 2) g l sin(q - q_0). Source of motor, law and arm: Duclusaud, Passault, Padois, Ly,
Extended Friction Models for the Physics Simulation of Servo Actuators, ICRA 2025.
"""

from collections.abc import Sequence
from dataclasses import replace
import functools
import math

import numpy as np
import numpy.typing as npt

from ros2_ident.arrays import Array
from ros2_ident.errors import ErrorCode
from ros2_ident.kernel import rows
from ros2_ident.machine.machine import Machine
from ros2_ident.models.drives.kernel import simulate, sizes
from ros2_ident.models.drives.log import DriveLog
from ros2_ident.models.drives.model import Compiled, DriveModel
from ros2_ident.models.kinds import CURRENT, DUTY, VOLTAGE
from ros2_ident.recording import Dataset

# A set-point slower than this share of its fastest at the log's start counts as rest.
_REST = 0.02
# Samples of the position that show how fast an axis starts.
_FIRST = 10
# Those that show how one starts that no set-point holds, and the first of them, that show where.
_BEGINNING, _STILL = 12, 3
# A speed counts where it is so many standard errors.
_SURE = 4.0

# A velocity gain next to nothing, and the feedforward that makes a set-point's rate the effort.
_NO_GAIN, _THROUGH = 2.0**-40, 2.0**40
# Share of a servo's stall torque that presses a gear where steps are chosen; with their margin,
# Runge-Kutta stays stable up to nine tenths of it.
_PRESSED = 0.5
# Steps while fast, as a share of those near standstill.
_LONGER = 0.4


class SeparateLog(DriveLog):
    """A log of drives that begin at rest or in motion, see `DriveLog`."""

    @functools.cached_property
    def begin(self) -> Array:
        """(2, D) where the motors start and how fast."""
        return self._start()

    def _start(self) -> Array:
        # An axis starts at rest where its set-point is, unless the log shows that it moves: its
        # first measured positions then say where it is and how fast.
        data, cycle = self.data, self.data.cycle
        begin = np.zeros((2, len(self.order)))
        begin[0] = (self.followed if data.command_position is None else self.command)[0, :, 0]
        speed = data.command_velocity
        if data.position is None or speed is None:
            return begin
        for d, row in enumerate(self.order):
            there = np.flatnonzero(np.isfinite(data.position[row]))[:_FIRST]
            rests = abs(speed[row, 0]) <= _REST * np.abs(speed[row]).max()
            if not rests and len(there) == _FIRST:
                _, slope, place = np.polyfit(there * cycle, data.position[row, there], 2)
                begin[:, d] = place, slope
        return begin

    @property
    def supply(self) -> Array | None:
        """(D, K) share of a servo's supply at every cycle; None where efforts are commanded."""
        return None


class SeparateDrives(DriveModel):
    """Each drive moves one carriage, through a gear that gives or rigid; see `DriveModel`."""

    reads = SeparateLog
    log: SeparateLog

    @property
    def rigid(self) -> bool:
        """Whether motor and carriage are one mass: where no gear stiffness is to be found."""
        return 'gear_stiffness' not in self.machine.bounds

    @property
    def _kernel(self) -> Compiled:
        log, effects = self.log, self.candidates
        supply = None if log.supply is None else log.supply.ravel()
        inputs = log.command.ravel(), log.followed.ravel(), log.begin.ravel(), log.mode
        given = *inputs, effects.on, supply, effects.delayed, self.stiff, self.cycle, self.law
        return simulate, sizes(len(self.machine.drives)), given


def first_seen(data: Dataset, order: Sequence[int], begin: Array) -> Array:
    """Return starts (2, D) of some rows, as the first measured positions say if there are some."""
    begin = begin.copy()
    for d, seen in enumerate([] if data.position is None else data.position[list(order)]):
        there = np.flatnonzero(np.isfinite(seen))[:_BEGINNING]
        if len(there) == _BEGINNING:
            begin[:, d] = _beginning(data.time[there], seen[there])
    return begin


def _beginning(time: Array, seen: Array) -> tuple[float, float]:
    """Return place and speed at time zero, by samples (T,); at rest unless they say otherwise."""
    terms = np.vander(time, 3)
    found = np.linalg.lstsq(terms, seen, rcond=None)[0]
    apart = np.diff(np.unique(seen))
    step = float(apart.min()) if apart.size else 0.0
    noise = math.hypot(float(np.std(seen - terms @ found)), step / math.sqrt(12.0))
    error = noise * math.sqrt(float(np.linalg.inv(terms.T @ terms)[1, 1]))
    if abs(found[1]) > _SURE * error:
        return float(found[2]), float(found[1])
    return float(np.mean(seen[:_STILL])), 0.0


class AxisLog(SeparateLog):
    """A log of axes, see `DriveLog`.

    Under the law `effort` the logged effort holds from each sample to the next.
    """

    @property
    def pushed(self) -> bool:
        """Whether logged efforts move it, and no controllers."""
        return 'effort' in self.machine.texts('law')

    @property
    def closed(self) -> bool:
        """Whether it follows what is logged: a set-point, or an effort."""
        return self.pushed or super().closed

    def _set_points(self) -> Array:
        if not self.pushed:
            return super()._set_points()
        if self.data.effort is None:
            raise ErrorCode.MISSING_STREAM.error(
                'under `law: effort` the logged effort moves the axis, and none is logged; record '
                'it, or state the law and the gains of the controllers'
            )
        held = self.data.effort[self.order]
        for row in held:
            there = np.flatnonzero(np.isfinite(row))
            last = np.searchsorted(there, np.arange(row.size), 'right') - 1
            row[:] = row[there[np.maximum(last, 0)]] if there.size else 0.0
        return np.stack([np.zeros(held.shape), held])

    def _start(self) -> Array:
        if not self.pushed:
            return super()._start()
        return first_seen(self.data, self.order, np.zeros((2, len(self.order))))


class LinearAxis(SeparateDrives):
    """The tripod's drive without rods, gravity along the axis adjustable; see `DriveModel`.

    Under the law `effort` no controller is simulated, and the motion that the logged effort causes
    is compared.
    """

    reads = AxisLog

    def _check_outputs(self) -> None:
        if self.log.pushed and 'effort' in self.signals.quantities:
            raise ErrorCode.INVALID_GOAL.error(
                'under `law: effort` the logged effort moves the axis and is not compared; '
                'compare the position: `--outputs position`, of a diagnosis `--output position`'
            )
        if self.log.pushed and set(self.machine.texts('law')) != {'effort'}:
            raise ErrorCode.BAD_MACHINE_FILE.error(
                '`law: effort` holds for all drives or for none'
            )
        super()._check_outputs()

    def _constants(self) -> Array:
        base = super()._constants()
        if self.log.pushed:
            gains = {'position_gain': 0.0, 'velocity_gain': _NO_GAIN, 'feedforward': _THROUGH}
            for name, value in gains.items():
                rows.of(base[None], name, len(self.machine.drives))[:] = value
        return base


def stall_torque(machine: Machine) -> Array:
    """Return (D,) the torque that motors make at their full duty, standing still [N m]."""
    per_volt = machine.numbers('torque_constant') / machine.numbers('resistance')
    return np.asarray(per_volt * machine.numbers('supply_voltage') * machine.numbers('duty_limit'))


class ServoLog(SeparateLog):
    """A log of servos, see `DriveLog`."""

    def _start(self) -> Array:
        # A law without an integral part never stands where its set-point is.
        return first_seen(self.data, self.order, super()._start())

    @functools.cached_property
    def supply(self) -> Array:
        """(D, K) share of the supply at every cycle."""
        on = np.ones((len(self.order), self.data.cycles))
        if self.data.released is not None:
            on[:, self.data.released :] = 0.0
        return on


class Servo(SeparateDrives):
    """Servos that do not know of each other; see `DriveModel`.

    Without a stated quantity their positions are compared: what most of them log.
    """

    features = frozenset({'motor_torque'})
    gains = ('position_gain',)
    reads = ServoLog

    def effort_limit(self, place: str) -> float:
        """Return the torque that a share of a servo's limit refers to [N m]."""
        return float(stall_torque(self.machine)[self.machine.drives.index(place)])

    @property
    def effort_units(self) -> tuple[str, ...]:
        """(D,) unit of the drives' efforts."""
        return (self.machine.effort_unit,) * len(self.machine.drives)

    def simulated_effort(self, theta: Array) -> Array:
        """Return (D, K) the torque of the motors [N m], for one candidate (N,)."""
        if self.machine.effort_unit == self.effort_unit:
            return super().simulated_effort(theta)
        machine = replace(self.machine, effort_unit=self.effort_unit)
        return replace(self, machine=machine).simulated_effort(theta)

    def _check_outputs(self) -> None:
        if not self.log.closed:
            raise ErrorCode.MISSING_STREAM.error(
                'a servo is simulated from its set-points, and the recording holds none; record '
                'the goal positions, or name the topic or column that carries them'
            )

    # ------------------------------------------------------------------ candidates to rows

    def _derive(self, block: Array) -> None:
        of = functools.partial(self.candidates.of, block)
        constant, resistance, supply = (
            of(name) for name in ('torque_constant', 'resistance', 'supply_voltage')
        )
        load, arm, length = of('load_mass'), of('arm_mass'), of('load_length')
        with np.errstate(divide='ignore', invalid='ignore'):  # without resistance it diverges
            gain, braking = constant * supply / resistance, constant**2 / resistance
            current = supply / resistance, constant / resistance
        of('rail_mass')[:] = of('load_inertia') + (load + arm / 3.0) * length**2
        of('load_moment')[:] = (load + 0.5 * arm) * length * of('gravity')[:, None]
        of('drive_gain')[:], of('back_emf')[:] = gain, braking
        logged: dict[str, tuple[Array | float, Array | float]] = {
            DUTY: (1.0, 0.0),
            VOLTAGE: (supply, 0.0),
            CURRENT: current,
        }
        pair = logged.get(self.machine.effort_unit, (gain, braking))
        of('log_duty')[:], of('log_speed')[:] = pair

    def _dry(self, block: Array) -> Array:
        limit = self.candidates.of(block, 'drive_gain') * self.candidates.of(block, 'torque_limit')
        return self.candidates.dry_friction(block, _PRESSED * limit)

    def _steps(self, block: Array, *, fast: bool = False) -> npt.NDArray[np.int64]:
        steps = super()._steps(block, fast=fast)
        if not fast:
            return steps
        # Friction under load may be so large that a servo which is fast at a step's start has
        # turned round at its end, so that these steps may not be much longer.
        whole: npt.NDArray[np.int64] = np.ceil(_LONGER * super()._steps(block)).astype(np.int64)
        return np.maximum(steps, whole)
