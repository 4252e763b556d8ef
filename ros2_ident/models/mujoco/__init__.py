# SPDX-License-Identifier: Apache-2.0
"""A URDF under P and D on position, or an MJCF with its own actuators, stepped by MuJoCo."""

from ros2_ident.machine.description import joints_in
from ros2_ident.machine.keys import keys_of
from ros2_ident.machine.kind import Kind, later

KIND = Kind(
    name='mujoco',
    title='a URDF or MJCF that MuJoCo simulates, its actuators following the set-points',
    keys=keys_of('mujoco'),
    model=later('ros2_ident.models.mujoco.model:Mujoco'),
    starts_in_motion=True,
    travel='rad',
    read=later('ros2_ident.models.mujoco.plant:Plant'),
    joints=joints_in,
    compares=('position',),
    space=later('ros2_ident.models.mujoco.model:space'),
    ends=later('ros2_ident.models.mujoco.model:ends'),
    described=('joint_zero', 'armature', 'damping', 'frictionloss', 'stiffness', 'kp', 'kv',
               'force_limit', 'actuator_gear', 'body_mass', 'body_place',
               'body_centre', 'body_inertia', 'free_fall'),
)  # fmt: skip
