# SPDX-License-Identifier: Apache-2.0
"""Start the identifier, and a replay into it where a bag is given.

ros2 launch ros2_ident identify.launch.py machine_file:=my_machine.yaml bag:=my_bag
"""

from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext, LaunchDescription
from ros2_ident.ros.launching import ARGUMENTS, node_options, replay_remappings


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
    share = Path(FindPackageShare('ros2_ident').perform(context))
    options = node_options(given, share)
    nodes = [Node(package='ros2_ident', executable='identifier', output='screen', **options)]
    if given['bag']:
        nodes.append(
            Node(
                package='ros2_ident',
                executable='replay',
                output='screen',
                remappings=replay_remappings(given),
                arguments=[given['bag'], '--wait-for-subscribers', '--rate', given['rate']],
            )
        )
    return nodes
