# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""rtree: libspatialindex's R*-tree."""

from typing import Any

import numpy as np

from ..scenes import Boxes
from ..timing import Job
from .base import Library, Work

MOVES = 100  # boxes moved in one run: each takes a large part of a millisecond


class Rtree(Library):
    """The R*-tree in memory, bulk-loaded and asked in batches where it offers that."""

    name = 'rtree'
    module = 'rtree'
    note = (
        'R*-tree in memory, batch calls for build and queries; '
        f'a move is delete and insert, {MOVES} of them timed'
    )

    def _index(self, boxes: Boxes) -> Any:
        from rtree import index

        rows = np.arange(len(boxes.lo))
        properties = index.Property(dimension=3, variant=index.RT_Star)
        return index.Index((rows, *boxes), properties=properties, interleaved=True)

    def _move(self, work: Work, states: list[tuple[list[int], np.ndarray, np.ndarray]]) -> Job:
        """Take the rows of one state after the other from where they are to where they belong."""
        tree, turn = self._index(work.boxes), 0
        places = np.hstack(work.boxes)

        def run():
            nonlocal turn
            rows, lo, hi = states[turn % len(states)]
            turn += 1
            for row, place in zip(rows, np.hstack([lo, hi]), strict=True):
                tree.delete(row, places[row])
                tree.insert(row, place)
                places[row] = place

        return Job(run, len(states[0][0]))

    def move_all(self, work: Work) -> Job:
        """Move boxes a little."""
        rows = list(range(min(MOVES, len(work.boxes.lo))))
        return self._move(work, [(rows, s.lo[rows], s.hi[rows]) for s in reversed(work.states)])

    def move_some(self, work: Work) -> Job:
        """Move boxes far."""
        return self._move(
            work,
            [
                (j.rows[:MOVES].tolist(), j.boxes.lo[:MOVES], j.boxes.hi[:MOVES])
                for j in work.jumps
            ],
        )

    def build(self, work: Work) -> Job:
        """Build from arrays."""
        return Job(lambda: self._index(work.boxes), len(work.boxes.lo))

    def overlap(self, work: Work) -> Job:
        """Boxes that meet small boxes."""
        tree = self._index(work.boxes)
        return Job(
            lambda: tree.intersection_v(*work.small), len(work.small.lo), lambda r: len(r[0])
        )

    def nearest(self, work: Work) -> Job:
        """The nearest of many points."""
        centers = (work.boxes.lo + work.boxes.hi) / 2
        tree = self._index(Boxes(centers, centers))
        return Job(
            lambda: tree.nearest_v(work.points, work.points, strict=True, return_max_dists=True),
            len(work.points),
            lambda r: round(float(np.sum(r[2])) * 1e3),
        )
