# SPDX-License-Identifier: Apache-2.0
"""Bags as `ros2 bag record -a` makes them beside ros2_control."""

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

from ros2_ident.recording.cdr import JOINT_STATE
from ros2_ident.recording.maps import TRAJECTORY

ARRAY = 'std_msgs/msg/Float64MultiArray'
CONTROLLER_STATE = 'control_msgs/msg/JointTrajectoryControllerState'
DYNAMIC_STATE = 'control_msgs/msg/DynamicJointState'

# Fields of the messages in control_msgs, branch jazzy.
_CONTROLLER = """
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint reference
trajectory_msgs/JointTrajectoryPoint feedback
trajectory_msgs/JointTrajectoryPoint error
trajectory_msgs/JointTrajectoryPoint output
string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_reference
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_feedback
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_output
float64 speed_scaling_factor
"""
# Noetic's, which Foxy has too.
_OLD_CONTROLLER = """
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
"""
_DYNAMIC = """
std_msgs/Header header
string[] joint_names
control_msgs/InterfaceValue[] interface_values
"""
_INTERFACE = """
string[] interface_names
float64[] values
"""


def store_of(*, old=False):
    """Return a type store that knows control_msgs too."""
    store = get_typestore(Stores.ROS2_JAZZY)
    interface = get_types_from_msg(_INTERFACE, 'control_msgs/msg/InterfaceValue')
    text = _OLD_CONTROLLER if old else _CONTROLLER
    store.register(interface | get_types_from_msg(_DYNAMIC, DYNAMIC_STATE))
    store.register(get_types_from_msg(text, CONTROLLER_STATE))
    return store


class Maker:
    """Makes messages of ros2_control.

    Args:
        old: Whether the controller's state is Noetic's.
    """

    def __init__(self, *, old=False):
        self.old, self.store = old, store_of(old=old)
        self.types = self.store.types

    def _header(self, stamp):
        second = self.types['builtin_interfaces/msg/Time'](stamp // 10**9, stamp % 10**9)
        return self.types['std_msgs/msg/Header'](second, 'base_link')

    def _point(self, position=(), velocity=(), acceleration=(), effort=(), after=0):
        time = self.types['builtin_interfaces/msg/Duration'](after // 10**9, after % 10**9)
        kind = self.types['trajectory_msgs/msg/JointTrajectoryPoint']
        return kind(*(_array(x) for x in (position, velocity, acceleration, effort)), time)

    def joint_state(self, stamp, names, position=(), velocity=(), effort=()):
        """Return a JointState."""
        arrays = [_array(x) for x in (position, velocity, effort)]
        return self.types[JOINT_STATE](self._header(stamp), list(names), *arrays)

    def controller(self, stamp, names, reference, feedback, output=()):
        """Return a controller's state; reference and feedback are position and velocity."""
        points = [
            self._point(*reference),
            self._point(*feedback),
            self._point(_array(reference[0]) - feedback[0]),
        ]
        header = self._header(stamp)
        if self.old:
            return self.types[CONTROLLER_STATE](header, list(names), *points)
        none = self.types['builtin_interfaces/msg/Duration'](0, 0)
        other = self.types['trajectory_msgs/msg/MultiDOFJointTrajectoryPoint']([], [], [], none)
        points.append(self._point(effort=output))
        return self.types[CONTROLLER_STATE](
            header, list(names), *points, [], other, other, other, other, 1.0
        )

    def dynamic(self, stamp, interfaces):
        """Return a DynamicJointState of `{joint: {interface: value}}`."""
        kind = self.types['control_msgs/msg/InterfaceValue']
        values = [kind(list(x), _array(list(x.values()))) for x in interfaces.values()]
        return self.types[DYNAMIC_STATE](self._header(stamp), list(interfaces), values)

    def array(self, values):
        """Return a Float64MultiArray."""
        size = self.types['std_msgs/msg/MultiArrayDimension']('joints', len(values), len(values))
        layout = self.types['std_msgs/msg/MultiArrayLayout']([size], 0)
        return self.types[ARRAY](layout, _array(values))

    def trajectory(self, stamp, names, points):
        """Return a JointTrajectory of points (time [ns], position, velocity, acceleration)."""
        points = [self._point(*fields, after=after) for after, *fields in points]
        return self.types[TRAJECTORY](self._header(stamp), list(names), points)

    def bytes_of(self, kind, message):
        """Return a serialised message."""
        return bytes(self.store.serialize_cdr(message, kind))

    def write(self, path, messages, storage='mcap'):
        """Write `[(time, topic, type, message)]` as a bag, in the order of time."""
        plugin = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}[storage]
        with Writer(path, version=9, storage_plugin=plugin) as writer:
            topics = {}
            for when, topic, kind, message in sorted(messages, key=lambda x: x[0]):
                if topic not in topics:
                    topics[topic] = writer.add_connection(topic, kind, typestore=self.store)
                writer.write(topics[topic], when, self.bytes_of(kind, message))
        return path


def _array(values):
    return np.array(values, dtype=np.float64)


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
