# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles from an OccupancyGrid topic: few boxes, as occupied cells are merged to rectangles."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray

from bvh_ros.ros.conversions import nanoseconds, rotations
from bvh_ros.ros.conversions.placing import alike
from bvh_ros.ros.parameters import ConfigurationError
from bvh_ros.ros.sources.source import Applying, Source
from bvh_ros.scene import ShapeKind, Shapes

# An origin may be off the vertical by what rounding does to a quaternion, not by more.
MAX_TILT = 1e-6
BAND = 500_000  # cells that are looked at without a pause, in 10 ms


class OccupancyGridSource(Source):
    """Replaces its boxes with the occupied cells of each message, merged to rectangles."""

    message_type = OccupancyGrid
    depth = 1  # a map replaces the one before it
    follows_publisher = False

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        options = self.settings.options
        if options['z_min'] > options['z_max']:
            raise ConfigurationError(f"parameter '{self.name}.z_min' is above '{self.name}.z_max'")

    def apply(self, message: Any, now: int) -> Applying:
        """Replace all boxes."""
        self.is_whole = True
        options = self.settings.options
        shapes = yield from boxes(
            message,
            occupied_at=options['occupied_at'],
            unknown_occupied=options['unknown'] == 'occupied',
            z_min=options['z_min'],
            z_max=options['z_max'],
            most=self.scene.max_obstacles,
        )
        header = message.header
        given = header.frame_id, nanoseconds(header.stamp), now
        return (yield from self._replace_all(shapes, *given))


def boxes(
    grid: Any, *, occupied_at: int, unknown_occupied: bool, z_min: float, z_max: float, most: int
) -> Generator[None, None, Shapes]:
    """Return the occupied part of a grid as disjoint boxes along the origin's yaw.

    Parameters
    ----------
    occupied_at : int
        Cells at or above this value are occupied.
    unknown_occupied : bool
        Whether cells of value -1 are.
    z_min, z_max : float
        Vertical extent of the boxes above the grid's plane, m.
    most : int
        More boxes than this are refused, all of them.

    Yields
    ------
    None
        Now and then: a large grid takes long.

    Raises
    ------
    ValueError
        If size and data disagree, the resolution is not a length, the origin is tilted or there
        are too many boxes.
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

    def occupied(part: NDArray[np.int8]) -> NDArray[np.bool_]:
        cells = part >= occupied_at
        return cells | (part < 0) if unknown_occupied else cells

    found = yield from rectangles(cells.reshape(info.height, info.width), occupied, most)
    extent = found * float(info.resolution)
    low, high = extent[:, :2], extent[:, 2:]
    n = len(extent)
    middle = np.column_stack((0.5 * (low + high), np.full(n, 0.5 * (z_min + z_max))))
    return alike(
        ShapeKind.BOX,
        rotations.rotate(turn, middle) + at,
        np.tile(turn, (n, 1)),
        np.column_stack((high - low, np.full(n, z_max - z_min))),
    )


def rectangles(
    cells: NDArray[Any], occupied: Callable[[NDArray[Any]], NDArray[np.bool_]], most: int
) -> Generator[None, None, NDArray[np.int64]]:
    """Cover the occupied cells of a (rows, columns) grid exactly, by disjoint rectangles.

    Runs of cells along a row are merged with equal runs in the rows next to it; both directions
    are tried and the one that needs fewer rectangles is kept. Pauses now and then.

    Returns
    -------
    (n, 4) int64 array
        First column, first row, end column, end row (ends exclusive).

    Raises
    ------
    ValueError
        If there are more than `most`.
    """
    if not cells.size:  # however many rows or columns are announced
        return np.empty((0, 4), np.int64)
    along_rows = yield from _merged_runs(cells, occupied, most)
    enough = most if along_rows is None else len(along_rows) - 1
    along_columns = yield from _merged_runs(cells.T, occupied, enough)
    if along_columns is not None:
        return along_columns[:, (1, 0, 3, 2)]
    if along_rows is None:
        raise ValueError(f'the grid has more than {most} rectangles of occupied cells')
    return along_rows


def _merged_runs(
    cells: NDArray[Any], occupied: Callable[[NDArray[Any]], NDArray[np.bool_]], most: int
) -> Generator[None, None, NDArray[np.int64] | None]:
    """Rectangles of equal runs in consecutive rows; None if there are more than `most`."""
    done: list[NDArray[np.int64]] = []
    count, band = 0, max(BAND // cells.shape[1], 1)
    for first in range(0, len(cells), band):
        part = occupied(cells[first : first + band])
        runs = _merged_runs_of_band(part)
        runs[:, (1, 3)] += first
        if done:
            done[-1] = _without_continued(done[-1], runs, first)
            count += len(done[-1])
        done.append(runs)
        if count + len(runs) > most:
            return None
        yield
    return np.concatenate(done)


def _without_continued(
    before: NDArray[np.int64], runs: NDArray[np.int64], first: int
) -> NDArray[np.int64]:
    """Let rectangles that begin with row `first` begin where equal ones end; return the others of
    those before.
    """
    ends, begins = np.flatnonzero(before[:, 3] == first), np.flatnonzero(runs[:, 1] == first)
    # Both in order of their first columns, which are different.
    _, old, new = np.intersect1d(
        before[ends, 0], runs[begins, 0], assume_unique=True, return_indices=True
    )
    old, new = ends[old], begins[new]
    same = before[old, 2] == runs[new, 2]
    runs[new[same], 1] = before[old[same], 1]
    return np.delete(before, old[same], axis=0)


def _merged_runs_of_band(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    edges = np.diff(np.pad(mask, ((0, 0), (1, 1))).view(np.int8), axis=1)
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
    given = q.x, q.y, q.z, q.w
    x, y, z, w = rotations.normalised(given)
    if not (np.isfinite(at).all() and math.isfinite(x + y + z + w)):
        raise ValueError('the origin is not finite')
    if rotations.are_off(given):
        raise ValueError("the length of the origin's orientation is neither 1 nor 0")
    if math.hypot(x, y) > MAX_TILT:
        raise ValueError('the origin is tilted; a grid can only be turned about z')
    return at, rotations.normalised((0.0, 0.0, z, w))
