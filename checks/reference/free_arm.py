# SPDX-License-Identifier: Apache-2.0
"""An arm under PID controllers, plainly: one candidate, one step after the other.

Mass matrix and load column by column from recursive Newton-Euler in the base's frame (`arm.py`),
linear systems by numpy, friction at rest by rounds until nothing changes. What the fast model and
this have in common is the scheme: both take the links at the mean of a step's predicted motion and
integrate over it with the classical Runge-Kutta formulas, so that they agree to rounding.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from checks.reference import arm
from checks.reference.plant import Array
from checks.reference.serial import bodies_of
from ros2_ident.machine.machine import Machine

# Of a friction force, what may still change from round to round, and rounds to get there.
_SETTLED, _ROUNDS = 1e-14, 100_000
# As `kernel_free` has them: how many times as many steps, and what counts as rest.
_FINER, _RESTS = 2, 1e-3


@dataclass
class FreeArm:
    """An arm's bodies, motors and controllers; efforts and positions are those of the joints.

    Attributes:
        bodies: Links, each behind the one that carries it.
        fall: (3,) acceleration of free fall in the base, m/s^2.
        rotor: (D,) inertia of the motors, kg m^2.
        coulomb: (D,) friction that holds at rest, N m.
        viscous: (D,) N m s/rad.
        constant: (D,) pull against the positive direction, N m.
        gains: (3, D) of position, velocity and integral.
        motors: (D, D) angles of the motors by those of the joints; friction, inertia and control
            are the motors'.
        cycle: How long a set-point holds, s.
        steps: Integration steps in it, in each of which the controllers run.
    """

    bodies: Sequence[arm.Body]
    fall: Array
    rotor: Array
    coulomb: Array
    viscous: Array
    constant: Array
    gains: Array
    motors: Array
    cycle: float
    steps: int
    integral: Array = field(init=False)
    light: Array = field(init=False)
    load: Array = field(init=False)
    last: float = field(init=False)

    def links(self, place: Array, rate: Array) -> tuple[Array, Array]:
        """Return mass matrix (D, D) and load (D,) of the links at the motors."""
        back = np.linalg.inv(self.motors)
        q, w = back @ place, back @ rate
        still = np.zeros_like(q)
        load = arm.inverse_dynamics(self.bodies, self.fall, q, w, still)
        alone = [
            arm.inverse_dynamics(self.bodies, np.zeros(3), q, still, one) for one in np.eye(q.size)
        ]
        return back.T @ np.array(alone).T @ back, back.T @ load

    def run(self, target: Array, place: Array, rate: Array) -> tuple[Array, Array]:
        """Return positions and efforts (D, K) at the controllers' instants.

        Args:
            target: (D, K) set-points of the joints.
            place: (D,) positions of the joints at the start.
            rate: (D,) their rates.
        """
        wanted, place, rate = self.motors @ target, self.motors @ place, self.motors @ rate
        load = self.links(place, np.zeros_like(rate))[1]
        first = self.gains[0] * (wanted[:, 0] - place)
        holding = np.where(self.gains[2] > 0.0, load + self.constant - first, 0.0)
        self.integral, bend = holding, np.zeros_like(place)
        mass, self.load = self.links(place, np.zeros_like(rate))
        self.light = np.asarray(np.linalg.inv(mass + np.diag(self.rotor)))
        self.last = np.inf
        positions, efforts = np.empty_like(target), np.empty_like(target)
        for k in range(target.shape[1]):
            # Friction that may turn over or let go is looked at more often.
            slow = np.abs(rate) <= self.cycle * (np.abs(bend) + _RESTS)
            steps = self.steps * (_FINER if (slow & (self.coulomb > 0.0)).any() else 1)
            h = self.cycle / steps
            for step in range(steps):
                torque = self._law(wanted[:, k], place, rate)
                if step == 0:
                    positions[:, k], efforts[:, k] = place, torque
                place, rate, bend = self._step(torque, wanted[:, k], place, rate, h)
        return np.linalg.inv(self.motors) @ positions, efforts

    def _law(self, wanted: Array, place: Array, rate: Array) -> Array:
        """Return the torques that the controllers ask for."""
        error = wanted - place
        return np.asarray(self.gains[0] * error - self.gains[1] * rate + self.integral)

    def _step(
        self, torque: Array, wanted: Array, place: Array, rate: Array, h: float
    ) -> tuple[Array, Array, Array]:
        """Return positions, rates and accelerations after a step of `h` seconds."""
        growth = self.gains[2] * h * (wanted - place - 0.5 * h * rate)
        torque = torque + 0.5 * growth
        pushed = torque - self.constant - self.viscous * rate
        against = self.coulomb * np.copysign(1.0, rate)
        brake = self.gains[1] + self.viscous
        # The mean of the motion, by the links of the step before.
        begun = self.light @ (pushed - against - self.load)
        rests = (rate + h * begun) * np.copysign(1.0, rate) < 0.0
        rests |= np.abs(rate) <= _RESTS * h
        begun = np.where(rests, -rate / h, begun)
        jerk = -self.light @ (self.gains[0] * rate + brake * begun)
        passed = place + h / 2.0 * rate + h**2 / 6.0 * begun + h**3 / 24.0 * jerk
        mass, load = self.links(passed, rate + h / 2.0 * begun + h**2 / 6.0 * jerk)
        light = np.asarray(np.linalg.inv(mass + np.diag(self.rotor)))
        grown = h / (h + self.last)

        def further(force: Array) -> Array:
            """Return by how much a force is answered otherwise at the step's ends."""
            before = self.light @ (force - self.load)
            return np.asarray(grown * (light @ (force - load) - before))

        # Controllers answer within the step, to positions and, implicitly, to rates.
        answer = 0.5 * h * self.gains[0] * rate
        reached = rate + h * light @ (pushed - load - against - answer)
        friction, moved = against, np.zeros_like(place)
        back = reached * np.copysign(1.0, rate) < 0.0
        if back.any():
            slowing = np.asarray(h * np.linalg.inv(mass + np.diag(self.rotor + 0.5 * h * brake)))
            free = rate + slowing @ (pushed - load - answer)
            friction, share = self._held(rate, free, slowing)
            moved = 0.5 * h * h * light @ (share * (friction - against))
        start, first = place, rate

        def force(at: Array, speed: Array) -> Array:
            law = torque - self.gains[0] * (at - start) - self.gains[1] * (speed - first)
            return np.asarray(law - self.constant - friction - self.viscous * speed)

        half = 0.5 * h
        self.integral = self.integral + growth
        a = light @ (force(place, rate) - load) - further(force(place, rate))
        b = light @ (force(place + half * rate, rate + half * a) - load)
        c = light @ (force(place + half * rate + half * half * a, rate + half * b) - load)
        last = force(place + h * rate + h * half * b, rate + h * c)
        d = light @ (last - load) + further(last)
        self.light, self.load, self.last = light, load, h
        place = place + h * rate + h * h / 6.0 * (a + b + c) + moved
        return place, rate + h / 6.0 * (a + 2.0 * b + 2.0 * c + d), d

    def _held(self, rate: Array, free: Array, slowing: Array) -> tuple[Array, Array]:
        """Return friction and for which share of the step it is against the motion, both (D,).

        It is as much as stops a motor, and all of it of those it cannot. Until a motor stops it is
        against the motion.

        Args:
            rate: (D,) rates at the step's beginning.
            free: (D,) rates at the step's end without it.
            slowing: (D, D) by how much friction slows them.
        """
        friction, share = self.coulomb * np.sign(free), np.ones_like(free)
        for _ in range(_ROUNDS):
            before = friction.copy()
            for d in range(free.size):
                left = free[d] - slowing[d] @ friction
                against = np.copysign(self.coulomb[d], rate[d])
                reached = left + slowing[d, d] * (friction[d] - against)
                turns = reached * np.copysign(1.0, rate[d]) < 0.0
                share[d] = abs(rate[d]) / abs(rate[d] - reached) if turns else 1.0
                room = (1.0 - share[d]) * self.coulomb[d]
                wanted = friction[d] + left / slowing[d, d]
                middle = share[d] * against
                friction[d] = np.clip(wanted, middle - room, middle + room)
            if np.abs(friction - before).max() <= _SETTLED * max(1e-300, self.coulomb.max()):
                break
        return friction, share


def free_arm(machine: Machine, parameters: Mapping[str, float], steps: int) -> FreeArm:
    """Return the arm of a machine file with parameters by name, `elbow.drive_inertia`.

    Its gears have a factor of 1.
    """
    names = machine.drives

    def of(name: str) -> Array:
        stated = machine.numbers(name) if name in machine.constants else np.zeros(len(names))
        given = [parameters.get(f'{n}.{name}', x) for n, x in zip(names, stated, strict=True)]
        return np.nan_to_num(np.array(given, dtype=np.float64))

    motors = np.eye(len(names))
    for d, drive in enumerate(names):
        if (other := machine.text('coupled_to', drive)) != 'none':
            motors[d, names.index(other)] = machine.number('coupling', drive)
    fall = (machine.number(name) for name in ('free_fall', 'base_roll', 'base_pitch'))
    return FreeArm(
        bodies_of(machine, parameters),
        arm.gravity_in_base(*fall),
        of('drive_inertia'),
        of('coulomb_torque'),
        of('viscous_torque'),
        of('constant_force'),
        np.array([of(f'{name}_gain') for name in ('position', 'velocity', 'integral')]),
        motors,
        machine.number('cycle'),
        steps,
    )
