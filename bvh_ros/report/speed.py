# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report speed`: growth, policies of moving, sibling searches and cold start."""

import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import cycle
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import DynamicBVH
from ..tree import dynamic_bvh
from ..tree.compiler import processors
from . import compiled_kernels
from .page import Cell, Page, Table
from .scenes import Boxes, Rays, incoherent_rays, moved, spread, uniform_boxes
from .timing import Job, interleaved

# ---- Growth: time and memory a box, and time a ray, from a thousand to a million boxes.


GROWTH_SIZES = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
GROWTH_SIZES_QUICK = (100, 1_000)
GROWTH_RAYS, GROWTH_REPEATS = 20_000, 5
GROWTH_HEADER = (
    'boxes', 'ns a ray', 'ns a ray, 2 threads', 'ns a box, built', 'bytes a box', 'height',
    '4 log2 n + 4', 'tree cost',
)  # fmt: skip


def growth(page: Page, brief: bool) -> None:
    """Measure."""
    rows = []
    for size in GROWTH_SIZES_QUICK if brief else GROWTH_SIZES:
        rows.append(_growth_row(size, 200 if brief else GROWTH_RAYS))
    page.add('### Growth')
    page.add(
        'Uniform boxes that fill 2 % of the cube; incoherent rays in batches, after so many that '
        'the wide snapshot was worth building; margin 0. '
        '*bytes a box*: the arrays of a tree built at this size. The process has used '
        f'{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:,.0f} MB at most.'
    )
    page.table(Table('speed_growth', GROWTH_HEADER, rows))


def _growth_row(size: int, asked: int) -> list[int | float]:
    rng = np.random.default_rng(size)
    boxes, rays = uniform_boxes(size, rng), incoherent_rays(asked, rng)
    tree = DynamicBVH.from_boxes(*boxes)
    while not tree.stats()['wide_snapshot']:
        tree.raycast_many(*rays)
    jobs = {
        'one': Job(lambda: tree.raycast_many(*rays), asked),
        'two': Job(lambda: tree.raycast_many(*rays, threads=2), asked),
        'build': Job(lambda: DynamicBVH.from_boxes(*boxes), size),
    }
    timings = interleaved(jobs, GROWTH_REPEATS, warm=True)
    times = {name: timing.nanoseconds for name, timing in timings.items()}
    bytes_a_box = DynamicBVH.from_boxes(*boxes).stats()['bytes'] / size
    bound = 4 * float(np.log2(size)) + 4
    return [size, *times.values(), bytes_a_box, tree.height, bound, tree.cost()]


# ---- Cold start: from `import bvh_ros` to the first answer, with compiled kernels and without,
# and what a node compiles, kernel by kernel.


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
        found = compiled_kernels.measure(NUMBA_CACHE_DIR=folder, BVH_ROS_KERNELS='')
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
from bvh_ros.report.compiled_kernels import default_jobs
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


# ---- Policies: inserting again, refitting in place or building anew, by the share that moved.


POLICY_BOXES, POLICY_REPEATS = 10_000, 6
SHARES = (1 / 256, 1 / 128, 1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)
SHARES_QUICK = (1 / 8, 1.0)
# Shares from which on move_many refits, and builds anew; above 1 is never.
POLICIES = {'reinsert': (2.0, 2.0), 'refit': (0.0, 2.0), 'rebuild': (0.0, 0.0)}
CHOSEN = 'as chosen'
KINDS = ('nearby', 'anywhere')


def policies(page: Page, brief: bool) -> None:
    """Measure both kinds of movement."""
    size = 300 if brief else POLICY_BOXES
    page.add('### Policies of move_many')
    page.add(
        f'{size:,} boxes; a share of them, others each time, moves nearby (up to one edge) or '
        f"anywhere. us a call; *cost* is the tree's cost after {POLICY_REPEATS + 1} calls over "
        'that of a new build. *refit* inserts those that move far again. `move_many` refits from '
        f'a share of {dynamic_bvh.REFIT_SHARE}, and builds anew if {dynamic_bvh.REBUILD_SHARE} '
        'move far.'
    )
    for kind in KINDS:
        rows = [_policy_row(size, share, kind) for share in (SHARES_QUICK if brief else SHARES)]
        names = *POLICIES, CHOSEN
        header = ['share', *(f'{what}, {name}' for what in ('us', 'cost') for name in names)]
        page.add(f'Moved {kind}:')
        page.table(Table(f'speed_policies_{kind}', header, rows))


@contextmanager
def policy(name: str) -> Iterator[None]:
    """Let move_many follow one policy, whatever the share."""
    before = dynamic_bvh.SHARES
    dynamic_bvh.SHARES = POLICIES.get(name, before)
    try:
        yield
    finally:
        dynamic_bvh.SHARES = before


class Mover:
    """A tree whose boxes move under one policy; each mover makes the same moves."""

    def __init__(self, boxes: Boxes, share: float, kind: str, name: str) -> None:
        self.name = name
        self.tree = DynamicBVH.from_boxes(*boxes)
        rng = np.random.default_rng(2)
        self._ids = self.tree.ids()
        self.count = max(1, round(share * len(self._ids)))
        self._moves = cycle([self._move(boxes, kind, rng) for _ in range(POLICY_REPEATS + 1)])

    def _move(
        self, boxes: Boxes, kind: str, rng: np.random.Generator
    ) -> tuple[NDArray[np.int64], Boxes]:
        rows = np.sort(rng.choice(len(self._ids), self.count, replace=False))
        here = Boxes(boxes.lo[rows], boxes.hi[rows])
        edges = here.hi - here.lo
        if kind == 'nearby':
            return rows, moved(here, rng.uniform(-1, 1, edges.shape) * edges)
        return rows, moved(here, spread(len(rows), rng) - (here.lo + here.hi) / 2)

    def step(self) -> None:
        """Make the next move."""
        rows, boxes = next(self._moves)
        with policy(self.name):
            self.tree.move_many(self._ids[rows], *boxes)

    def worsened(self) -> float:
        """Cost of the tree over that of a new build."""
        cost = self.tree.cost()
        self.tree.rebuild()
        return cost / self.tree.cost()


