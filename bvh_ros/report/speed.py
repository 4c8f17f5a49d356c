# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Growth, policies of moving, sibling searches and cold start."""

import resource
import statistics
import tempfile
from functools import partial
from itertools import cycle
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from .. import DynamicBVH
from ..tree import dynamic_bvh
from ..tree.compiler import processors
from . import workload
from .page import Cell, Page
from .scenes import Boxes, Rays, incoherent_rays, spread, uniform_boxes
from .stability import over_new_build
from .timing import Job, alone, interleaved, seconds

# ---- Growth from a thousand to a million boxes


GROWTH_SIZES = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
GROWTH_SIZES_QUICK = (100, 1_000)
GROWTH_RAYS, GROWTH_REPEATS = 20_000, 5
GROWTH_HEADER = (
    'boxes', 'ns a ray', 'ns a ray, 2 threads', 'ns a box, built', 'bytes a box', 'height',
    '4 log2 n + 4', 'tree cost',
)  # fmt: skip


def growth(page: Page, brief: bool) -> None:
    """Uniform boxes that fill 2 % of the cube; incoherent rays in batches, after so many that the
    wide snapshot was worth building; margin 0. *bytes a box*: the arrays of a tree built at this
    size.
    """
    sizes = GROWTH_SIZES_QUICK if brief else GROWTH_SIZES
    rows = [_growth_row(size, 200 if brief else GROWTH_RAYS) for size in sizes]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    page.add(f'The process has used {peak:,.0f} MB at most.')
    page.table('speed_growth', GROWTH_HEADER, rows)


def _growth_row(size: int, many: int) -> list[Cell]:
    rng = np.random.default_rng(size)
    boxes, rays = uniform_boxes(size, rng), incoherent_rays(many, rng)
    tree = DynamicBVH.from_boxes(*boxes)
    bytes_a_box = tree.stats()['bytes'] / size
    while not tree.stats()['wide_snapshot']:
        tree.raycast_many(*rays)
    jobs = {
        'one': Job(lambda: tree.raycast_many(*rays), many),
        'two': Job(lambda: tree.raycast_many(*rays, threads=2), many),
        'build': Job(lambda: DynamicBVH.from_boxes(*boxes), size),
    }
    times = [timing.nanoseconds for timing in interleaved(jobs, GROWTH_REPEATS).values()]
    return [size, *times, bytes_a_box, tree.height, 4 * float(np.log2(size)) + 4, tree.cost()]


# ---- Cold start: time to the first answer, and what a node compiles


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
    """One box, one ray, in a new process. The first start ever compiles the kernels that it needs;
    later ones load them.
    """
    rows: list[list[Cell]] = []
    with tempfile.TemporaryDirectory() as folder:
        cache = {} if brief else {'NUMBA_CACHE_DIR': folder}
        if not brief:
            rows.append(['empty', *_numbers(FIRST_ANSWER, **cache)])
        runs = [_numbers(FIRST_ANSWER, **cache) for _ in range(1 if brief else WARM_RUNS)]
    rows.append(['warm', *(statistics.median(column) for column in zip(*runs, strict=True))])
    header = 'kernel cache', 's, import', 's, import to first answer'
    page.table('speed_cold_start', header, rows)


TOGETHER = """
import time
began = time.perf_counter()
from bvh_ros.ros.compilation import Compilation
from bvh_ros.report.workload import default_jobs
compilation = Compilation(default_jobs())
while not compilation.is_done:
    compilation.go_on(1.0)
print(time.perf_counter() - began)
"""  # from the start of a process until it has all kernels, its imports included


