# SPDX-License-Identifier: Apache-2.0
"""A URDF under P and D on position, or an MJCF with its own actuators, stepped by MuJoCo."""

from functools import partial

from ros2_ident.machine.description import joints_in
from ros2_ident.machine.keys import head, Key, of_controller, of_drive, of_geometry, sought
from ros2_ident.machine.kind import Kind, later
from ros2_ident.models.drives import keys

_DESCRIPTION = of_geometry('description', '',
                           "URDF, or MJCF without files of its own; way from this file's folder",
                           'robot.xml', file=True)
_named = partial(of_drive, default='', shown=False)
_DESCRIBED = "the description's by default"
_found = partial(sought, absent=_DESCRIBED, low=0.0)
_gain = partial(of_controller, absent=_DESCRIBED, low=0.0, shown=False)
_KP = _gain('kp', 'N m/rad', 'torque of the actuator per position error', 100.0, high=1e7)
_KV = _gain('kv', 'N m s/rad', 'torque of the actuator per velocity', 1.0, high=1e6)
_LIMIT = _gain('force_limit', 'N m', 'largest torque of the actuator', 5.0, high=1e6)
_LATE = _gain('set_point_delay', 's', 'how late the actuator takes its set-point', 0.1, high=1.0,
              absent='0 by default', default=0.0)  # fmt: skip
KIND = Kind(
    name='mujoco',
    title='a URDF or MJCF that MuJoCo simulates, its actuators following the set-points',
    keys=(
        *head('mujoco', ('joint_1',)),
        _DESCRIPTION,
        _named('joint', '', "name of the drive's joint in the description", 'joint_1',
               absent="the drive's"),
        _named('actuator', '', 'name of its actuator', 'joint_1',
               absent='the one that acts on the joint'),
        _named('body', '', 'name of the body that body_mass and body_place are of', 'tool',
               absent="the joint's"),
        of_drive('direction', '',
                 "forward, or backward where the log's positive direction is the joint's negative",
                 'forward', absent='forward by default', default='forward',
                 choices=('forward', 'backward')),
        _KP, _KV, _LIMIT,
        _gain('velocity_feedforward', '1', "share of the set-point's velocity in kv's", 1.0,
              high=1.5, absent='0 by default'),
        _LATE,
        Key('controller', 'cycle', 's', 'how long a set-point holds', 0.01, low=1e-6, high=0.1),
        keys.DELAY.at((0.0, 0.05), shown=False, absent='none by default'),
        _found('joint_zero', 'rad', "the log's position where the joint's is 0", (-3.2, 3.2),
               high=100.0, shown=False, low=-100.0),
        _found('armature', 'kg m^2', 'of rotor and gear, at the joint', (0.0, 0.1), high=1e4),
        _found('damping', 'N m s/rad', 'viscous friction of the joint', (0.0, 2.0), high=1e5),
        _found('frictionloss', 'N m', 'dry friction of the joint', (0.0, 0.5), high=1e5),
        _found('stiffness', 'N m/rad', "of the joint's spring", (0.0, 10.0), high=1e6,
               shown=False),
        _KP.searched(1.0, 1e3, shown=True), _KV.searched(0.0, 10.0, shown=True),
        _LIMIT.searched(0.1, 10.0),
        _found('actuator_gear', '1', 'torque at the joint per torque of the actuator',
               (0.5, 2.0), high=1e4, shown=False, low=-1e4),
        _LATE.searched(0.0, 0.2, shown=True),
        _found('body_mass', 'kg', "of the joint's body or drive.body, its inertia in proportion",
               (0.0, 2.0), high=1e4, shown=False),
        _found('body_place', '1', "factor on the body's place in its parent", (0.9, 1.1),
               high=10.0, shown=False),
        _found('body_centre', '1', 'factor on the place of its centre of mass', (0.9, 1.1),
               high=10.0, shown=False),
        _found('body_inertia', '1', 'factor on its inertia, the mass being what it is', (0.5, 2.0),
               high=10.0, shown=False),
        Key('parameters', 'free_fall', 'm/s^2', 'acceleration of free fall', (9.7, 9.9),
            _DESCRIBED, low=0.0, high=25.0, shown=False),
    ),
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
