# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Machine code is made once: for one signature a kernel, for all who have the same sources."""

import json
import shutil
from pathlib import Path

import pytest
from tree.compiler.alone import run_alone

import bvh_ros
from bvh_ros.tree.compiler import processors

START = """
import gc, json, sys
import numpy as np
import bvh_ros
from bvh_ros import DynamicBVH
from bvh_ros.tree.compiler.kernel_parts import Kernel

assert bvh_ros.__path__[0] == sys.argv[1]
tree = DynamicBVH()
tree.insert([1, -1, -1], [2, 1, 1])
tree.insert_many(np.ones((3, 3)), np.full((3, 3), 2.0))
tree.move_many(tree.ids(), np.ones((4, 3)), np.full((4, 3), 3.0))
assert tree.raycast([0, 0, 0], [1, 1, 1]) is not None
print(json.dumps([
    [kernel.py_func.__name__, len(kernel.signatures), sum(kernel.stats.cache_misses.values())]
    for kernel in gc.get_objects()
    if isinstance(kernel, Kernel) and kernel.signatures
]))
"""


def start(package: Path) -> dict[str, tuple[int, int]]:
    """What a new process calls of this copy: each kernel's signatures, and how many it had to
    compile.
    """
    ended = run_alone(START, str(package), cwd=package.parent, PYTHONPATH=str(package.parent))
    return {name: (signatures, misses) for name, signatures, misses in json.loads(ended.stdout)}


def test_equal_sources_share_machine_code_wherever_they_are(tmp_path):
    here = Path(bvh_ros.__file__).parent
    elsewhere = tmp_path / 'bvh_ros'
    shutil.copytree(here, elsewhere)
    called = start(here)
    assert 'insert_one' in called
    assert {name: misses for name, (_, misses) in start(elsewhere).items()} == dict.fromkeys(
        called, 0
    )


def test_a_kernel_is_compiled_for_one_signature():
    """Lists, single boxes and many come to it as arrays of one type."""
    called = start(Path(bvh_ros.__file__).parent)
    assert {name: signatures for name, (signatures, _) in called.items()} == dict.fromkeys(
        called, 1
    )


PROBE = """
from bvh_ros.tree.compiler.compiling import kernel
from bvh_ros.tree.insertion import refit_ancestors


@kernel
def refit_twice(nodes, heights, state, node):
    refit_ancestors(nodes, heights, state, node, 1)  # twice: too long to become part of this one
    refit_ancestors(nodes, heights, state, node, 1)
"""
REFIT = """
import sys

import numpy as np
from bvh_ros.tree.nodes import NONE, node_dtype
from bvh_ros.tree.probe import refit_twice

for ndim in map(int, sys.argv[1]):
    nodes = np.zeros(3, node_dtype(ndim))  # two leaves, and their parent between them
    nodes['lo'], nodes['hi'] = [[0.0], [5.0], [2.0]], [[1.0], [6.0], [3.0]]
    nodes['left'], nodes['right'], nodes['parent'] = [NONE, 0, NONE], [NONE, 2, NONE], [1, NONE, 1]
    refit_twice(nodes, np.array([0, 1, 0], np.int16), np.zeros(9, np.int64), 1)
    assert (*nodes[1]['lo'], *nodes[1]['hi']) == ndim * (0,) + ndim * (3,), nodes[1]
"""


@pytest.mark.slow
def test_code_from_two_processes_does_not_mix(tmp_path):
    """One compiled for 2D nodes, the other one for 3D nodes, each as its first function."""
    shutil.copytree(Path(bvh_ros.__file__).parent, tmp_path / 'bvh_ros')
    (tmp_path / 'bvh_ros' / 'tree' / 'probe.py').write_text(PROBE)
    for dimensions in ('2', '3', '23', '32'):
        places = {'PYTHONPATH': str(tmp_path), 'NUMBA_CACHE_DIR': str(tmp_path)}
        run_alone(REFIT, dimensions, cwd=tmp_path, **places)


FIRST_BOX = """
import subprocess, sys, time
from pathlib import Path
from bvh_ros import DynamicBVH

folder, deadline = Path(sys.argv[1]), time.monotonic() + 2000.0
if len(sys.argv) > 2:
    subprocess.Popen = None
DynamicBVH().insert([1, -1, -1], [2, 1, 1])
while not [*folder.rglob('*raycast_one*.nbc')]:
    assert time.monotonic() < deadline
    time.sleep(0.05)
"""


@pytest.mark.slow
@pytest.mark.skipif(processors() == 1, reason='there is nothing to gain')
def test_a_ray_is_compiled_in_another_process_while_the_first_box_is_in_this_one(tmp_path):
    for once_more in ([], ['without processes']):
        arguments = str(tmp_path), *once_more
        run_alone(FIRST_BOX, *arguments, NUMBA_CACHE_DIR=str(tmp_path), BVH_ROS_KERNELS='')
