# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the package takes from rclpy's inside has one door, which says what is missing."""

import ast
import importlib
import sys
from pathlib import Path

import pytest
from rclpy import executors
from rclpy.impl.implementation_singleton import rclpy_implementation as compiled

import bvh_ros

PACKAGE = Path(bvh_ros.__file__).parent
DOOR = 'bvh_ros.ros.private_rclpy'


@pytest.mark.parametrize(
    ('owner', 'name'),
    [
        (compiled, 'RCLError'),
        (compiled, 'UnknownROSArgsError'),
        (compiled, 'WaitSet'),
        (executors.SingleThreadedExecutor, '_spin_once_impl'),
        (executors.Executor, '_take_subscription'),
        (executors.Executor, '_take_service'),
        (executors.Executor, '_take_waitable'),
    ],
)
def test_a_name_that_is_gone_is_named(monkeypatch, owner, name):
    monkeypatch.delattr(owner, name)
    monkeypatch.delitem(sys.modules, DOOR, raising=False)
    with pytest.raises(ImportError, match=f"this rclpy has no '{name}'.*Jazzy"):
        importlib.import_module(DOOR)


def test_there_is_one_door():
    inside = set()
    for path in PACKAGE.rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text())):
            modules = [node.module or ''] if isinstance(node, ast.ImportFrom) else []
            modules += [one.name for one in node.names] if isinstance(node, ast.Import) else []
            if any(name.startswith(('rclpy.impl', 'rclpy._')) for name in modules):
                inside.add(str(path.relative_to(PACKAGE)))
    assert inside == {'ros/private_rclpy.py'}
