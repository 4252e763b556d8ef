# SPDX-License-Identifier: Apache-2.0
"""Bags as `ros2 bag record -a` makes them beside ros2_control."""

from message_makers import Messages
import numpy as np

from ros2_ident.recording.cdr import JOINT_STATE
from ros2_ident.recording.maps import TRAJECTORY
from ros2_ident.recording.streams import FIELDS

ARRAY = 'std_msgs/msg/Float64MultiArray'
CONTROLLER_STATE = 'control_msgs/msg/JointTrajectoryControllerState'
DYNAMIC_STATE = 'control_msgs/msg/DynamicJointState'
# Noetic's, which Foxy has too.
_OLD_CONTROLLER = """
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
"""
_PARTS = ('positions', 'velocities', 'accelerations')


class Maker(Messages):
    """Makes messages of ros2_control.

    Args:
        old: Whether the controller's state is Noetic's.
    """

    def __init__(self, *, old=False):
        super().__init__(texts={CONTROLLER_STATE: _OLD_CONTROLLER} if old else {})
        self.old = old

    def joint_state(self, stamp, names, *values):
        """Return a JointState."""
        fields = zip(('name', *FIELDS), (list(names), *values), strict=False)
        return self.made(JOINT_STATE, fields, stamp)

    def controller(self, stamp, names, reference, feedback, output=()):
        """Return a controller's state; reference and feedback are position and velocity."""
        fields = {'joint_names': list(names), 'header.frame_id': 'base_link'}
        points = {'reference': reference, 'feedback': feedback}
        points['error'] = [reference[0] - feedback[0]]
        titles = {'reference': 'desired', 'feedback': 'actual'} if self.old else {}
        for point, rows in points.items():
            title = titles.get(point, point)
            fields |= {f'{title}.{x}': y for x, y in zip(_PARTS, rows, strict=False)}
        fields |= {} if self.old else {'output.effort': output}
        return self.made(CONTROLLER_STATE, fields.items(), stamp)

    def dynamic(self, stamp, interfaces):
        """Return a DynamicJointState of `{joint: {interface: value}}`."""
        fields = {
            'joint_names': list(interfaces),
            'interface_values[].interface_names': [list(x) for x in interfaces.values()],
            'interface_values[].values': [list(x.values()) for x in interfaces.values()],
        }
        return self.made(DYNAMIC_STATE, fields.items(), stamp)

    def trajectory(self, stamp, names, points):
        """Return a JointTrajectory of points (time [ns], position, velocity, acceleration)."""
        fields = {'joint_names': list(names)}
        for n, part in enumerate(_PARTS, 1):
            fields[f'points[].{part}'] = [x[n] if n < len(x) else [] for x in points]
        for n, part in enumerate(('sec', 'nanosec')):
            fields[f'points[].time_from_start.{part}'] = [divmod(x[0], 10**9)[n] for x in points]
        return self.made(TRAJECTORY, fields.items(), stamp)


def as_ros2_control_records(maker, recording, *, efforts='state', dynamic=True):
    """Return a recording's messages as a joint state broadcaster and a controller publish them.

    Args:
        maker: Makes the messages.
        recording: State, effort and command with the same stamps.
        efforts: Where the efforts are: `state`, `dynamic` or `output` of the controller.
        dynamic: Whether the broadcaster's second topic is there.
    """
    state, effort, command = recording.state, recording.effort, recording.command
    names = state.names
    order = [names.index(x) for x in command.names]
    found = []
    for k, stamp in enumerate(state.stamp.tolist()):
        position, velocity, force = state.position[k], state.velocity[k], effort.effort[k]
        shown = force if efforts == 'state' else np.full(len(names), np.nan)
        values = [*position, 0.01], [*velocity, 0.0], [*shown, np.nan]
        reference = [command.position[k]]
        if command.velocity is not None:
            reference.append(command.velocity[k])
        output = force[order] if efforts == 'output' else ()
        feedback = position[order], velocity[order]
        state_message = maker.joint_state(stamp, (*names, 'gripper'), *values)
        controller = maker.controller(stamp, command.names, reference, feedback, output)
        topic = '/joint_trajectory_controller/controller_state'
        found.append((stamp + 200_000, '/joint_states', JOINT_STATE, state_message))
        found.append((stamp + 300_000, topic, CONTROLLER_STATE, controller))
        if dynamic:
            own = {'effort': force} if efforts == 'dynamic' else {}
            own = {'velocity': velocity, 'position': position, **own}
            interfaces = {x: {y: v[i] for y, v in own.items()} for i, x in enumerate(names)}
            message = maker.dynamic(stamp, {**interfaces, 'gpio': {'vacuum': 1.0}})
            found.append((stamp + 250_000, '/dynamic_joint_states', DYNAMIC_STATE, message))
    return found
