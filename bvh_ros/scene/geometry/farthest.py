# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The vertex of a mesh that is farthest along a direction: of all of them, whatever they are.

Few are looked at one by one. Many are arranged so that neighbours follow each other, in LEAVES
groups; eight groups that follow each other are one of the level above. Each group lies in a disc,
a flat cylinder along its least extent. The search goes into the discs that reach farthest, and
leaves out those that reach no farther than the best vertex yet (branch and bound). So it ends at
the true maximum, where climbing from neighbour to neighbour ends on the first bump.

`discs` (blocks, 8 numbers, 8 lanes) holds eight groups a block: centre, unit axis, half height and
radius. Below lane k of block b is block 8 b + 1 + k, or a leaf. It is empty for few vertices.
"""

import math

import numpy as np
from numpy.typing import NDArray

from ...tree.compiler import lean_kernel, stack_array

Floats = NDArray[np.float64]

FEW = 64
LANES = 8
AXIS, HEIGHT, RADIUS, NUMBERS = 3, 6, 7, 8
ROOM = 96  # seven lanes wait on each of up to twelve levels
TIED = 2.0**-50  # of a mesh's radius: what rounds its vertices' heights


@lean_kernel
def farthest_vertex(hull, x, y, z):
    """Row of the vertex of a `hull.Hull` that is farthest along (x, y, z), up to rounding."""
    best, height, way = np.int64(0), -np.inf, (x, y, z)
    blocks, count = hull.discs.shape[0], hull.places.shape[0]
    if blocks == 0:
        return highest(hull.places, 0, count, way, best, height)[0]
    nodes, tops = stack_array(ROOM, np.int64), stack_array(ROOM, np.float64)
    leaves = (LANES - 1) * blocks + 1
    tied = TIED * hull.radius * max(abs(x), abs(y), abs(z))
    waiting = push_lanes(hull.discs, 0, way, -np.inf, nodes, tops, 0)
    while waiting > 0:
        waiting -= 1
        if tops[waiting] <= height + tied:
            continue
        block = nodes[waiting]
        if block < blocks:
            waiting = push_lanes(hull.discs, block, way, height + tied, nodes, tops, waiting)
            continue
        leaf = block - blocks
        first, stop = count * leaf // leaves, count * (leaf + 1) // leaves
        best, height = highest(hull.places, first, stop, way, best, height)
    return best


@lean_kernel
def highest(places, first, stop, way, best, height):
    """The same among some rows, if that is higher than `height`; and its height."""
    x, y, z = way
    for vertex in range(first, stop):
        here = x * places[vertex, 0] + y * places[vertex, 1] + z * places[vertex, 2]
        if here > height:
            best, height = np.int64(vertex), here
    return best, height


@lean_kernel
def push_lanes(discs, block, way, least, nodes, tops, waiting):
    """Put the groups of a block that reach above `least` along a way on the stack, the farthest
    last.
    """
    x, y, z = way
    disc, reach = discs[block], stack_array(LANES, np.float64)
    for k in range(LANES):
        a, b, c = disc[AXIS, k], disc[AXIS + 1, k], disc[AXIS + 2, k]
        u, v, w = y * c - z * b, z * a - x * c, x * b - y * a
        along = disc[HEIGHT, k] * abs(x * a + y * b + z * c)
        along += disc[RADIUS, k] * math.sqrt(u * u + v * v + w * w)
        reach[k] = x * disc[0, k] + y * disc[1, k] + z * disc[2, k] + along
    farthest, top = least, waiting
    for k in range(LANES):
        if reach[k] > least:
            nodes[top], tops[top] = LANES * block + 1 + k, reach[k]
            if reach[k] > farthest:
                farthest = reach[k]
            elif top > waiting:
                nodes[top], nodes[top - 1] = nodes[top - 1], nodes[top]
                tops[top], tops[top - 1] = tops[top - 1], tops[top]
            top += 1
    return top


def levels(count: int) -> int:
    """How many levels of groups so many vertices have."""
    return max(round(math.log(count / LANES, LANES)), 1) if count > FEW else 0


def _starts(count: int, groups: int) -> NDArray[np.int64]:
    starts: NDArray[np.int64] = count * np.arange(groups, dtype=np.int64) // groups
    return starts


def arranged(places: Floats) -> NDArray[np.int64]:
    """The rows of vertices (k, 3) so that neighbours follow each other: halves of halves, each cut
    across its longest side.
    """
    order = np.arange(len(places))
    for half in range(3 * levels(len(places))):
        starts = _starts(len(places), 1 << half)
        sides = np.maximum.reduceat(places[order], starts) - np.minimum.reduceat(
            places[order], starts
        )
        group = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(places)))
        order = order[np.lexsort((places[order, np.argmax(sides, axis=1)[group]], group))]
    return order


def discs(places: Floats) -> Floats:
    """What `farthest_vertex` needs, of arranged vertices (k, 3)."""
    found = [
        _around(places, _starts(len(places), LANES ** (level + 1)))
        for level in range(levels(len(places)))
    ]
    return np.concatenate([np.empty((0, NUMBERS, LANES)), *found])


def _around(places: Floats, starts: NDArray[np.int64]) -> Floats:
    """Discs (blocks, NUMBERS, LANES) around groups of vertices."""
    counts = np.diff(starts, append=len(places))
    group = np.repeat(np.arange(len(starts)), counts)
    middle = np.maximum.reduceat(places, starts) * 0.5 + np.minimum.reduceat(places, starts) * 0.5
    away = places - middle[group]
    spread = np.add.reduceat(away[:, :, None] * away[:, None, :], starts)
    centred = np.add.reduceat(away, starts)
    spread -= centred[:, :, None] * centred[:, None, :] / counts[:, None, None]
    axis = np.linalg.eigh(spread)[1][:, :, 0]
    heights = np.einsum('ni,ni->n', away, axis[group])
    high, low = np.maximum.reduceat(heights, starts), np.minimum.reduceat(heights, starts)
    across = np.linalg.norm(away - heights[:, None] * axis[group], axis=1)
    rows = np.empty((len(starts), NUMBERS))
    rows[:, :AXIS] = middle + (high * 0.5 + low * 0.5)[:, None] * axis
    rows[:, AXIS:HEIGHT] = axis
    rows[:, HEIGHT], rows[:, RADIUS] = (
        high * 0.5 - low * 0.5,
        np.maximum.reduceat(across, starts),
    )
    return np.ascontiguousarray(rows.reshape(-1, LANES, NUMBERS).transpose(0, 2, 1))
