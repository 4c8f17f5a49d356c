# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plain Python users get the tree without ROS, python-fcl and the report's libraries."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = ('rclpy', 'fcl', 'matplotlib', 'tqdm', 'viser')


@pytest.mark.parametrize('module', ['bvh_ros', 'bvh_ros.tree', 'bvh_ros.scene'])
def test_importing_does_not_import_optional_parts(module):
    program = f'import sys, {module}; print(*(m for m in {HEAVY} if m in sys.modules))'
    result = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert result.stdout.split() == []


def test_the_scene_is_imported_with_its_first_name():
    program = (
        'import sys, bvh_ros; print("numba" in sys.modules, "bvh_ros.scene" in sys.modules)\n'
        'from bvh_ros import DynamicBVH; print("bvh_ros.scene" in sys.modules)\n'
        'from bvh_ros import NO_NODE, Mesh, Scene, ShapeKind, Shapes; print(Scene().planar)'
    )
    result = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True)
    assert result.stdout.split() == ['False'] * 4, result.stderr


@pytest.mark.parametrize('module', ['bvh_ros.demo', 'bvh_ros.ros.node', 'bvh_ros.view.main'])
def test_a_view_that_is_off_is_not_imported(module):
    pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)
    parts = '{"viser", "trimesh", "matplotlib"}'
    program = f'import sys, {module}; print(*{parts} & {{*sys.modules}})'
    result = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True)
    assert (result.returncode, result.stdout.split()) == (0, []), result.stderr


def test_a_node_starts_without_the_library_of_meshes():
    pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)
    program = (
        'import sys; from bvh_ros.report import workload\n'
        'for job in workload.default_jobs(): job.run()\n'
        'print("scipy.spatial" in sys.modules)'
    )
    result = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True)
    assert (result.returncode, result.stdout.split()) == (0, ['False']), result.stderr


PROGRAMS = sorted((Path(__file__).parent.parent / '.ci').glob('*.py'))


@pytest.mark.parametrize('program', PROGRAMS, ids=lambda path: path.stem)
def test_what_checks_import_is_there(program):
    """They run in CI alone, some for minutes."""
    pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)
    for node in ast.walk(ast.parse(program.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or '').startswith('bvh_ros'):
            module = importlib.import_module(node.module)
            for name in node.names:
                assert hasattr(module, name.name) or importlib.import_module(
                    f'{node.module}.{name.name}'
                )
