# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The vertex of a convex mesh that is farthest along a direction.

Few are looked at one by one. On a mesh of many one climbs along edges, always to the neighbour
that is farthest: on a convex surface what no neighbour surpasses, nothing does. It starts at the
vertex that is farthest along the middle of the cell that the direction is in, where the six sides
of a cube are cut into CELLS x CELLS cells each, so that the way is short.

`links` (int32) holds the start of each cell; then for each vertex where its neighbours begin in
`links`, and where those of the last end; then the neighbours. It is empty for few vertices.
"""

import numpy as np
from numpy.typing import NDArray

from ..tree.compiling import lean_kernel

FEW = 64
CELLS = 4
STARTS = 6 * CELLS * CELLS


@lean_kernel
def cell_of(x, y, z):
    """Number of the cell that a direction is in; zero counts as some direction."""
    far, one, other, side = x, y, z, 0
    if abs(y) > abs(far):
        far, one, other, side = y, z, x, 2
    if abs(z) > abs(far):
        far, one, other, side = z, x, y, 4
    if far == 0.0:
        return 0
    if far < 0.0:
        side += 1
    row = min(int((one / abs(far) + 1.0) * (0.5 * CELLS)), CELLS - 1)
    column = min(int((other / abs(far) + 1.0) * (0.5 * CELLS)), CELLS - 1)
    return (side * CELLS + row) * CELLS + column


@lean_kernel
def farthest_vertex(places, links, x, y, z):
    """Row of the vertex that is farthest along (x, y, z)."""
    if links.shape[0] > 0:
        return climb(places, links, x, y, z)
    best, height = np.int64(0), -np.inf
    for vertex in range(places.shape[0]):
        here = x * places[vertex, 0] + y * places[vertex, 1] + z * places[vertex, 2]
        if here > height:
            best, height = np.int64(vertex), here
    return best


@lean_kernel
def climb(places, links, x, y, z):
    best, stands = np.int64(links[cell_of(x, y, z)]), np.int64(-1)
    height = x * places[best, 0] + y * places[best, 1] + z * places[best, 2]
    while stands != best:
        stands = best
        for link in range(links[STARTS + stands], links[STARTS + stands + 1]):
            vertex = np.int64(links[link])
            here = x * places[vertex, 0] + y * places[vertex, 1] + z * places[vertex, 2]
            if here > height:
                best, height = vertex, here
    return best


def _middles() -> NDArray[np.float64]:
    """Directions (STARTS, 3) in the order of `cell_of`."""
    steps = (np.arange(CELLS) + 0.5) / (0.5 * CELLS) - 1.0
    ways = np.empty((3, 2, CELLS, CELLS, 3))
    for axis in range(3):
        for sign in range(2):
            ways[axis, sign, :, :, axis] = 1.0 - 2.0 * sign
            ways[axis, sign, :, :, (axis + 1) % 3] = steps[:, None]
            ways[axis, sign, :, :, (axis + 2) % 3] = steps[None, :]
    return ways.reshape(STARTS, 3)


def links(places: NDArray[np.float64], edges: NDArray[np.int32]) -> NDArray[np.int32]:
    """What `farthest_vertex` climbs by, from vertices (k, 3) and the ends of edges (e, 2)."""
    if len(places) <= FEW:
        return np.empty(0, np.int32)
    starts = [int(np.argmax(places @ way)) for way in _middles()]
    here = np.concatenate([edges[:, 0], edges[:, 1]])
    there = np.concatenate([edges[:, 1], edges[:, 0]])
    order = np.argsort(here, kind='stable')
    begins = np.searchsorted(here[order], np.arange(len(places) + 1))
    begins += STARTS + len(begins)
    return np.concatenate([starts, begins, there[order]]).astype(np.int32)
