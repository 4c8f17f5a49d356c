# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the node draws for RViz on `~/scene`, `~/tree` and `~/queries`, read back as arrays."""

from __future__ import annotations

import numpy as np
from visualization_msgs.msg import Marker

from bvh_ros.ros.cdr import marker_array
from bvh_ros.ros.conversions import rotations
from bvh_ros.ros.conversions.marker_table import MarkerTable
from bvh_ros.ros.conversions.outlines import TRIANGLES
from bvh_ros.scene import ShapeKind, Shapes
from bvh_ros.view.worlds import NO_POINTS, Floats, Integers

NO_BOXES = (NO_POINTS, NO_POINTS, np.empty(0, np.int64))
LISTS = {Marker.CUBE_LIST: ShapeKind.BOX, Marker.SPHERE_LIST: ShapeKind.SPHERE}
SINGLES = {Marker.SPHERE: ShapeKind.SPHERE, Marker.CYLINDER: ShapeKind.CYLINDER}
CORNERS_A_BOX = len(TRIANGLES)
# Where, among the corners of a box's triangles, each of its eight corners comes first.
FIRST = np.array([int(np.flatnonzero(corner == TRIANGLES)[0]) for corner in range(8)])


def obstacles(message: bytes) -> dict[str, Shapes]:
    """Return the shapes of each source that `~/scene` shows."""
    table = marker_array.read(message)
    found: dict[str, list[Shapes]] = {}
    for row, kind in enumerate(table.type.tolist()):
        drawn = None
        if kind in LISTS:
            drawn = _of_list(table, row, LISTS[kind])
        elif kind in SINGLES:
            places = table.position[row : row + 1], table.orientation[row : row + 1]
            drawn = _shapes(SINGLES[kind], *places, table.scale[row : row + 1])
        elif kind == Marker.TRIANGLE_LIST:
            drawn = _of_triangles(table.points(row))
        if drawn is not None:
            source = table.namespaces[int(table.namespace[row])]
            found.setdefault(source, []).append(drawn)
    return {source: _joined(several) for source, several in found.items()}


def tree(message: bytes, first_depth: int, planar: bool) -> tuple[Floats, Floats, Integers]:
    """Return the boxes (n, 3) that `~/tree` shows, lo and hi, and their depths.

    They come depth by depth, each in another colour than the one before.
    """
    table = marker_array.read(message)
    for row in np.flatnonzero(table.type == Marker.LINE_LIST).tolist():
        ends, colours = table.points(row), table.colours(row)
        each = 8 if planar else 24
        boxes = ends.reshape(-1, each, 3)
        news = np.any(np.diff(colours[::each], axis=0) != 0.0, axis=1)
        depths = first_depth + np.concatenate(([0], np.cumsum(news)))
        return boxes.min(axis=1), boxes.max(axis=1), depths
    return NO_BOXES


def queries(message: bytes) -> tuple[Floats, Floats, Floats]:
    """Return the lines (n, 2, 3) of `~/queries`, their colours (n, 3) and the hits (m, 3)."""
    table = marker_array.read(message)
    lines, colours, spots = np.empty((0, 2, 3)), np.empty((0, 3)), NO_POINTS
    for row, kind in enumerate(table.type.tolist()):
        if kind == Marker.LINE_LIST:
            lines, colours = table.points(row).reshape(-1, 2, 3), table.colours(row)[::2, :3]
        elif kind == Marker.SPHERE_LIST:
            spots = table.points(row)
    return lines, colours, spots


def _of_list(table: MarkerTable, row: int, kind: ShapeKind) -> Shapes:
    turn = rotations.normalised(table.orientation[row])
    places = rotations.rotate(turn, table.points(row)) + table.position[row]
    count = len(places)
    return _shapes(kind, places, np.tile(turn, (count, 1)), np.tile(table.scale[row], (count, 1)))


def _of_triangles(points: Floats) -> Shapes:
    """Boxes, each told by its twelve triangles."""
    corners = points.reshape(-1, CORNERS_A_BOX, 3)[:, FIRST]
    axes = corners[:, (1, 2, 4)] - corners[:, :1]  # (n, 3, 3): the edges along x, y and z
    sizes = np.linalg.norm(axes, axis=2)
    middle = 0.5 * (corners[:, 0] + corners[:, 7])
    units = np.where(sizes[..., None] > 0.0, axes / np.maximum(sizes, 5e-324)[..., None], 0.0)
    return _shapes(ShapeKind.BOX, middle, _quaternions(units), sizes)


def _quaternions(axes: Floats) -> Floats:
    """Unit quaternions (n, 4) of three unit axes (n, 3, 3); an axis may be missing (zero)."""
    x, y, z = axes[:, 0], axes[:, 1], axes[:, 2]
    x = np.where((x == 0.0).all(axis=1, keepdims=True), np.cross(y, z), x)
    y = np.where((y == 0.0).all(axis=1, keepdims=True), np.cross(z, x), y)
    z = np.where((z == 0.0).all(axis=1, keepdims=True), np.cross(x, y), z)
    from scipy.spatial.transform import Rotation

    matrices = np.stack((x, y, z), axis=2)
    sound = np.abs(np.linalg.det(matrices)) > 0.5  # else two axes are missing: any turn will do
    matrices[~sound] = np.eye(3)
    quaternions: Floats = Rotation.from_matrix(matrices).as_quat()
    return quaternions


def _shapes(kind: ShapeKind, position: Floats, orientation: Floats, size: Floats) -> Shapes:
    return Shapes(np.full(len(position), kind, np.uint8), position, orientation, size)


def _joined(several: list[Shapes]) -> Shapes:
    return Shapes(*(np.concatenate([one[column] for one in several]) for column in range(4)))