def _policy_row(size: int, share: float, kind: str) -> list[float]:
    boxes = uniform_boxes(size, np.random.default_rng(3))
    movers = {name: Mover(boxes, share, kind, name) for name in (*POLICIES, CHOSEN)}
    jobs = {name: Job(mover.step, 1) for name, mover in movers.items()}
    times = interleaved(jobs, POLICY_REPEATS)
    return [
        share,
        *(times[name].nanoseconds / 1e3 for name in movers),
        *(mover.worsened() for mover in movers.values()),
    ]


# ---- Searches: greedy or branch and bound, next to a bulk build.


SEARCH_SIZES, SEARCH_SIZES_QUICK = (1_000, 10_000, 100_000), (200,)
SEARCH_RAYS, ROUNDS, SEARCH_REPEATS = 20_000, 3, 3
FEW = 0.04  # of the boxes at once: move_many inserts those again one by one
SEARCH_HEADER = (
    'boxes', 'built by', 'ns a box, inserted', 'cost / SAH', 'height', 'ns a ray', 'ns a move',
    'cost / SAH, moved', 'height, moved', 'ns a ray, moved',
)  # fmt: skip


class Plan(NamedTuple):
    """Boxes, where they move to, and rays."""

    boxes: Boxes
    places: list[Boxes]
    rays: Rays


def searches(page: Page, brief: bool) -> None:
    """Measure the trees."""
    rows = [
        row
        for size in (SEARCH_SIZES_QUICK if brief else SEARCH_SIZES)
        for row in _rows(size, brief)
    ]
    page.add('### Sibling searches')
    page.add(
        'Boxes inserted one by one in random order; then every box moved one edge at most, one by '
        'one, three times over. *cost / SAH*: cost of the tree over that of a bulk build of the '
        'same boxes.'
    )
    page.table(Table('speed_searches', SEARCH_HEADER, rows))


def _plan(size: int, brief: bool) -> Plan:
    rng = np.random.default_rng(4)
    boxes = uniform_boxes(size, rng)
    edges = boxes.hi - boxes.lo
    places = [moved(boxes, rng.uniform(-1, 1, edges.shape) * edges) for _ in range(ROUNDS)]
    return Plan(boxes, places, incoherent_rays(200 if brief else SEARCH_RAYS, rng))


def _rows(size: int, brief: bool) -> list[list[Cell]]:
    plan = _plan(size, brief)
    before, after = (DynamicBVH.from_boxes(*boxes) for boxes in (plan.boxes, plan.places[-1]))
    rows: list[list[Cell]] = []
    for search in ('greedy', 'branch_and_bound'):
        rows.append([size, search, *_grown(plan, search, before.cost(), after.cost())])
    build = interleaved(
        {'': Job(lambda: DynamicBVH.from_boxes(*plan.boxes), size)}, SEARCH_REPEATS
    )['']
    rays = [_ray_time(tree, plan.rays) for tree in (before, after)]
    rows.append([size, 'bulk build', build.nanoseconds, 1.0, before.height, rays[0]])
    rows[-1] += [None, 1.0, after.height, rays[1]]
    return rows


def _grown(plan: Plan, search: str, before: float, after: float) -> list[Cell]:
    """Insert row by row, then move row by row: of each the time, cost, height and rays."""
    count = len(plan.boxes.lo)
    tree = DynamicBVH(capacity=count, sibling_search=search)
    start = time.perf_counter()
    for lo, hi in zip(plan.boxes.lo[:2], plan.boxes.hi[:2], strict=True):
        tree.insert(lo, hi)
    while (done := len(tree)) < count:  # more at once than there are, and it would be built anew
        rows = slice(done, min(2 * done - 1, count))
        tree.insert_many(plan.boxes.lo[rows], plan.boxes.hi[rows])
    inserted, handles = (time.perf_counter() - start) * 1e9 / count, tree.ids()
    row: list[Cell] = [inserted, tree.cost() / before, tree.height, _ray_time(tree, plan.rays)]
    start = time.perf_counter()
    few = max(1, int(FEW * count))
    for place in plan.places:
        for first in range(0, count, few):
            rows = slice(first, first + few)
            tree.move_many(handles[rows], place.lo[rows], place.hi[rows])
    moved_in = (time.perf_counter() - start) * 1e9 / (count * len(plan.places))
    tree.validate()
    return [*row, moved_in, tree.cost() / after, tree.height, _ray_time(tree, plan.rays)]


def _ray_time(tree: DynamicBVH, rays: Rays) -> float:
    job = Job(lambda: tree.raycast_many(*rays), len(rays.origins))
    return interleaved({'': job}, SEARCH_REPEATS)[''].nanoseconds


INTRODUCTION = '## Speed'
SECTIONS = {
    'growth': growth,
    'policies': policies,
    'searches': searches,
    'cold start': cold_start,
    'cold start of a node': kernels,
}
