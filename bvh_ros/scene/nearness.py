# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which obstacles are nearest to a point, by their true shapes.

No shape is nearer than its box. So the tree is asked for the nearest boxes, ever more of them,
until the next box is farther than the k-th nearest shape among those it has named.
"""

import numpy as np

from ..tree.dynamic_bvh import DynamicBVH
from ..tree.nodes import SLOT_MASK
from .columns import Columns
from .overlaps import Touching, closest_footprint_points, closest_points, lengths
from .registry import Slots
from .shapes import Floats

ROUNDED = 1.0 + 2.0**-48  # no computed distance is off by as much
MORE = 4


def nearest(
    tree: DynamicBVH, columns: Columns, point: Floats, k: int, max_distance: float, mask: int
) -> Touching:
    """The up to k nearest obstacles within `max_distance`, nearest first, ties by handle."""
    asked = k
    while True:
        ids, bounds = tree.nearest(
            point[: tree.ndim], asked, max(max_distance * ROUNDED, max_distance), mask
        )
        found = _measured(columns, ids & SLOT_MASK, point)
        slots, distances, points, normals = found
        order = np.lexsort((columns.node_handle[slots], distances))
        order = order[distances[order] <= max_distance][:k]
        everything = len(ids) < asked
        if everything or (len(order) == k and bounds[-1] > distances[order[-1]] * ROUNDED):
            return Touching(slots[order], distances[order], points[order], normals[order])
        asked = min(asked * MORE, len(tree) + 1)


def _measured(columns: Columns, slots: Slots, point: Floats) -> Touching:
    """How far obstacles are from a point; seen from above in a planar scene."""
    planar = columns.footprint is not None
    closest = closest_footprint_points if planar else closest_points
    points = closest(columns.geometry[slots], columns.meshes, point)
    offsets = point - points
    distances = lengths(offsets)
    normals = offsets / np.where(distances > 0.0, distances, 1.0)[:, None]
    return Touching(slots, distances, points, normals)
