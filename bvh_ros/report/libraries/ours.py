# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""This package."""

import numpy as np

from ... import DynamicBVH, RayHits
from ..scenes import Floats
from ..timing import Job
from .base import Library, Work


def _hits(result: RayHits) -> int:
    return int(np.count_nonzero(result.ids >= 0))


class Ours(Library):
    """DynamicBVH, float64, exact decisions."""

    name = 'bvh_ros'
    module = 'bvh_ros'
    note = 'batch calls, float64, exact decisions; a cast returns id, distance and normal'

    def cast(self, work: Work) -> Job:
        """First hits."""
        tree = DynamicBVH.from_boxes(*work.boxes)
        return Job(lambda: tree.raycast_many(*work.rays), len(work.rays.origins), _hits)

    def frame(self, work: Work) -> Job:
        """Move all, then cast."""
        tree, states = DynamicBVH.from_boxes(*work.boxes), work.moving()
        ids = tree.ids()

        def run():
            tree.move_many(ids, *next(states))
            return tree.raycast_many(*work.rays)

        return Job(run, 1, _hits)

    def move_all(self, work: Work) -> Job:
        """Move every box a little."""
        tree, states = DynamicBVH.from_boxes(*work.boxes), work.moving()
        ids = tree.ids()
        return Job(lambda: tree.move_many(ids, *next(states)), len(ids))

    def move_some(self, work: Work) -> Job:
        """Move few boxes far."""
        tree, jumps = DynamicBVH.from_boxes(*work.boxes), work.jumping()
        ids = tree.ids()

        def run():
            jump = next(jumps)
            tree.move_many(ids[jump.rows], *jump.boxes)

        return Job(run, len(work.jumps[0].rows))

    def build(self, work: Work) -> Job:
        """Build from nothing."""
        return Job(lambda: DynamicBVH.from_boxes(*work.boxes), len(work.boxes.lo), len)

    def overlap(self, work: Work) -> Job:
        """Boxes that meet small boxes."""
        tree = DynamicBVH.from_boxes(*work.boxes)
        return Job(lambda: tree.overlap_many(*work.small), len(work.small.lo), lambda r: len(r[1]))

    def pairs(self, work: Work) -> Job:
        """All pairs of boxes that meet."""
        tree = DynamicBVH.from_boxes(*work.boxes)
        return Job(tree.overlap_pairs, len(tree), len)

    def nearest(self, work: Work) -> Job:
        """The nearest of many points; a point is a box without extent."""
        centers = (work.boxes.lo + work.boxes.hi) / 2
        tree = DynamicBVH.from_boxes(centers, centers)
        points = work.points
        return Job(lambda: tree.nearest_many(points), len(points), lambda r: rounded(r[1]))


def rounded(distances: Floats) -> int:
    """Sum of the distances in mm: equal only if the same points were found."""
    return round(float(np.sum(distances)) * 1e3)
