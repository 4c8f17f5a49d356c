# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Long and stiff runs: a million moves, speeds thirteen decades apart, teleports, margins and
predictions.
"""

import math
import pickle
from collections.abc import Iterable

import numpy as np

from ... import DynamicBVH
from ..scenes import Floats
from .case import Case

WORST_COST = 1.25  # of a new build
TICK = 0.01  # s


def motion_cases(brief: bool) -> Iterable[Case]:
    """All of them."""
    yield _many_moves(20_000 if brief else 1_000_000)
    for margin in (0.0, 0.05):
        for ahead in (False, True):
            yield _stiff(60 if brief else 1_000, margin, ahead)
    yield _teleports(20 if brief else 500)


def over_new_build(tree: DynamicBVH) -> float:
    """Cost of a tree over that of a new one of the same boxes, fat as they are."""
    copy = pickle.loads(pickle.dumps(tree))
    copy.rebuild()
    return float(tree.cost() / copy.cost())


def _bounds(tree: DynamicBVH) -> tuple[str, str, bool]:
    """What is promised of cost and height, what there is, and whether it is kept."""
    tree.validate()
    bound, cost = 4 * math.log2(len(tree)) + 4, over_new_build(tree)
    return (
        f'cost <= {WORST_COST} of a new build, height <= {bound:.1f}',
        f'cost {cost:.2f}, height {tree.height}',
        cost <= WORST_COST and tree.height <= bound,
    )


def _many_moves(total: int) -> Case:
    rng = np.random.default_rng(1)
    count, at_once = 2_000, 50
    lo = rng.uniform(0, 100, (count, 3))
    size = rng.uniform(0.5, 3, lo.shape)
    tree = DynamicBVH.from_boxes(lo, lo + size)
    handles, before = tree.ids(), tree.stats()['bytes']
    for _ in range(total // at_once):
        rows = rng.choice(count, at_once, replace=False)
        lo[rows] = rng.uniform(0, 100, (at_once, 3))
        tree.move_many(handles[rows], lo[rows], lo[rows] + size[rows])
    expected, got, kept = _bounds(tree)
    grown = tree.stats()['bytes'] - before
    right = np.array_equal(tree.boxes(handles)[0], lo)
    told = f'{expected}, 0 bytes more', f'{got}, {grown} bytes more', kept and grown == 0 and right
    return Case(f'{total:,} moves to anywhere', f'{count:,} boxes, {at_once} a call', *told)


def _wrong_boxes(tree: DynamicBVH, lo: Floats, hi: Floats, rng: np.random.Generator) -> int:
    """How many of the overlaps around some boxes differ from those by comparisons."""
    wrong, handles = 0, tree.ids()
    for row in rng.integers(0, len(lo), 10):
        low, high = lo[row] - 5, hi[row] + 5
        rows = np.flatnonzero(((lo <= high) & (low <= hi)).all(axis=1))
        wrong += tree.overlap(low, high).tolist() != handles[rows].tolist()
    return wrong


def _stiff(ticks: int, margin: float, ahead: bool) -> Case:
    """1e4 m/s at every tick, 1e-9 m/s at every twentieth."""
    rng = np.random.default_rng(2)
    count = 400
    lo = rng.uniform(0, 1000, (count, 3))
    way = rng.normal(size=lo.shape)
    way /= np.linalg.norm(way, axis=1)[:, None]
    fast = np.arange(count) % 2 == 0
    speed = way * np.where(fast, 1e4, 1e-9)[:, None]
    tree = DynamicBVH.from_boxes(lo, lo + 1, margin=margin)
    handles = tree.ids()
    wrong = 0
    for tick in range(ticks):
        rows = np.flatnonzero(fast if tick % 20 else fast | True)
        speed = np.where((lo < 0) & (speed < 0) | (lo > 1000) & (speed > 0), -speed, speed)
        lo[rows] += speed[rows] * np.where(fast[rows], TICK, 20 * TICK)[:, None]
        step = speed[rows] * TICK if ahead else None
        tree.move_many(handles[rows], lo[rows], lo[rows] + 1, step)
        if tick % 20 == 0:
            wrong += _wrong_boxes(tree, lo, lo + 1, rng)
    name = f'1e4 and 1e-9 m/s, margin {margin:g} m' + (', predicted' if ahead else '')
    return _judged(tree, name, f'{count} boxes, {ticks} ticks of {TICK} s', wrong)


def _teleports(times: int) -> Case:
    """One box goes 1e15 m away and comes back, again and again."""
    rng = np.random.default_rng(3)
    lo = rng.uniform(0, 100, (500, 3))
    tree = DynamicBVH.from_boxes(lo, lo + 1, margin=0.1)
    handles, home = tree.ids(), lo[0].copy()
    wrong = 0
    for _ in range(times):
        for place in (home + 1e15, home):
            lo[0] = place
            tree.move(handles[0], lo[0], lo[0] + 1)
            wrong += handles[0] not in tree.overlap(lo[0], lo[0])
    wrong += _wrong_boxes(tree, lo, lo + 1, rng)
    return _judged(tree, 'teleports by 1e15 m and back', f'500 boxes, {times} returns', wrong)


def _judged(tree: DynamicBVH, name: str, asked: str, wrong: int) -> Case:
    expected, got, kept = _bounds(tree)
    told = f'{expected}, 0 wrong overlaps', f'{got}, {wrong} wrong overlaps'
    return Case(name, asked, *told, kept and wrong == 0)
