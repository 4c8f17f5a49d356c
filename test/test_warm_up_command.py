# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_warm_up` leaves a folder that starts can use."""

import json

import pytest
from tree.compiler.alone import run_alone

from bvh_ros.tree.compiler import shipped

# One small kernel in place of all, which take a minute.
ONE = """
import sys
from functools import partial
import numpy as np
from bvh_ros import warm_up

def one():
    from bvh_ros.ros.compile_jobs import Job
    from bvh_ros.tree import checks
    rows = np.array([[0.0, 1.0], [2.0, np.nan]])
    yield Job('one', 'one', 1.0, partial(checks.first_not_finite, rows))

warm_up._everything = one
sys.exit(warm_up.main())
"""


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """What is written under a relative path is no part of the package."""
    monkeypatch.chdir(tmp_path)


def warm_up(*arguments, code=ONE):
    nowhere = {'BVH_ROS_KERNELS': 'nowhere', 'NUMBA_CACHE_DIR': 'nowhere'}
    return run_alone(code, *map(str, arguments), ends=None, **nowhere)


@pytest.mark.parametrize('cpu', [pytest.param('native', marks=pytest.mark.slow), 'x86-64-v2'])
def test_it_leaves_kernels_for_a_processor(tmp_path, cpu):
    if shipped.missing_features(shipped.LEVELS.get(cpu, ())):
        pytest.skip(f'this is no {cpu}')
    ended = warm_up(tmp_path, '--cpu', cpu)
    assert (ended.returncode, ended.stderr) == (0, '')
    assert ended.stdout.splitlines()[-1].startswith(f'1 kernels for {cpu}, 0.0 MB, in {tmp_path}')
    (manifest,) = tmp_path.glob(f'bvh_ros/*/{shipped.MANIFEST}')
    content = json.loads(manifest.read_text())
    assert (content['codegen'][1] == cpu) == (cpu != 'native')
    assert 'sse4.2' in content['features']
    assert not shipped.missing_features(content['features'])


def test_what_cannot_be_is_said_in_a_line(tmp_path):
    (tmp_path / 'file').write_text('')
    for arguments, code, reason in (
        ((tmp_path, '--cpu', 'i386'), 2, 'invalid choice'),
        ((tmp_path, '--params-file', tmp_path / 'none'), 2, 'there is no file'),
        ((tmp_path / 'file',), 1, 'no folder to write kernels to'),
    ):
        ended = warm_up(*arguments)
        assert ended.returncode == code
        assert reason in ended.stderr
        assert 'Traceback' not in ended.stderr


def test_a_parameter_file_is_read_as_the_node_reads_it(tmp_path):
    pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)
    file = tmp_path / 'parameters.yaml'
    file.write_text('/**: {ros__parameters: {planar: true, batch: false}}')
    jobs = 'from bvh_ros import warm_up; from pathlib import Path; import sys; '
    jobs += 'print(*(job.key for job in warm_up._jobs_of(Path(sys.argv[1]))), sep="\\n")'
    names = warm_up(file, code=jobs).stdout
    assert 'obstacles (True, ' in names
    assert 'decode markers' in names
    assert 'nearest (True, ' in names  # compiled only when somebody asks, but then it is there
    assert 'batches' not in names
    assert 'paths' not in names
    file.write_text('/**: {ros__parameters: {planar: perhaps}}')
    ended = warm_up(tmp_path, '--params-file', file)
    assert (ended.returncode, ended.stderr.count('\n')) == (1, 1)
    assert 'planar' in ended.stderr