def kernels(page: Page, brief: bool) -> None:
    """What a node without configuration calls, compiled in one process, then in several. What a
    kernel calls is compiled as part of it, unless that came before.
    """
    if brief:
        page.add('Left out: with an empty cache it takes two minutes.')
        return
    with tempfile.TemporaryDirectory() as folder:
        found = workload.compile_apart(NUMBA_CACHE_DIR=folder, BVH_ROS_KERNELS='')
    with tempfile.TemporaryDirectory() as folder:
        (wall,) = _numbers(TOGETHER, NUMBA_CACHE_DIR=folder, BVH_ROS_KERNELS='')
    rows: list[list[Cell]] = [[entry.name, entry.seconds, entry.llvm] for entry in found]
    alone = sum(entry.seconds for entry in found)
    rows.append(['all', alone, sum(entry.llvm for entry in found)])
    page.add(
        f'A node without configuration calls {len(found)} kernels. One process compiles them in '
        f'{alone:.1f} s; the node has it done by several, and has them after {wall:.1f} s on the '
        f'{processors()} processors that it may use here.'
    )
    page.table('speed_cold_kernels', ('kernel', 's', 's of that in LLVM'), rows)


def _numbers(program: str, **environment: str) -> list[float]:
    """The numbers that a program prints in a process of its own."""
    return [float(word) for word in workload.printed(program, **environment).split()]


# ---- Policies of move_many: reinsert, refit or rebuild, by the share that moved


POLICY_BOXES, POLICY_REPEATS = 10_000, 6
SHARES = (1 / 256, 1 / 128, 1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)
SHARES_QUICK = (1 / 8, 1.0)
# Shares from which on move_many refits, and builds anew; above 1 is never.
POLICIES = {
    'reinsert': (2.0, 2.0),
    'refit': (0.0, 2.0),
    'rebuild': (0.0, 0.0),
    'as chosen': dynamic_bvh.SHARES,
}


def policies(page: Page, brief: bool) -> None:
    """10,000 boxes; a share of them, others each time, moves nearby (up to one edge) or anywhere.
    us a call; *cost* is the tree's cost after 7 calls over that of a new build. *refit* inserts
    those that move far again.
    """
    size = 300 if brief else POLICY_BOXES
    page.add(
        f'`move_many` refits from a share of {dynamic_bvh.REFIT_SHARE}, and builds anew if '
        f'{dynamic_bvh.REBUILD_SHARE} move far.'
    )
    boxes = uniform_boxes(size, np.random.default_rng(3))
    header = ['share', *(f'{what}, {name}' for what in ('us', 'cost') for name in POLICIES)]
    for kind in ('nearby', 'anywhere'):
        rows: list[list[Cell]] = []
        for share in SHARES_QUICK if brief else SHARES:
            moves = _moves(boxes, share, kind)
            trees = {name: DynamicBVH.from_boxes(*boxes) for name in POLICIES}
            jobs = {name: _mover(tree, moves, POLICIES[name]) for name, tree in trees.items()}
            with patch.object(dynamic_bvh, 'SHARES'):  # put back at the end
                times = interleaved(jobs, POLICY_REPEATS, warm=False)
            costs = [over_new_build(tree) for tree in trees.values()]
            rows.append([share, *(timing.microseconds for timing in times.values()), *costs])
        page.add(f'Moved {kind}:')
        page.table(f'speed_policies_{kind}', header, rows)


def _moves(boxes: Boxes, share: float, kind: str) -> list[tuple[NDArray[np.int64], Boxes]]:
    """Rows, and where they move: one for each call, with other rows each time."""
    rng, found = np.random.default_rng(2), []
    count = max(1, round(share * len(boxes.lo)))
    for _ in range(POLICY_REPEATS + 1):
        rows = np.sort(rng.choice(len(boxes.lo), count, replace=False))
        here = Boxes(boxes.lo[rows], boxes.hi[rows])
        if kind == 'nearby':
            shift = rng.uniform(-1, 1, here.lo.shape) * here.edges
        else:
            shift = spread(count, rng) - here.centers
        found.append((rows, here.moved(shift)))
    return found


def _mover(
    tree: DynamicBVH, moves: list[tuple[NDArray[np.int64], Boxes]], shares: tuple[float, float]
) -> Job:
    """Makes the next move of a tree under one policy."""
    ids, turns = tree.ids(), cycle(moves)

    def run() -> None:
        rows, boxes = next(turns)
        dynamic_bvh.SHARES = shares
        tree.move_many(ids[rows], *boxes)

    return Job(run, 1)


