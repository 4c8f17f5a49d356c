# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Box against shape by python-fcl, which is imported when the first such pair comes."""

import sys
from typing import Any

import numpy as np

from .shapes import Floats, ShapeKind


def loaded() -> bool:
    """Whether python-fcl has been imported."""
    return 'fcl' in sys.modules


def _geometry(kind: int, half: Floats) -> Any:
    import fcl

    size = (2.0 * half).tolist()
    if kind == ShapeKind.SPHERE:
        return fcl.Sphere(half[0])
    return fcl.Cylinder(half[0], size[2]) if kind == ShapeKind.CYLINDER else fcl.Box(*size)


def solid(kind: int, position: Floats, orientation: Floats, half: Floats) -> Any:
    """A collision object of python-fcl."""
    import fcl

    x, y, z, w = orientation.tolist()
    return fcl.CollisionObject(
        _geometry(kind, half), fcl.Transform(np.array([w, x, y, z]), position)
    )


def within(one: Any, other: Any, distance: float) -> bool:
    """Whether two solids are at most `distance` apart; touching counts."""
    import fcl

    if fcl.collide(one, other) > 0:
        return True
    return distance > 0.0 and fcl.distance(one, other) <= distance
