# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Services appear only when the kernels are compiled: nothing is compiled while somebody waits.

Whether a kernel comes from the disk or from the compiler, the node asks for it in the same place;
so a late one is seen with a warm cache too, and no test has to compile.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from ros.patience import COMPILING

CLOUDS = {
    'sources': ['cloud', 'numbered', 'grid'],
    'cloud.type': 'PointCloud2',
    'cloud.topic': 'cloud',
    'numbered.type': 'PointCloud2',
    'numbered.topic': 'numbered',
    'grid.type': 'OccupancyGrid',
    'grid.topic': 'grid',
}


pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    'parameters',
    [
        pytest.param({}, id='no configuration'),
        pytest.param({'planar': True, 'threads': 2}, id='planar'),
        pytest.param(
            {**CLOUDS, 'margin': 0.1, 'views': ['robot'], 'robot.skip_inside': True}, id='clouds'
        ),
    ],
)
def test_nothing_is_compiled_once_the_services_are_there(parameters):
    script = Path(__file__).with_name('warm_node.py')
    ended = subprocess.run(
        [sys.executable, str(script), json.dumps(parameters)],
        capture_output=True,
        text=True,
        timeout=COMPILING,
        env={**os.environ, 'PYTHONPATH': f'{script.parent}{os.pathsep}{script.parents[1]}'},
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout == ''
