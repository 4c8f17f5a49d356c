# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The convex polygon around points in the plane."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

DIRECTIONS = 32  # first guess of a polygon: what is farthest along each of so many


def convex_polygon(points: Floats) -> Floats:
    """Corners (k, 2), counter-clockwise, of the convex hull of points (n, 2) that span an area."""
    points = points[_candidates(points)]
    order = np.lexsort((points[:, 1], points[:, 0]))
    places = points[order].tolist()
    lower, upper = _chain(places), _chain(places[::-1])
    return np.array(lower[:-1] + upper[:-1])


def _candidates(points: Floats) -> NDArray[np.bool_]:
    """Which points are not strictly within the polygon of those that are farthest along some
    directions.
    """
    angle = np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS)
    ways = np.column_stack((np.cos(angle), np.sin(angle)))
    rim = points[np.argmax(ways @ points.T, axis=1)]
    step = np.roll(rim, -1, axis=0) - rim
    outside = np.zeros(len(points), np.bool_)
    for (x, y), (along_x, along_y) in zip(rim.tolist(), step.tolist(), strict=True):
        if along_x or along_y:
            outside |= along_x * (points[:, 1] - y) <= along_y * (points[:, 0] - x)
    return outside


def _chain(places: list[list[float]]) -> list[list[float]]:
    """Half of the rim, along sorted points, turning left only (Andrew's monotone chain, 1979)."""
    chain: list[list[float]] = []
    for x, y in places:
        while len(chain) > 1:
            (a, b), (c, d) = chain[-2], chain[-1]
            if (c - a) * (y - b) > (d - b) * (x - a):
                break
            chain.pop()
        chain.append([x, y])
    return chain
