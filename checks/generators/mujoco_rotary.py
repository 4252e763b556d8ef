# SPDX-License-Identifier: Apache-2.0
"""The delta in MuJoCo: arms that are hinges, everything else as `mujoco_tripod` has it."""

from collections.abc import Mapping
import math

import mujoco
import numpy as np
from scipy.optimize import fsolve

from checks.generators.mujoco_tripod import Drive, reported, Simulation, SUBSTEPS, True3, Whole
from ros2_ident.models import Machine

# Where the centre of an arm is, m: its mass follows from its first moment.
CENTRE = 0.1


def nominal(machine: Machine, parameters: Mapping[str, float]) -> True3:
    """Return the delta of a machine file with parameters of its own kind, and no effect."""
    gear = machine.number('gear_factor')
    motor, arm = parameters['drive_inertia'] * gear**2, parameters['arm_inertia']
    damping = 2.0 * parameters['gear_damping_ratio'] * math.sqrt(
        parameters['gear_stiffness'] * motor * arm / (motor + arm)
    )  # fmt: skip
    dry, viscous = parameters['coulomb_torque'], parameters['viscous_torque'] / gear
    drive = Drive(
        parameters['drive_inertia'], parameters['gear_stiffness'], damping, dry, dry, viscous
    )
    whole = Whole(parameters['tool_mass'])
    return True3(whole, (drive,) * 3, gear, parameters['measurement_delay'])


class DeltaSimulation(Simulation):
    """One delta in MuJoCo; see `Simulation`."""

    def __init__(
        self, machine: Machine, true: True3, arm_inertia: float, substeps: int = SUBSTEPS
    ) -> None:
        self.machine, self.true, self.substeps = machine, true, substeps
        self.cycle, self.gear = machine.number('cycle'), true.gear
        self.inertia = arm_inertia
        self.gravity, self.length = machine.number('gravity'), machine.number('rod_length')
        self.arm, self.radius = machine.number('arm_length'), machine.number('shaft_radius')
        azimuth = machine.numbers('shaft_azimuth')
        self.out = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(3)], axis=1)
        self.sense = 1.0 if machine.text('positive') == 'up' else -1.0
        self.zero = machine.numbers('arm_zero')
        # A rod is as long as in MuJoCo's first pose, with the arms level.
        self.depth = math.sqrt(self.length**2 - (self.radius + self.arm) ** 2)
        self.model = mujoco.MjModel.from_xml_string(self.xml())
        self.data = mujoco.MjData(self.model)

    def xml(self) -> str:
        """Return the model in MuJoCo's language, angles in radians."""
        return super().xml().replace('<mujoco>', '<mujoco><compiler angle="radian"/>', 1)

    def _rail(self, i: int) -> str:
        d, out = self.true.drives[i], self.out[i]
        turn = f'{d.inertia!r} ' * 3
        moment = self.machine.numbers('arm_moment')[i]
        mass = float(moment / CENTRE)
        about = float(self.inertia - moment * CENTRE)
        axis = self.sense * np.cross(out, [0.0, 0.0, 1.0])
        place, centre, foot = (text(f * out) for f in (self.radius, CENTRE, self.arm))
        return (
            f'<body name="motor_{i}" gravcomp="1"><joint name="motor_{i}" type="hinge" '
            f'axis="0 0 1" damping="{d.viscous!r}"/>'
            f'<inertial pos="0 0 0" mass="1e-6" diaginertia="{turn.strip()}"/></body>'
            f'<body name="arm_{i}" pos="{place}"><joint name="carriage_{i}" type="hinge" '
            f'axis="{text(axis)}" ref="{float(self.zero[i])!r}"/>'
            f'<inertial pos="{centre}" mass="{mass!r}" diaginertia="{about} {about} {about}"/>'
            f'<site name="foot_{i}" pos="{foot}"/></body>'
        )

    def place(self, carriage: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the platform [m] below arms (3,) [rad], and the gears' loads at rest [N m]."""
        turned = carriage - self.zero
        up = self.sense * np.array([0.0, 0.0, 1.0])
        cos, sin = np.cos(turned)[:, None], np.sin(turned)[:, None]
        feet = (self.radius + self.arm * cos) * self.out + self.arm * sin * up
        tangent = self.arm * (cos * up - sin * self.out)
        below = np.array([0.0, 0.0, -self.depth - 0.1])
        tool = fsolve(
            lambda p: np.sum((p - feet) ** 2, axis=1) - self.length**2, below, xtol=1e-13
        )
        along = (tool - feet) / self.length
        weight = np.array([0.0, 0.0, -self.true.whole.tool_mass * self.gravity])
        tension = np.linalg.solve(along.T, weight)
        own = self.sense * self.gravity * self.machine.numbers('arm_moment') * cos[:, 0]
        return tool, own - tension * np.sum(along * tangent, axis=1)


def text(vector: np.ndarray) -> str:
    """Return a vector as MuJoCo's language has it."""
    return ' '.join(repr(float(v)) for v in vector)


def simulate(machine, parameters, motion, substeps=SUBSTEPS):
    """Return the effort as it is logged (3, K), and the course behind it."""
    true = nominal(machine, parameters)
    simulation = DeltaSimulation(machine, true, parameters['arm_inertia'], substeps)
    course = simulation.run(motion.position, motion.velocity)
    return reported(course, true, machine.number('cycle')), course
