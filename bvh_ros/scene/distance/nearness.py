# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which obstacles are nearest to a point, by their true shapes.

No shape is nearer than its box. So the tree is asked for the nearest boxes, ever more of them,
until the next box is farther than the k-th nearest shape among those it has named.
"""

import numpy as np

from ...tree.dynamic_bvh import DynamicBVH
from ...tree.nodes import SLOT_MASK
from ..geometry.shapes import Floats
from ..store.columns import Columns
from ..store.registry import Slots
from .overlaps import Touching, around, closest_footprint_points, closest_points

ROUNDED = 1.0 + 2.0**-48  # no computed distance is off by as much
MORE = 4


def nearest(
    tree: DynamicBVH,
    columns: Columns,
    any_shaped: bool,
    point: Floats,
    asked: tuple[int, float, int],
) -> Touching:
    """The obstacles nearest to a point, nearest first, ties by handle; asked for up to k within a
    distance with a mask.
    """
    k, max_distance, mask = asked
    count = min(k, len(tree) + 1)
    while True:
        ids, bounds = tree.nearest(
            point[: tree.ndim], count, max(max_distance * ROUNDED, max_distance), mask
        )
        slots = ids & SLOT_MASK
        if any_shaped:
            found = _measured(columns, slots, point)
        else:
            found = around(tree, slots, point, point[2])
        _, distances, points, normals = found
        order = np.lexsort((columns.node_handle[slots], distances))
        order = order[distances[order] <= max_distance]
        order = order[columns.different(slots[order])][:k]
        everything = len(ids) < count
        if everything or (len(order) == k and bounds[-1] > distances[order[-1]] * ROUNDED):
            return Touching(slots[order], distances[order], points[order], normals[order])
        count = min(count * MORE, len(tree) + 1)


def _measured(columns: Columns, slots: Slots, point: Floats) -> Touching:
    """How far obstacles of any shape are from a point; seen from above in a planar scene."""
    planar = columns.footprint is not None
    closest = closest_footprint_points if planar else closest_points
    points, distances, normals = closest(columns, slots, point)
    return Touching(slots, distances, points, normals)
