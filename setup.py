# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Installation with pip and with colcon (ament_python)."""

from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

NAME = 'bvh_ros'

FCL = ['python-fcl>=0.7.0.6']
# One set that was tested together: these wheels must match each other.
ROS = [
    'ros-jazzy-rclpy==7.1.6',
    'ros-jazzy-common-interfaces==5.3.6',
    'ros-jazzy-rmw-fastrtps-cpp==8.4.3',
]
BAGS = ['rosbags>=0.10']
REPORT = ['matplotlib>=3.7', 'tqdm>=4.60']
MESHES = ['trimesh>=4.6', 'pycollada>=0.8']
VIEW = ['viser>=1.1,<2']
PEERS = ['embreex>=4.4', 'coal>=3.0', *FCL, 'rapier3d']
CLUSTER = ['dask[array]>=2024.8', 'distributed>=2024.8']
DOCS = ['sphinx>=7', 'myst-parser>=3', 'furo']
TEST = [
    'pytest>=7',
    'pytest-timeout>=2',
    'pytest-xdist>=3.7',
    'hypothesis>=6.80',
    *FCL,
    *ROS,
    *BAGS,
    *REPORT,
    *VIEW,
    *MESHES,
    *CLUSTER,
    'selenium>=4.20',
]

setup(
    name=NAME,
    version='1.0.0',
    description='Dynamic box tree of moving obstacles with exact raycasts, with or without ROS 2',
    long_description=Path('README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    author='The bvh_ros authors',
    license='Apache-2.0',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', glob('config/*')),
        (f'share/{NAME}/launch', glob('launch/*.launch.*')),
    ],
    zip_safe=False,
    python_requires='>=3.10',
    install_requires=['numpy>=1.24', 'numba>=0.62,<0.69', 'scipy>=1.10'],
    extras_require={
        'ros': ROS,
        'bags': BAGS,
        'report': REPORT,
        'peers': PEERS,
        'view': VIEW,
        'meshes': MESHES,
        'cluster': CLUSTER,
        'docs': DOCS,
        'test': TEST,
    },
    entry_points={
        'console_scripts': [
            'bvh_node = bvh_ros.commands:bvh_node',
            'bvh_lifecycle_node = bvh_ros.commands:bvh_lifecycle_node',
            'bvh_demo = bvh_ros.commands:bvh_demo',
            'bvh_warm_up = bvh_ros.commands:bvh_warm_up',
            'bvh_report = bvh_ros.commands:bvh_report',
            'bvh_view = bvh_ros.commands:bvh_view',
        ]
    },
)
