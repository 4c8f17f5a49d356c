# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The gap of two shapes as the widest gap between two parallel planes: it needs no simplex and no
closed form of a distance.
"""

import numpy as np
from scene.reference import geometry_arrays

SAMPLES = 20_000
WINDOW = 0.25  # of the search about the best sample, on the plane that touches the sphere there
GRID, ROUNDS = 17, 17  # each round leaves an eighth of the window: 1e-16 in the end


def widest_gap(pair, rng):
    """Gap of two shapes, m: the widest between parallel planes, one on each.

    Where they are apart it has one maximum over the normals, on any plane through which these
    are drawn: the best sample is bettered by a search in a search. Where they overlap it is minus
    the depth, roughly. Never more than the truth, apart from rounding.
    """
    pair = geometry_arrays(pair)
    ways = rng.normal(size=(SAMPLES, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    best = ways[_gaps(pair, ways).argmax()]
    tangents = np.linalg.svd(best[None])[2][1:]
    middle, wide = 0.0, WINDOW
    for _ in range(ROUNDS):
        places = middle + wide * np.linspace(-1.0, 1.0, GRID)
        gaps = _widest_across(pair, best + places[:, None] * tangents[0], tangents[1])
        middle, wide = places[gaps.argmax()], wide * 2 / (GRID - 1)
    return float(gaps.max())


def _widest_across(pair, starts, tangent):
    """For each of GRID normals the widest gap along `tangent` from there."""
    rows, middle, wide = np.arange(GRID), np.zeros(GRID), WINDOW
    for _ in range(ROUNDS):
        places = middle[:, None] + wide * np.linspace(-1.0, 1.0, GRID)
        ways = (starts[:, None] + places[:, :, None] * tangent).reshape(-1, 3)
        ways /= np.linalg.norm(ways, axis=1)[:, None]
        gaps = _gaps(pair, ways).reshape(GRID, GRID)
        best = gaps.argmax(axis=1)
        middle, wide = places[rows, best], wide * 2 / (GRID - 1)
    return gaps[rows, best]


def _gaps(pair, ways):
    """How far planes with these unit normals keep the two apart."""
    one, other = pair
    return ways @ (other.position - one.position) - one.reach(ways) - other.reach(ways)
