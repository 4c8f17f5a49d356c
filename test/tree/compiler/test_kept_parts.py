# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What kernels share is compiled once, in whatever process, and means the same in all."""

import json
import shutil
from pathlib import Path

import pytest
from tree.compiler.alone import run_alone

import bvh_ros

PROBE = """
from bvh_ros.tree.compiler.compiling import lean_kernel


@lean_kernel
def shared(x):
    total = 0.0
    for i in range(x.shape[0]):
        total += x[i] * SCALE
    return total


def power_of(n):
    @lean_kernel
    def power(x):
        return x**n

    return power


square, cube = power_of(2), power_of(3)


@lean_kernel
def squares(x):
    return square(x[0]) + square(shared(x))


@lean_kernel
def cubes(x):
    return cube(x[0]) + cube(shared(x)) + square(x[0])


@lean_kernel
def both(x):
    return squares(x) + cubes(x)


SCALE = 2.0
"""
CALL = """
import json, sys
import numba
import numpy as np
from bvh_ros.tree.compiler import kernel_parts
from bvh_ros.tree import probe

compiled = []
compiler = kernel_parts._PartCompiler.compile_extra
def noted(self, function):
    compiled.append(function.__name__)
    return compiler(self, function)
kernel_parts._PartCompiler.compile_extra = noted
x = np.array([1.0, 2.0])
kernel = getattr(probe, sys.argv[2])
answer = kernel.prepare((numba.typeof(x),)) if sys.argv[1] == 'prepare' else kernel(x)
print(json.dumps([answer, sorted(set(compiled))]))
"""


@pytest.fixture
def call(tmp_path):
    """Call or prepare a kernel in a new process: its answer, and which parts that has compiled."""
    shutil.copytree(Path(bvh_ros.__file__).parent, tmp_path / 'bvh_ros')
    (tmp_path / 'bvh_ros' / 'tree' / 'probe.py').write_text(PROBE)

    def begin(*names):
        places = {'PYTHONPATH': str(tmp_path), 'NUMBA_CACHE_DIR': str(tmp_path / 'cache')}
        ended = run_alone(CALL, *names, cwd=tmp_path, **places)
        return json.loads(ended.stdout)

    return begin


def test_a_part_from_another_process_is_linked_and_closures_stay_apart(call, tmp_path):
    """`both` gets parts that hold the closures of two processes, and those of its own."""
    assert call('prepare', 'squares') == [None, ['power', 'shared', 'squares']]
    assert call('prepare', 'cubes') == [None, ['cubes', 'power']]
    assert call('call', 'both') == [255.0, []]
    assert call('call', 'cubes') == [218.0, ['power']]


def test_a_damaged_part_or_one_of_other_sources_is_compiled_again(call, tmp_path):
    call('prepare', 'shared')
    [part] = tmp_path.rglob('*.part')
    whole = part.read_bytes()
    for bad in (whole[:-1], whole[:-2] + b'\0\0'):  # for others see `test_sealed_kernels`
        part.write_bytes(bad)
        assert call('prepare', 'shared') == [None, ['shared']]
        assert part.read_bytes() != bad
    probe = tmp_path / 'bvh_ros' / 'tree' / 'probe.py'
    probe.write_text(PROBE.replace('SCALE = 2.0', 'SCALE = 3.0'))
    assert call('call', 'squares') == [82.0, ['power', 'shared']]
