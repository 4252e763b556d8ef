# SPDX-License-Identifier: Apache-2.0
"""Start the identifier, and a replay into it where a bag is given.

ros2 launch ros2_ident identify.launch.py machine_file:=my_machine.yaml bag:=my_bag
"""

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Return the node with its parameters, and the replay."""
    share = FindPackageShare('ros2_ident')
    bag = LaunchConfiguration('bag')
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'machine_file',
                default_value=PathJoinSubstitution([share, 'config', 'tripod.yaml']),
                description='what is known of the machine',
            ),
            DeclareLaunchArgument(
                'params_file',
                default_value=PathJoinSubstitution([share, 'config', 'identifier.yaml']),
                description='parameters of the node',
            ),
            DeclareLaunchArgument(
                'bag', default_value='', description='bag to replay; empty to wait for live topics'
            ),
            DeclareLaunchArgument('rate', default_value='1.0', description='pace of the replay'),
            Node(
                package='ros2_ident',
                executable='identifier',
                output='screen',
                parameters=[
                    LaunchConfiguration('params_file'),
                    {'machine_file': LaunchConfiguration('machine_file')},
                ],
            ),
            Node(
                package='ros2_ident',
                executable='replay',
                output='screen',
                arguments=[
                    bag, '--wait-for-subscribers', '--rate', LaunchConfiguration('rate'),
                ],
                condition=IfCondition(PythonExpression(["'", bag, "' != ''"])),
            ),
        ]
    )
