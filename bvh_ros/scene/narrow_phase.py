# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Turned boxes against boxes by python-fcl, which is imported when the first such pair comes."""

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .box_query import BoxQuery
from .shapes import Floats


def loaded() -> bool:
    """Whether python-fcl has been imported."""
    return 'fcl' in sys.modules


def boxes_within(records: NDArray[np.void], query: BoxQuery) -> NDArray[np.bool_]:
    """Whether boxes (records of `columns.GEOMETRY`) are within the query's tolerance of its box;
    touching counts.
    """
    near = np.zeros(len(records), np.bool_)
    if not len(records):
        return near
    import fcl

    # Seen from the query: far from the origin of the world differences keep their digits.
    other = _solid(np.zeros(3), query.orientation, query.half)
    for i, record in enumerate(records):
        one = _solid(record['position'] - query.centre, record['orientation'], record['half'])
        near[i] = fcl.collide(one, other) > 0
        if not near[i] and query.tolerance > 0.0:
            near[i] = fcl.distance(one, other) <= query.tolerance
    return near


def _solid(position: Floats, orientation: Floats, half: Floats) -> Any:
    """A box of python-fcl."""
    import fcl

    x, y, z, w = orientation.tolist()
    placed = fcl.Transform(np.array([w, x, y, z]), position)
    return fcl.CollisionObject(fcl.Box(*(2.0 * half).tolist()), placed)
