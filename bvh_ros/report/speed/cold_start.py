# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Cold start: from `import bvh_ros` to the first answer, with compiled kernels and without, and
what a node compiles, kernel by kernel.
"""

import os
import statistics
import subprocess
import sys
import tempfile

from ...tree.compiler import processors
from ..page import Page
from ..tables import Cell, Table
from . import entries

WARM_RUNS = 5
FIRST_ANSWER = """
import time
start = time.perf_counter()
from bvh_ros import DynamicBVH
imported = time.perf_counter()
tree = DynamicBVH()
tree.insert([1, -1, -1], [2, 1, 1])
assert tree.raycast([0, 0, 0], [1, 0, 0]).t == 1.0
print(imported - start, time.perf_counter() - start)
"""


def cold_start(page: Page, brief: bool) -> None:
    """Measure in processes of their own; unless in brief, with an empty cache folder first."""
    rows: list[list[Cell]] = []
    with tempfile.TemporaryDirectory() as folder:
        if not brief:
            rows.append(['empty', *_first_answer(folder)])
        runs = []
        for _ in range(1 if brief else WARM_RUNS):
            runs.append(_first_answer(None if brief else folder))
    rows.append(['warm', *(statistics.median(column) for column in zip(*runs, strict=True))])
    page.add('### Cold start')
    page.add(
        'One box, one ray, in a new process. The first start ever compiles the kernels that it '
        'needs; later ones load them.'
    )
    header = 'kernel cache', 's, import', 's, import to first answer'
    page.table(Table('speed_cold_start', header, rows))


def kernels(page: Page, brief: bool) -> None:
    """Compile what a node without configuration calls, in one process, then in several."""
    page.add('### Cold start of a node')
    if brief:
        page.add('Left out: with an empty cache it takes two minutes.')
        return
    with tempfile.TemporaryDirectory() as folder:
        found = entries.measure(NUMBA_CACHE_DIR=folder, BVH_ROS_KERNELS='')
    rows: list[list[Cell]] = [[entry.name, entry.seconds, entry.llvm] for entry in found]
    alone = sum(entry.seconds for entry in found)
    rows.append(['all', alone, sum(entry.llvm for entry in found)])
    with tempfile.TemporaryDirectory() as folder:
        wall = _together(folder)
    page.add(
        f'A node without configuration calls {len(found)} kernels. One process compiles them in '
        f'{alone:.1f} s; the node has it done by several, and has them after {wall:.1f} s on the '
        f'{processors()} processors that it may use here. What a kernel calls is compiled as part '
        'of it, unless that came before.'
    )
    page.table(Table('speed_cold_kernels', ('kernel', 's', 's of that in LLVM'), rows))


TOGETHER = """
import time
began = time.perf_counter()
from bvh_ros.ros.compilation import Compilation
from bvh_ros.report.speed.entries import default_jobs
compilation = Compilation(default_jobs())
while not compilation.is_done:
    compilation.go_on(1.0)
print(time.perf_counter() - began)
"""


def _together(cache: str) -> float:
    """Seconds from the start of a process until it has all kernels, its imports included."""
    environment = {**os.environ, 'NUMBA_CACHE_DIR': cache, 'BVH_ROS_KERNELS': ''}
    return float(_output(TOGETHER, environment))


def _output(program: str, environment: dict[str, str]) -> str:
    command = [sys.executable, '-c', program]
    ended = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return ended.stdout


def _first_answer(cache: str | None) -> tuple[float, float]:
    environment = {**os.environ, **({'NUMBA_CACHE_DIR': cache} if cache else {})}
    imported, answered = map(float, _output(FIRST_ANSWER, environment).split())
    return imported, answered
