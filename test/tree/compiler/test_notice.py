# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A first use says on a terminal, and nowhere else, that it compiles."""

import os
import subprocess
import sys

import pytest
from tree.compiler.alone import run_alone

FIRST_USE = 'from bvh_ros import DynamicBVH; DynamicBVH(ndim=2).insert([0, 0], [1, 1])'
NOTICE = 'bvh_ros: compiling for this machine, once; later starts load it\r\n'


def said_on_terminal(cache: str) -> str:
    ours, theirs = os.openpty()
    environment = os.environ | {'NUMBA_CACHE_DIR': cache}
    subprocess.run([sys.executable, '-c', FIRST_USE], stderr=theirs, env=environment, check=True)
    os.close(theirs)
    said = b''
    try:
        while more := os.read(ours, 1 << 16):
            said += more
    except OSError:  # nobody has the other end any more
        pass
    os.close(ours)
    return said.decode()


@pytest.mark.skipif(sys.platform == 'win32', reason='there are no such terminals')
def test_a_first_use_says_so_once_on_a_terminal(tmp_path):
    assert said_on_terminal(str(tmp_path)) == NOTICE
    assert said_on_terminal(str(tmp_path)) == ''


# Of one small kernel, which is told of at once, too: else nothing is said for a second.
SMALL = """
import numpy as np
from bvh_ros.tree import checks
from bvh_ros.tree.compiler import kernel_parts

kernel_parts._silent_left = 0.001
checks.first_not_finite(np.zeros((1, 2)))
"""


def test_a_pipe_hears_nothing(tmp_path):
    ended = run_alone(SMALL, NUMBA_CACHE_DIR=str(tmp_path))
    assert (ended.stdout, ended.stderr) == ('', '')
    assert [*tmp_path.rglob('*.nbc')]  # it did compile
