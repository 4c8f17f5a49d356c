# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plain Python users get the tree without ROS, python-fcl and the report's libraries."""

import subprocess
import sys

import pytest

HEAVY = ('rclpy', 'fcl', 'matplotlib', 'tqdm')


@pytest.mark.parametrize('module', ['bvh_ros', 'bvh_ros.tree', 'bvh_ros.scene'])
def test_importing_does_not_import_optional_parts(module):
    program = f'import sys, {module}; print(*(m for m in {HEAVY} if m in sys.modules))'
    result = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert result.stdout.split() == []
