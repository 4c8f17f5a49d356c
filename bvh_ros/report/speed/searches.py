# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Searches: greedy or branch and bound, with and without rotations, next to a bulk build.

The classic article leaves open what rotations are worth where, and claims that the greedy choice
is globally optimal.
"""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ... import DynamicBVH
from ..page import Page
from ..progress import Progress
from ..scenes import Boxes, Rays, incoherent_rays, moved, uniform_boxes
from ..tables import Cell, Table
from .full_sweep import full_sweep_cost
from .variants import ROTATIONS, greedy_excess, grow, reinsert

SIZES = (1_000, 10_000, 100_000)
SIZES_QUICK = (200,)
RAYS, ROUNDS = 20_000, 3
SEARCHES = ('greedy', 'branch_and_bound')
HEADER = (
    'boxes',
    'sibling search',
    'rotations',
    'ns a box, inserted',
    'cost / SAH',
    'height',
    'ns a ray',
    'ns a move',
    'cost / SAH, moved',
    'height, moved',
    'ns a ray, moved',
)


class Scene(NamedTuple):
    """Boxes, where they move to, and rays."""

    boxes: Boxes
    places: list[Boxes]
    rays: Rays
    rotations: tuple[str, ...]
    """Which of `ROTATIONS` to measure; each compiles kernels of its own."""


def steps(brief: bool) -> int:
    """How often the progress bar will move."""
    kinds, sizes = (ROTATIONS[-1:], SIZES_QUICK) if brief else (ROTATIONS, SIZES)
    return (len(SEARCHES) * len(kinds) + 1) * len(sizes)


def run(page: Page, progress: Progress, brief: bool) -> None:
    """Measure the trees, then the single choices."""
    rows, choices = [], []
    for size in SIZES_QUICK if brief else SIZES:
        progress.say(f'speed: searches, {size:,} boxes')
        scene = _scene(size, brief)
        rows += _rows(size, scene, progress)
        choices.append(_choices(size, scene.boxes))
    page.add('### Sibling searches and rotations')
    page.add(
        'Boxes inserted one by one in random order; then every box moved one edge at most, one by '
        'one, three times over. *cost / SAH*: cost of the tree over that of a bulk build of the '
        'same boxes. *full sweep*: SAH with every split of every axis tried; only its cost counts.'
    )
    page.table(Table('speed_searches', HEADER, rows))
    page.add(
        'How often the greedy choice of a sibling, with rotations on, is not the best one, and '
        'what it costs more then:'
    )
    header = ('boxes', 'not the best, share', 'costs more then, mean share', 'at most')
    page.table(Table('speed_greedy', header, choices))


def _scene(size: int, brief: bool) -> Scene:
    rng = np.random.default_rng(4)
    boxes = uniform_boxes(size, rng)
    edges = boxes.hi - boxes.lo
    places = [moved(boxes, rng.uniform(-1, 1, edges.shape) * edges) for _ in range(ROUNDS)]
    rays = incoherent_rays(200 if brief else RAYS, rng)
    return Scene(boxes, places, rays, ROTATIONS[-1:] if brief else ROTATIONS)


def _rows(size: int, scene: Scene, progress: Progress) -> list[list[Cell]]:
    rows: list[list[Cell]] = []
    before, after = DynamicBVH.from_boxes(*scene.boxes), DynamicBVH.from_boxes(*scene.places[-1])
    for search in SEARCHES:
        for rotations in scene.rotations:
            measured = _measure(scene, search, rotations, before.cost(), after.cost())
            rows.append([size, search, rotations, *measured])
            progress.step()
    build = _nanoseconds(lambda: DynamicBVH.from_boxes(*scene.boxes), size)
    row: list[Cell] = [size, 'bulk build', None]
    for tree in (before, after):
        row += [build, 1.0, tree.height, _ray_time(tree, scene.rays)]
    rows.append(row)
    costs = [full_sweep_cost(*boxes) for boxes in (scene.boxes, scene.places[-1])]
    shares = costs[0] / before.cost(), costs[1] / after.cost()
    rows.append(
        [size, 'full sweep', None, None, shares[0], None, None, None, shares[1], None, None]
    )
    progress.step()
    return rows


def _measure(scene: Scene, search: str, rotations: str, before: float, after: float) -> list[Cell]:
    few = Boxes(scene.boxes.lo[:50], scene.boxes.hi[:50])
    reinsert(grow(few, search, rotations), few, rotations)  # compiles
    start = time.perf_counter()
    tree = grow(scene.boxes, search, rotations)
    inserted = (time.perf_counter() - start) * 1e9 / len(scene.boxes.lo)
    row = [inserted, tree.cost() / before, tree.height, _ray_time(tree, scene.rays)]
    start = time.perf_counter()
    for place in scene.places:
        reinsert(tree, place, rotations)
    moved_in = (time.perf_counter() - start) * 1e9 / (len(scene.boxes.lo) * len(scene.places))
    tree.validate()
    return [*row, moved_in, tree.cost() / after, tree.height, _ray_time(tree, scene.rays)]


def _nanoseconds(run: Callable[[], object], units: int) -> float:
    run()  # a first batch takes the snapshot
    times = []
    for _ in range(3):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return sorted(times)[1] * 1e9 / units


def _ray_time(tree: DynamicBVH, rays: Rays) -> float:
    return _nanoseconds(lambda: tree.raycast_many(*rays), len(rays.origins))


def _choices(size: int, boxes: Boxes) -> list[Cell]:
    excess = greedy_excess(boxes)
    worse = excess[excess > 1e-9]
    return [
        size,
        len(worse) / size,
        float(worse.mean()) if len(worse) else 0.0,
        float(excess.max()),
    ]
