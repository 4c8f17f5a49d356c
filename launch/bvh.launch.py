# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Start the node, with a parameter file or without, and RViz if wanted.

ros2 launch bvh_ros bvh.launch.py
ros2 launch bvh_ros bvh.launch.py params_file:=/path/to/bvh_ros.yaml namespace:=robot1 rviz:=true
"""

from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

RVIZ_FILE = Path(__file__).parent.parent / 'config' / 'bvh.rviz'


def generate_launch_description() -> LaunchDescription:
    """Return the nodes and the arguments they listen to."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'params_file', default_value='', description='YAML file with parameters.'
            ),
            DeclareLaunchArgument(
                'namespace', default_value='', description='Namespace of the nodes.'
            ),
            DeclareLaunchArgument(
                'use_sim_time',
                default_value='',
                description='true: follow /clock. Empty: as the parameter file says.',
            ),
            DeclareLaunchArgument(
                'rviz', default_value='false', description='true: show the world in RViz.'
            ),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context, *_args, **_kwargs):
    # An empty text is neither a file nor a choice: only now is it known whether one was given.
    given = {
        name: LaunchConfiguration(name).perform(context)
        for name in ('params_file', 'use_sim_time', 'rviz')
    }
    clock = [{'use_sim_time': _is_true(given['use_sim_time'])}] if given['use_sim_time'] else []
    parameters = [given['params_file']] if given['params_file'] else []
    nodes = [
        Node(
            package='bvh_ros',
            executable='bvh_node',
            name='bvh',
            namespace=LaunchConfiguration('namespace'),
            parameters=[*parameters, *clock],
            output='screen',
        )
    ]
    if _is_true(given['rviz']):
        nodes.append(
            Node(
                package='rviz2',
                executable='rviz2',
                name='rviz',
                namespace=LaunchConfiguration('namespace'),
                arguments=['-d', str(RVIZ_FILE)],
                parameters=clock,
            )
        )
    return nodes


def _is_true(text: str) -> bool:
    return text.lower() in ('true', '1')
