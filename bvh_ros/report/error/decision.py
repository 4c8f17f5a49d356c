# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What exactness costs: the tree with and without it, and how often rounding could not tell."""

from functools import partial

import numpy as np

from ... import DynamicBVH
from ..page import Page
from ..progress import Progress
from ..scenes import Boxes, Rays, incoherent_rays, uniform_boxes
from ..tables import Table
from ..timing import Job, interleaved
from . import plain
from .box_scenes import corner_rays
from .ways import rounded_answer, tree_answer

REPEATS, REPEATS_QUICK = 41, 2
SIZES, SIZES_QUICK = (1_000, 10_000, 100_000), (200,)
HEADER = (
    'scene',
    'boxes',
    'batch: ns a ray',
    'without exact decisions',
    'cost, %',
    'binary tree: ns a ray',
    'without exact decisions',
    'cost, %',
    'exact in a batch, % of rays',
    'exact in the binary tree, %',
)


def steps(brief: bool) -> int:
    """How often the progress bar will move."""
    return (REPEATS_QUICK if brief else REPEATS) * (1 + len(SIZES_QUICK if brief else SIZES))


def exact_decisions(page: Page, progress: Progress, brief: bool) -> None:
    """Cost and need, on random and on adversarial rays."""
    page.add('### What exactness costs')
    page.add(
        '*Without exact decisions*: the same kernels, compiled with a rounded slab test at the '
        'leaves. *Exact*: rays for which at least one comparison was so close that a sum of '
        'products was computed without rounding.'
    )
    rows = []
    for size in SIZES_QUICK if brief else SIZES:
        rng = np.random.default_rng(size)
        boxes, rays = uniform_boxes(size, rng), incoherent_rays(200 if brief else 20_000, rng)
        rows.append(_row('random', boxes, rays, progress, brief))
    boxes, rays = corner_rays(2_000, 200 if brief else 20_000, np.random.default_rng(2))
    rows.append(_row('adversarial', boxes, rays, progress, brief))
    page.table(Table('error_decision', HEADER, rows))


def _row(
    name: str, boxes: Boxes, rays: Rays, progress: Progress, brief: bool
) -> list[str | int | float]:
    progress.say(f'error: cost of exactness, {name}')
    tree, binary = DynamicBVH.from_boxes(*boxes), plain.BinaryTree.from_boxes(*boxes)
    count = len(rays.origins)
    repeats = REPEATS_QUICK if brief else REPEATS
    # Two at a time, on one tree: so neither finds the caches as another tree has left them.
    times: list[float] = []
    for one, tick in ((tree, progress.step), (binary, lambda: None)):
        jobs = {
            'exact': Job(partial(tree_answer, one, rays), count),
            'plain': Job(partial(rounded_answer, one, rays), count),
        }
        found = interleaved(jobs, repeats, tick, warm=True)
        times += [found[job].nanoseconds for job in jobs]
    costs = [100 * (times[k] / times[k + 1] - 1) for k in (0, 2)]
    shares = [100 * exact_share(one, rays) for one in (tree, binary)]
    return [name, len(boxes.lo), *times[:2], costs[0], *times[2:], costs[1], *shares]


def exact_share(tree: DynamicBVH, rays: Rays) -> float:
    """Share of the rays of a batch that took exact arithmetic."""
    before = tree.stats()['rays_decided_exactly']
    tree_answer(tree, rays)
    return float(tree.stats()['rays_decided_exactly'] - before) / len(rays.origins)
