# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the package takes from rclpy's inside has one door, which says what is missing."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

import bvh_ros

PACKAGE = Path(bvh_ros.__file__).parent
WITHOUT = """
from rclpy import executors
from rclpy.impl.implementation_singleton import rclpy_implementation as compiled
del {owner}.{name}
import {module}
"""


@pytest.mark.parametrize(
    ('owner', 'name', 'module'),
    [
        ('compiled', 'RCLError', 'bvh_ros.ros.node'),
        ('compiled', 'UnknownROSArgsError', 'bvh_ros.ros.node'),
        ('compiled', 'WaitSet', 'bvh_ros.client'),
        ('executors.SingleThreadedExecutor', '_spin_once_impl', 'bvh_ros.ros.node'),
        ('executors.Executor', '_take_subscription', 'bvh_ros.ros.node'),
        ('executors.Executor', '_take_service', 'bvh_ros.ros.node'),
        ('executors.Executor', '_take_waitable', 'bvh_ros.ros.node'),
    ],
)
def test_a_name_that_is_gone_is_named(owner, name, module):
    program = WITHOUT.format(owner=owner, name=name, module=module)
    ended = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True)
    last = ended.stderr.splitlines()[-1]
    assert last.startswith(f"ImportError: this rclpy has no '{name}'")
    assert 'Jazzy' in last


def test_there_is_one_door():
    inside = set()
    for path in PACKAGE.rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text())):
            modules = [node.module or ''] if isinstance(node, ast.ImportFrom) else []
            modules += [one.name for one in node.names] if isinstance(node, ast.Import) else []
            if any(name.startswith(('rclpy.impl', 'rclpy._')) for name in modules):
                inside.add(str(path.relative_to(PACKAGE)))
    assert inside == {'ros/private_rclpy.py'}
