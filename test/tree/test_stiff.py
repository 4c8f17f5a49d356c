# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stiff in time: obstacles at 1e4 and at 1e-9 m/s in one scene, each kind updated at its own rate,
with some that teleport, come and go, over long runs.
"""

import pickle
import resource

import numpy as np
import pytest
from tree.reference import effort, overlapping_rows

from bvh_ros import DynamicBVH

TICK = 0.01  # s
EDGE = 1000.0  # m, of the cube where everything stays
# Speed in m/s, and every how many ticks it is updated.
KINDS = ((1e4, 1), (10.0, 2), (1e-3, 10), (1e-9, 50))
WORST_COST = 1.25  # of a new build of the same fat boxes
WORST_COST_PREDICTED = 1.5  # fast boxes are 100 m long then


class Traffic:
    """Boxes of all kinds in one tree.

    Parameters
    ----------
    each
        Boxes of a kind.
    predicted
        Whether moves tell where the box will be at its next update.
    """

    def __init__(self, each: int, margin: float, predicted: bool) -> None:
        self.rng = np.random.default_rng(each)
        count = each * len(KINDS)
        self.kind = np.repeat(np.arange(len(KINDS)), each)
        way = self.rng.normal(size=(count, 3))
        way /= np.linalg.norm(way, axis=1)[:, None]
        self.velocity = way * np.array([speed for speed, _ in KINDS])[self.kind][:, None]
        self.lo = self.rng.uniform(0, EDGE, (count, 3))
        self.size = self.rng.uniform(0.5, 5, (count, 3))
        self.tree = DynamicBVH(margin=margin)
        self.handles = self.tree.insert_many(self.lo, self.lo + self.size)
        self.predicted = predicted
        self.ticks = self.updates = 0

    def advance(self) -> None:
        """One tick: each kind that is due, a teleport, and now and then a box goes and comes."""
        self.ticks += 1
        due = np.array([self.ticks % every == 0 for _, every in KINDS])[self.kind]
        self._move(np.flatnonzero(due))
        row = int(self.rng.integers(len(self.lo)))
        self.lo[row] = self.rng.uniform(0, EDGE, 3)
        self.tree.move(self.handles[row], self.lo[row], self.lo[row] + self.size[row])
        self.updates += 1
        if self.ticks % 3 == 0:
            self._replace(int(self.rng.integers(len(self.lo))))

    def _move(self, rows: np.ndarray) -> None:
        rows = self.rng.permutation(rows)
        away = (self.lo[rows] < 0) & (self.velocity[rows] < 0)
        away |= (self.lo[rows] > EDGE) & (self.velocity[rows] > 0)
        self.velocity[rows] = np.where(away, -self.velocity[rows], self.velocity[rows])
        wait = TICK * np.array([every for _, every in KINDS])[self.kind[rows]][:, None]
        step = self.velocity[rows] * wait
        self.lo[rows] += step
        hi = self.lo[rows] + self.size[rows]
        ahead = step if self.predicted else None
        self.tree.move_many(self.handles[rows], self.lo[rows], hi, ahead)
        self.updates += len(rows)

    def _replace(self, row: int) -> None:
        self.tree.remove(self.handles[row])
        self.handles[row] = self.tree.insert(self.lo[row], self.lo[row] + self.size[row])
        self.updates += 2

    def check(self) -> None:
        """Structure, boxes, answers, height and cost."""
        self.tree.validate()
        lo, hi = self.tree.boxes(self.handles)
        assert np.array_equal(lo, self.lo)
        assert np.array_equal(hi, self.lo + self.size)
        assert self.tree.height <= 4 * np.log2(len(self.tree)) + 4
        worst = WORST_COST_PREDICTED if self.predicted else WORST_COST
        assert cost_over_new_build(self.tree) <= worst
        for low in self.rng.uniform(0, EDGE, (5, 3)):
            rows = overlapping_rows(lo, hi, low, low + 100)
            assert self.tree.overlap(low, low + 100).tolist() == sorted(self.handles[rows])


def cost_over_new_build(tree: DynamicBVH) -> float:
    """Cost over that of a new tree of the same fat boxes."""
    copy = pickle.loads(pickle.dumps(tree))
    copy.rebuild()
    return float(tree.cost() / copy.cost())


def peak_memory() -> int:
    """What this process has used at most so far, bytes."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@pytest.mark.parametrize('margin', [0.0, 0.05])
@pytest.mark.parametrize('predicted', [False, True])
def test_mixed_updates(margin: float, predicted: bool) -> None:
    """Sound, and as cheap and small as at first, after as many updates as one likes."""
    traffic = Traffic(250, margin, predicted)
    total = effort(60_000, 2_500_000)  # four forms of it: 10**7 in all
    for _ in range(20):
        traffic.advance()
    traffic.check()
    memory, size = peak_memory(), traffic.tree.stats()['bytes']
    for part in range(1, 11):
        while traffic.updates < total * part // 10:
            traffic.advance()
        traffic.check()
    assert traffic.updates >= total
    assert traffic.tree.stats()['bytes'] == size
    assert peak_memory() - memory < 16e6