# ---- Sibling searches: greedy, and branch and bound, compared with a bulk build


SEARCH_SIZES, SEARCH_SIZES_QUICK = (1_000, 10_000, 100_000), (200,)
SEARCH_RAYS, ROUNDS, SEARCH_REPEATS = 20_000, 3, 3
FEW = 0.04  # of the boxes at once: move_many inserts those again one by one
SEARCH_HEADER = (
    'boxes', 'built by', 'ns a box, inserted', 'cost / SAH', 'height', 'ns a ray', 'ns a move',
    'cost / SAH, moved', 'height, moved', 'ns a ray, moved',
)  # fmt: skip


def searches(page: Page, brief: bool) -> None:
    """Boxes inserted one by one in random order; then every box moved one edge at most, one by
    one, three times over. *cost / SAH*: cost of the tree over that of a bulk build of the same
    boxes.
    """
    rows: list[list[Cell]] = []
    for size in SEARCH_SIZES_QUICK if brief else SEARCH_SIZES:
        rows += _search_rows(size, 200 if brief else SEARCH_RAYS)
    page.table('speed_searches', SEARCH_HEADER, rows)


def _search_rows(size: int, many: int) -> list[list[Cell]]:
    rng = np.random.default_rng(4)
    boxes = uniform_boxes(size, rng)
    shifts = [rng.uniform(-1, 1, boxes.lo.shape) * boxes.edges for _ in range(ROUNDS)]
    places, rays = [boxes.moved(shift) for shift in shifts], incoherent_rays(many, rng)
    before, after = (DynamicBVH.from_boxes(*state) for state in (boxes, places[-1]))
    rows: list[list[Cell]] = []
    for search in ('greedy', 'branch_and_bound'):
        few = Boxes(boxes.lo[:9], boxes.hi[:9])
        _insert(DynamicBVH(sibling_search=search), few)  # compiles
        tree = DynamicBVH(capacity=size, sibling_search=search)
        inserted = seconds(partial(_insert, tree, boxes)) * 1e9 / size
        row: list[Cell] = [size, search, inserted, *_quality(tree, before, rays)]
        moving = seconds(partial(_move, tree, places)) * 1e9 / (size * ROUNDS)
        tree.validate()
        rows.append([*row, moving, *_quality(tree, after, rays)])
    build = alone(lambda: DynamicBVH.from_boxes(*boxes), size, SEARCH_REPEATS).nanoseconds
    both = _quality(before, before, rays), _quality(after, after, rays)
    return [*rows, [size, 'bulk build', build, *both[0], None, *both[1]]]


def _insert(tree: DynamicBVH, boxes: Boxes) -> None:
    """Row by row: so few at once that nothing is built anew."""
    count = len(boxes.lo)
    for lo, hi in zip(boxes.lo[:2], boxes.hi[:2], strict=True):
        tree.insert(lo, hi)
    while (done := len(tree)) < count:
        rows = slice(done, min(2 * done - 1, count))
        tree.insert_many(boxes.lo[rows], boxes.hi[rows])


def _move(tree: DynamicBVH, places: list[Boxes]) -> None:
    """Row by row, as for `_insert`."""
    handles = tree.ids()
    few = max(1, int(FEW * len(handles)))
    for boxes in places:
        for first in range(0, len(handles), few):
            rows = slice(first, first + few)
            tree.move_many(handles[rows], boxes.lo[rows], boxes.hi[rows])


def _quality(tree: DynamicBVH, built: DynamicBVH, rays: Rays) -> list[Cell]:
    """Cost over that of a bulk build, height, and time of a ray."""
    timing = alone(lambda: tree.raycast_many(*rays), len(rays.origins), SEARCH_REPEATS)
    return [tree.cost() / built.cost(), tree.height, timing.nanoseconds]


SECTIONS = {
    'Growth': growth,
    'Policies of move_many': policies,
    'Sibling searches': searches,
    'Cold start': cold_start,
    'Cold start of a node': kernels,
}
