# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Footprints: shapes seen from above, for planar scenes.

A box casts a zonogon, the sum of three segments (its half axes seen from above): a rectangle if it
stands upright, else up to six corners. A ball casts a disc; a capsule a disc drawn along a
segment; a cylinder that stands a disc, one that lies a rectangle, and one that leans an oval: an
ellipse (its disc seen from above) drawn along a segment (its axis seen from above). A mesh casts a
polygon, which is kept with the meshes.

           ____                 ________
          /    \\              (        )
         /     /     zonogon   (   ->   )   oval: along ->, half length of the straight part,
         \\____/                 (______)          and the half axes of the ellipse
"""

import numpy as np
from numpy.typing import NDArray

from .shapes import Floats, ShapeKind, Shapes, rotations

# A zonogon is kept by its corners, counter-clockwise (some may coincide). A disc is a point grown
# by `radius`. All relative to `centre`.
FOOTPRINT = np.dtype(
    [
        ('centre', np.float64, (2,)),
        ('corners', np.float64, (6, 2)),
        ('radius', np.float64),
        ('along', np.float64, (2,)),
        ('straight', np.float64),
        ('half_axes', np.float64, (2,)),  # of the ellipse: along, across
        ('largest', np.float64),  # half size that has a part in the footprint
        ('oval', np.bool_),
        ('shaped', np.bool_),
        ('polygon', np.int32),  # of a mesh: 1 + its number in the store; else 0
    ],
    align=True,
)


def footprints(shapes: Shapes, shaped: NDArray[np.bool_]) -> NDArray[np.void]:
    """Footprints of canonical shapes, shape (n,).

    Axis-aligned boxes are left to the tree's own box.
    """
    footprints = np.zeros(len(shapes.kind), FOOTPRINT)
    footprints['shaped'] = shaped
    rows = np.flatnonzero(shaped)
    if not len(rows):
        return footprints
    half = shapes.size[rows] * 0.5
    kind = shapes.kind[rows]
    matrices = rotations(shapes.orientation[rows])
    generators = np.moveaxis(matrices[:, :2, :] * half[:, None, :], 2, 1)  # (n, 3 axes, 2)
    some = footprints[rows]
    some['centre'] = shapes.position[rows, :2]
    upright = ~shapes.orientation[rows, :2].any(axis=1)
    some['largest'] = np.where(upright, half[:, :2].max(axis=1), half.max(axis=1))
    sphere, cylinder = kind == ShapeKind.SPHERE, kind == ShapeKind.CYLINDER
    axis = matrices[:, :, 2]
    slope = np.hypot(axis[:, 0], axis[:, 1])
    standing, lying = cylinder & (slope == 0.0), cylinder & (axis[:, 2] == 0.0)
    capsule = kind == ShapeKind.CAPSULE
    generators[sphere | standing] = 0.0
    generators[capsule, :2] = 0.0
    generators[capsule, 2] = axis[capsule, :2] * (half[capsule, 2:] - half[capsule, :1])
    some['radius'] = np.where(sphere | standing | capsule, half[:, 0], 0.0)
    flat = np.flatnonzero(lying)
    across = np.stack([-axis[flat, 1], axis[flat, 0]], axis=1)
    generators[flat, 0], generators[flat, 1] = across * half[flat, :1], 0.0
    some['oval'] = cylinder & ~standing & ~lying
    leaning = np.flatnonzero(some['oval'])
    some['along'][leaning] = axis[leaning, :2] / slope[leaning, None]
    some['straight'] = half[:, 2] * slope
    some['half_axes'][:, 0] = half[:, 0] * np.abs(axis[:, 2])
    some['half_axes'][:, 1] = half[:, 0]
    some['corners'] = zonogon(generators)
    footprints[rows] = some
    return footprints


def zonogon(generators: Floats) -> Floats:
    """Corners (n, 6, 2), counter-clockwise, of sums of three segments from -g to g, (n, 3, 2)."""
    # All into the upper half plane and by angle: walking along twice each is one half of the rim.
    down = (generators[:, :, 1] < 0) | ((generators[:, :, 1] == 0) & (generators[:, :, 0] < 0))
    upper = np.where(down[:, :, None], -generators, generators)
    angle = np.arctan2(upper[:, :, 1], upper[:, :, 0])
    upper = np.take_along_axis(upper, np.argsort(angle, axis=1)[:, :, None], axis=1)
    first = upper.sum(axis=1, keepdims=True)
    right = np.concatenate([-first, 2 * np.cumsum(upper[:, :2], axis=1) - first], axis=1)
    return np.concatenate([right, -right], axis=1)
