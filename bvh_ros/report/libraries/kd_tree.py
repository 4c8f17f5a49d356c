# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""scipy's cKDTree: points only."""

from ..timing import Job
from .base import Library, Work
from .ours import rounded


class KdTree(Library):
    """The static k-d tree that most Python users would take for nearest points."""

    name = 'scipy cKDTree'
    module = 'scipy'
    note = 'points only, one thread'

    def build(self, work: Work) -> Job:
        """Build over the centres."""
        from scipy.spatial import cKDTree

        centers = (work.boxes.lo + work.boxes.hi) / 2
        return Job(lambda: cKDTree(centers), len(centers), lambda tree: tree.n)

    def nearest(self, work: Work) -> Job:
        """The nearest of many points."""
        from scipy.spatial import cKDTree

        tree = cKDTree((work.boxes.lo + work.boxes.hi) / 2)
        return Job(lambda: tree.query(work.points), len(work.points), lambda r: rounded(r[0]))
