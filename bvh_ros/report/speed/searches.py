# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Searches: greedy or branch and bound, next to a bulk build.

The classic article claims that the greedy choice is globally optimal.
"""

import time
from typing import NamedTuple

import numpy as np

from ... import DynamicBVH
from ..page import Page
from ..scenes import Boxes, Rays, incoherent_rays, moved, uniform_boxes
from ..tables import Cell, Table
from ..timing import Job, interleaved

SIZES, SIZES_QUICK = (1_000, 10_000, 100_000), (200,)
RAYS, ROUNDS, REPEATS = 20_000, 3, 3
FEW = 0.04  # of the boxes at once: move_many inserts those again one by one
HEADER = (
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
    rows = [row for size in (SIZES_QUICK if brief else SIZES) for row in _rows(size, brief)]
    page.add('### Sibling searches')
    page.add(
        'Boxes inserted one by one in random order; then every box moved one edge at most, one by '
        'one, three times over. *cost / SAH*: cost of the tree over that of a bulk build of the '
        'same boxes.'
    )
    page.table(Table('speed_searches', HEADER, rows))


def _plan(size: int, brief: bool) -> Plan:
    rng = np.random.default_rng(4)
    boxes = uniform_boxes(size, rng)
    edges = boxes.hi - boxes.lo
    places = [moved(boxes, rng.uniform(-1, 1, edges.shape) * edges) for _ in range(ROUNDS)]
    return Plan(boxes, places, incoherent_rays(200 if brief else RAYS, rng))


def _rows(size: int, brief: bool) -> list[list[Cell]]:
    plan = _plan(size, brief)
    before, after = (DynamicBVH.from_boxes(*boxes) for boxes in (plan.boxes, plan.places[-1]))
    rows: list[list[Cell]] = []
    for search in ('greedy', 'branch_and_bound'):
        rows.append([size, search, *_grown(plan, search, before.cost(), after.cost())])
    build = interleaved({'': Job(lambda: DynamicBVH.from_boxes(*plan.boxes), size)}, REPEATS)['']
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
    return interleaved({'': job}, REPEATS)[''].nanoseconds
