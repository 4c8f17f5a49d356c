# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Start the node, with a parameter file or without.

ros2 launch bvh_ros bvh.launch.py
ros2 launch bvh_ros bvh.launch.py params_file:=/path/to/bvh_ros.yaml namespace:=robot1
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Return one node and the arguments it listens to."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'params_file', default_value='', description='YAML file with parameters.'
            ),
            DeclareLaunchArgument(
                'namespace', default_value='', description='Namespace of the node.'
            ),
            DeclareLaunchArgument(
                'use_sim_time', default_value='false', description='Follow /clock.'
            ),
            OpaqueFunction(function=_node),
        ]
    )


def _node(context, *_args, **_kwargs):
    # An empty file name is not a file: only now is it known whether one was given.
    params_file = LaunchConfiguration('params_file').perform(context)
    use_sim_time = LaunchConfiguration('use_sim_time').perform(context).lower() == 'true'
    parameters = [params_file] if params_file else []
    return [
        Node(
            package='bvh_ros',
            executable='bvh_node',
            name='bvh',
            namespace=LaunchConfiguration('namespace'),
            parameters=[*parameters, {'use_sim_time': use_sim_time}],
            output='screen',
        )
    ]
