# SPDX-License-Identifier: Apache-2.0
"""YAML of actuators for Isaac Lab, and of gains and limits for ros2_control."""

from collections.abc import Callable
import math
from typing import Any

import yaml

from ros2_ident.export.content import Content
from ros2_ident.files import mark
from ros2_ident.models.drives.joints import Joint

_ISAAC = (
    '# Keyword arguments of isaaclab.actuators.ImplicitActuatorCfg. Efforts in N m or N, as\n'
    '# Isaac Sim reads friction from version 5.0 on; what is missing is taken from the USD.\n'
)
_ROS2_CONTROL = (
    '# Gains of a joint_trajectory_controller that commands efforts, and limits of the joints.\n'
    '# Efforts at the joint, N m or N: where the hardware takes that of the motor, divide by the\n'
    '# gear factor.\n'
)


def isaac(content: Content) -> str:
    """Return the actuators of a robot as Isaac Lab has them."""
    joints = content.joints
    fields: dict[str, Callable[[Joint], float | None]] = {
        'effort_limit_sim': lambda j: j.limit if math.isfinite(j.limit) else None,
        'stiffness': lambda j: j.gains.p if j.gains else None,
        'damping': lambda j: j.gains.d if j.gains else None,
        'armature': lambda j: j.armature,
        'friction': lambda j: j.coulomb,
        'dynamic_friction': lambda j: j.coulomb,
        'viscous_friction': lambda j: j.viscous,
    }
    found = {name: {j.name: of(j) for j in joints} for name, of in fields.items()}
    told = {
        name: {joint: float(v) for joint, v in values.items() if v is not None}
        for name, values in found.items()
    }
    data: dict[str, Any] = {'joint_names_expr': [j.name for j in joints]}
    data |= {name: values for name, values in told.items() if values}
    return f'# {mark("export")}\n{_ISAAC}' + yaml.safe_dump(data, sort_keys=False, width=99)


def ros2_control(content: Content) -> str:
    """Return gains and limits as controllers of ros2_control read them."""
    with_gains = [j for j in content.joints if j.gains is not None]
    controller = {
        'joints': [j.name for j in with_gains],
        'command_interfaces': ['effort'],
        'state_interfaces': ['position', 'velocity'],
        'gains': {j.name: _pid(j) for j in with_gains},
    }
    data: dict[str, Any] = {'joint_trajectory_controller': {'ros__parameters': controller}}
    limits = {
        j.name: {'has_effort_limits': True, 'max_effort': float(j.limit)}
        for j in content.joints
        if math.isfinite(j.limit)
    }
    if limits:
        data['joint_limits'] = limits
    return f'# {mark("export")}\n{_ROS2_CONTROL}' + yaml.safe_dump(data, sort_keys=False, width=99)


def _pid(joint: Joint) -> dict[str, float]:
    assert joint.gains is not None
    g = joint.gains
    # The controller's D sees the whole set-point's speed; what the machine's does not see of it
    # is taken off again.
    return {
        'p': float(g.p),
        'i': float(g.i),
        'd': float(g.d),
        'ff_velocity_scale': float(g.d * (g.share - 1.0)),
    }
