# SPDX-License-Identifier: Apache-2.0
"""The linear tripod as its owner would write it in MJCF: rigid gears, rods as constraints."""

from collections.abc import Mapping
import math

import numpy as np

from ros2_ident.models import Machine

# A constraint as hard as a step lets it be.
HARD = 'solref="1e-3 1" solimp="0.9999 0.9999 1e-3 0.5 1"'


def tripod_mjcf(
    machine: Machine, values: Mapping[str, float], integrator: str = 'implicitfast'
) -> str:
    """Return a tripod whose drives have a P controller on their velocity, without feed-forward.

    Args:
        machine: A tripod, its law `cascade_p`.
        values: `tool_mass`, `drive_inertia`, `coulomb_torque` and `viscous_torque`.
        integrator: MuJoCo's; Euler holds the actuators' forces over a cycle, as a controller does.
    """
    gear, radius = machine.number('gear_factor'), machine.number('rail_radius')
    stiff = machine.number('velocity_gain') * gear
    limit = machine.number('torque_limit') * gear
    depth = math.sqrt(machine.number('rod_length') ** 2 - radius**2)
    bodies, rods, ties, motors = [], [], [], []
    for name, angle in zip(machine.drives, machine.numbers('rail_azimuth'), strict=True):
        x, y = (float(radius * f) for f in (np.cos(angle), np.sin(angle)))
        bodies.append(
            f'<body pos="{x!r} {y!r} 0"><joint name="{name}" type="slide" axis="0 0 1" '
            f'armature="{values["drive_inertia"] * gear**2!r}" '
            f'damping="{values["viscous_torque"] * gear!r}" '
            f'frictionloss="{values["coulomb_torque"] * gear!r}"/>'
            f'<inertial pos="0 0 0" mass="{machine.number("rail_mass")!r}" '
            f'diaginertia="1e-3 1e-3 1e-3"/><site name="foot_{name}"/></body>'
        )
        rods.append(
            f'<spatial name="rod_{name}"><site site="foot_{name}"/><site site="tool"/></spatial>'
        )
        ties.append(f'<tendon tendon1="rod_{name}" {HARD}/>')
        motors.append(
            f'<position name="{name}" joint="{name}" kv="{stiff!r}" '
            f'kp="{stiff * machine.number("position_gain")!r}" forcerange="{-limit!r} {limit!r}"/>'
        )
    axes = zip('xyz', ('1 0 0', '0 1 0', '0 0 1'), strict=True)
    slides = ''.join(f'<joint name="tool_{n}" type="slide" axis="{a}"/>' for n, a in axes)
    return (
        f'<mujoco><option timestep="{machine.number("cycle")!r}" integrator="{integrator}" '
        f'gravity="0 0 {-machine.number("gravity")!r}"/><compiler autolimits="true"/>'
        f'<worldbody>{"".join(bodies)}<body name="tool" pos="0 0 {-depth!r}">{slides}'
        f'<inertial pos="0 0 0" mass="{values["tool_mass"]!r}" diaginertia="1e-3 1e-3 1e-3"/>'
        f'<site name="tool"/></body></worldbody><tendon>{"".join(rods)}</tendon>'
        f'<equality>{"".join(ties)}</equality><actuator>{"".join(motors)}</actuator></mujoco>'
    )
