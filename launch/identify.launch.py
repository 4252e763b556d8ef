# SPDX-License-Identifier: Apache-2.0
"""Start the identifier, and a replay into it where a bag is given.

ros2 launch ros2_ident identify.launch.py machine_file:=my_machine.yaml bag:=my_bag
"""

from pathlib import Path
from typing import Any

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext, LaunchDescription

# Argument, default, description. Topics are relative to the namespace.
ARGUMENTS = (
    ('machine_file', '', 'what is known of the machine; empty: as the parameter file has it'),
    ('params_file', '', 'parameters of the node; empty: all at their defaults'),
    ('namespace', '', 'namespace of the node and of its topics'),
    ('use_sim_time', 'false', 'take the time from /clock'),
    ('state_topic', 'joint_states', 'measured motion'),
    ('effort_topic', 'effort', 'measured effort'),
    ('command_topic', 'joint_command', 'set-point'),
    ('bag', '', 'bag to replay; empty: wait for live topics'),
    ('rate', '1.0', 'pace of the replay'),
)


def generate_launch_description() -> LaunchDescription:
    """Return the node with its parameters, and the replay."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, default, text in ARGUMENTS
            ),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context: LaunchContext) -> list[Node]:
    given = {name: LaunchConfiguration(name).perform(context) for name, _, _ in ARGUMENTS}
    machine, file = given['machine_file'], given['params_file']
    if not machine and not file:
        machine = str(Path(FindPackageShare('ros2_ident').perform(context)) / 'config/tripod.yaml')
    values: dict[str, Any] = {'use_sim_time': given['use_sim_time'].lower() in ('true', '1')}
    if machine:
        # A text alone would be read as YAML, where a: b is no path.
        values['machine_file'] = ParameterValue(machine, value_type=str)
    topics = {
        'joint_states': given['state_topic'],
        'effort': given['effort_topic'],
        'joint_command': given['command_topic'],
    }
    nodes = [
        Node(
            package='ros2_ident',
            executable='identifier',
            output='screen',
            namespace=given['namespace'],
            parameters=[*([file] if file else []), values],
            remappings=list(topics.items()),
        )
    ]
    if given['bag']:
        nodes.append(
            Node(
                package='ros2_ident',
                executable='replay',
                output='screen',
                namespace=given['namespace'],
                remappings=[(f'/{name}', topic) for name, topic in topics.items()],
                arguments=[given['bag'], '--wait-for-subscribers', '--rate', given['rate']],
            )
        )
    return nodes
