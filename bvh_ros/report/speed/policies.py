# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Policies: inserting again, refitting in place or building anew, by the share that moved."""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import cycle

import numpy as np
from numpy.typing import NDArray

from ... import DynamicBVH
from ...tree import dynamic_bvh
from ..page import Page
from ..scenes import Boxes, moved, spread, uniform_boxes
from ..tables import Table
from ..timing import Job, interleaved

BOXES, REPEATS = 10_000, 6
SHARES = (1 / 256, 1 / 128, 1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)
SHARES_QUICK = (1 / 8, 1.0)
# Shares from which on move_many refits, and builds anew; above 1 is never.
POLICIES = {'reinsert': (2.0, 2.0), 'refit': (0.0, 2.0), 'rebuild': (0.0, 0.0)}
CHOSEN = 'as chosen'
KINDS = ('nearby', 'anywhere')


def policies(page: Page, brief: bool) -> None:
    """Measure both kinds of movement."""
    size = 300 if brief else BOXES
    page.add('### Policies of move_many')
    page.add(
        f'{size:,} boxes; a share of them, others each time, moves nearby (up to one edge) or '
        f"anywhere. us a call; *cost* is the tree's cost after {REPEATS + 1} calls over that of a "
        f'new build. *refit* inserts those that move far again. `move_many` refits from a share '
        f'of {dynamic_bvh.REFIT_SHARE}, and builds anew if {dynamic_bvh.REBUILD_SHARE} move far.'
    )
    for kind in KINDS:
        rows = [_row(size, share, kind) for share in (SHARES_QUICK if brief else SHARES)]
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
        self._moves = cycle([self._move(boxes, kind, rng) for _ in range(REPEATS + 1)])

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


def _row(size: int, share: float, kind: str) -> list[float]:
    boxes = uniform_boxes(size, np.random.default_rng(3))
    movers = {name: Mover(boxes, share, kind, name) for name in (*POLICIES, CHOSEN)}
    jobs = {name: Job(mover.step, 1) for name, mover in movers.items()}
    times = interleaved(jobs, REPEATS)
    return [
        share,
        *(times[name].nanoseconds / 1e3 for name in movers),
        *(mover.worsened() for mover in movers.values()),
    ]
