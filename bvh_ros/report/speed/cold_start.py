# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Cold start: from `import bvh_ros` to the first answer, with compiled kernels and without."""

import os
import statistics
import subprocess
import sys
import tempfile

from ..page import Page
from ..tables import Cell, Table

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
    page.table(
        Table('speed_cold_start', ('kernel cache', 's, import', 's, import to first answer'), rows)
    )


def _first_answer(cache: str | None) -> tuple[float, float]:
    environment = {**os.environ, **({'NUMBA_CACHE_DIR': cache} if cache else {})}
    result = subprocess.run(
        [sys.executable, '-c', FIRST_ANSWER],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    imported, answered = map(float, result.stdout.split())
    return imported, answered
