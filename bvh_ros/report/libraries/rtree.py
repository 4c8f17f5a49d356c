# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""rtree: libspatialindex's R*-tree."""

from typing import Any

import numpy as np

from ..scenes import Boxes
from ..timing import Job
from .base import Library, Work


class Rtree(Library):
    """The R*-tree in memory, bulk-loaded and asked in batches where it offers that."""

    name = 'rtree'
    module = 'rtree'
    note = 'R*-tree in memory, batch calls for build and queries'

    def _index(self, boxes: Boxes) -> Any:
        from rtree import index

        rows = np.arange(len(boxes.lo))
        properties = index.Property(dimension=3, variant=index.RT_Star)
        return index.Index((rows, *boxes), properties=properties, interleaved=True)

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
