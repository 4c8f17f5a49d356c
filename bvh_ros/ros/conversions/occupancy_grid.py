# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An OccupancyGrid as few boxes: occupied cells merged to rectangles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.conversions import rotations
from bvh_ros.scene import ShapeKind, Shapes

# An origin may be off the vertical by what rounding does to a quaternion, not by more.
MAX_TILT = 1e-6


def boxes(
    grid: Any, *, occupied_at: int, unknown_occupied: bool, z_min: float, z_max: float
) -> Shapes:
    """Return the occupied part of a grid as disjoint boxes along the origin's yaw.

    Parameters
    ----------
    grid : nav_msgs/OccupancyGrid
    occupied_at : int
        Cells at or above this value are occupied.
    unknown_occupied : bool
        Whether cells of value -1 are.
    z_min, z_max : float
        Vertical extent of the boxes above the grid's plane, m.

    Raises
    ------
    ValueError
        If size and data disagree, the resolution is not a length or the origin is tilted.
    """
    info = grid.info
    cells = np.asarray(grid.data, dtype=np.int8)
    if len(cells) != info.width * info.height:
        raise ValueError(
            f'data has {len(cells)} cells, width * height = {info.width} * {info.height} '
            f'promises {info.width * info.height}'
        )
    if not (math.isfinite(info.resolution) and info.resolution > 0.0):
        raise ValueError(f'resolution {info.resolution} is not a length')
    at, turn = _origin(info.origin)
    cells = cells.reshape(info.height, info.width)
    occupied = cells >= occupied_at
    if unknown_occupied:
        occupied |= cells < 0
    extent = rectangles(occupied) * float(info.resolution)
    low, high = extent[:, :2], extent[:, 2:]
    n = len(extent)
    middle = np.column_stack((0.5 * (low + high), np.full(n, 0.5 * (z_min + z_max))))
    return Shapes(
        np.full(n, ShapeKind.BOX, dtype=np.uint8),
        rotations.rotate(turn, middle) + at,
        np.tile(turn, (n, 1)),
        np.column_stack((high - low, np.full(n, z_max - z_min))),
    )


def rectangles(occupied: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Cover the true cells of a (rows, columns) mask exactly, by disjoint rectangles.

    Runs of cells along a row are merged with equal runs in the rows next to it; both directions
    are tried and the one that needs fewer rectangles is kept.

    Returns
    -------
    (n, 4) int64 array
        First column, first row, end column, end row (ends exclusive).
    """
    along_rows = _merged_runs(occupied)
    along_columns = _merged_runs(occupied.T)
    if len(along_rows) <= len(along_columns):
        return along_rows
    return along_columns[:, (1, 0, 3, 2)]


def _merged_runs(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    edges = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, start = np.nonzero(edges == 1)
    end = np.nonzero(edges == -1)[1]
    # Equal runs of consecutive rows become neighbours, and a rectangle ends where they stop.
    order = np.lexsort((row, end, start))
    row, start, end = row[order], start[order], end[order]
    begins = np.ones(len(row), dtype=bool)
    begins[1:] = (np.diff(start) != 0) | (np.diff(end) != 0) | (np.diff(row) != 1)
    first = np.flatnonzero(begins)
    last = np.append(first[1:], len(row)) - 1 if len(first) else first
    return np.column_stack((start[first], row[first], end[first], row[last] + 1)).astype(np.int64)


def _origin(pose: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return position and yaw rotation of the grid's origin."""
    at = np.array((pose.position.x, pose.position.y, pose.position.z))
    q = pose.orientation
    x, y, z, w = rotations.normalised((q.x, q.y, q.z, q.w))
    if not (np.isfinite(at).all() and math.isfinite(x + y + z + w)):
        raise ValueError('the origin is not finite')
    if math.hypot(x, y) > MAX_TILT:
        raise ValueError('the origin is tilted; a grid can only be turned about z')
    return at, rotations.normalised((0.0, 0.0, z, w))
