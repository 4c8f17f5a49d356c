# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`~/scene` and `~/tree`: the world and the tree about it as few markers, while somebody looks.

RViz becomes unusable with thousands of markers, so boxes of one size and orientation are one
CUBE_LIST, spheres of one size one SPHERE_LIST, and all boxes that have few like them the triangles
of one TRIANGLE_LIST.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.ros.cdr.drawing import Drawing, marker_array
from bvh_ros.ros.conversions import outlines, rotations
from bvh_ros.ros.parts.watched import OnDemandPublisher
from bvh_ros.scene import ShapeKind, Shapes
from bvh_ros.tree.access import PALETTE

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.config.part_settings import DrawSettings
    from bvh_ros.ros.world.world import World

MOST_SINGLES = 500  # markers of a single shape; with thousands of them RViz crawls
MOST_LISTS = 50  # of each source and kind
WORTH_A_LIST = 8  # shapes of one size
LINE = 0.01  # m, width of the tree's edges
LETTERS = 0.05  # height of the text as a share of the world's size

COLOURS = np.column_stack((PALETTE, np.ones(len(PALETTE)))).astype(np.float32)
LISTS = {ShapeKind.BOX: Marker.CUBE_LIST, ShapeKind.SPHERE: Marker.SPHERE_LIST}
SINGLES = {ShapeKind.SPHERE: Marker.SPHERE, ShapeKind.CYLINDER: Marker.CYLINDER}


class SceneDrawing(OnDemandPublisher):
    """`~/scene`: every obstacle, up to a limit, in the namespace and colour of its source.

    What is neither box, sphere nor cylinder is drawn as the box around it.
    """

    def __init__(self, node: Node, world: World, settings: DrawSettings) -> None:
        super().__init__(node, MarkerArray, '~/scene')
        self._world = world
        self._limit = settings.limit

    def message(self) -> bytes:
        """Return the serialised MarkerArray of the world as it is now."""
        scene, drawings, drawn = self._world.scene, [], 0
        for number, source in enumerate(scene.sources()):
            shapes = scene.shapes_of(source, self._limit - drawn)
            colour = COLOURS[number % len(COLOURS)].tolist()
            for drawing, count in obstacles(shapes, source, colour):
                drawings.append(drawing)
                drawn += count
        if drawn < len(scene) and scene.bounds is not None:
            drawings.append(_sign(f'{drawn} of {len(scene)} obstacles are drawn', *scene.bounds))
        return marker_array(drawings, self._world.frames.frame_id, scene.newest)


class TreeDrawing(OnDemandPublisher):
    """`~/tree`: the boxes of the tree's nodes at some depths as one LINE_LIST."""

    def __init__(self, node: Node, world: World, settings: DrawSettings) -> None:
        super().__init__(node, MarkerArray, '~/tree')
        self._world = world
        self._settings = settings

    def message(self) -> bytes:
        """Return the serialised MarkerArray of the tree as it is now."""
        scene, settings = self._world.scene, self._settings
        lo, hi, depths = scene.tree_levels(
            settings.first_depth, settings.last_depth, settings.limit + 1
        )
        whole = len(lo) <= settings.limit
        lo, hi, depths = lo[: settings.limit], hi[: settings.limit], depths[: settings.limit]
        ends = outlines.edges(lo, hi).reshape(-1, 3)
        each = len(ends) // max(len(lo), 1)
        colours = np.repeat(COLOURS[depths % len(COLOURS)], each, axis=0)
        drawings = []
        if len(lo):
            lines = Drawing(
                Marker.LINE_LIST, (LINE, 0.0, 0.0), points=ends, colours=colours, namespace='tree'
            )
            drawings.append(lines)
            if not whole:
                drawings.append(_sign(f'the first {len(lo)} boxes of the tree', lo[0], hi[0]))
        return marker_array(drawings, self._world.frames.frame_id, scene.newest)


def obstacles(
    shapes: Shapes, namespace: str, colour: list[float]
) -> Iterator[tuple[Drawing, int]]:
    """Yield the drawings of shapes, and how many each of them shows."""
    kinds = [ShapeKind(kind) for kind in np.unique(shapes.kind).tolist()]
    for kind in kinds:
        some = shapes.take(shapes.kind == kind)
        rest = np.ones(len(some.kind), bool)
        for rows in _alike(some) if kind in LISTS else ():
            rest[rows] = False
            one = some.take(rows[0])
            yield (
                Drawing(
                    LISTS[kind], one.size, colour, namespace, (0, 0, 0), one.orientation,
                    _unturned(some.position[rows], one.orientation),
                ),
                len(rows),
            )  # fmt: skip
        some = some.take(rest)
        if kind in SINGLES:
            for row in range(min(len(some.kind), MOST_SINGLES)):
                one = some.take(row)
                yield (
                    Drawing(
                        SINGLES[kind], one.size, colour, namespace, one.position, one.orientation
                    ),
                    1,
                )
        elif len(some.kind):
            corners = outlines.triangles(some)
            yield (
                Drawing(Marker.TRIANGLE_LIST, (1, 1, 1), colour, namespace, points=corners),
                len(some.kind),
            )


def _alike(shapes: Shapes) -> Iterator[NDArray[np.int64]]:
    """Yield the rows of shapes of one size and orientation, where they are many."""
    keys = np.hstack((shapes.size, shapes.orientation))
    _, group, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    largest = np.argsort(-counts, kind='stable')[:MOST_LISTS]
    for number in largest[counts[largest] >= WORTH_A_LIST].tolist():
        yield np.flatnonzero(group.ravel() == number)


def _unturned(points: outlines.Floats, orientation: outlines.Floats) -> outlines.Floats:
    """Return points in the frame of a marker at the origin that is turned so."""
    back = rotations.normalised(orientation) * (-1.0, -1.0, -1.0, 1.0)
    return rotations.rotate(back, points)


def _sign(text: str, lo: outlines.Floats, hi: outlines.Floats) -> Drawing:
    """Return a text above the world."""
    size = float((hi - lo).max())
    lo, hi = (np.append(corner, 0.0)[:3] for corner in (lo, hi))
    place = ((lo + hi) * 0.5 + (0.0, 0.0, (hi - lo)[2] * 0.5 + LETTERS * size)).tolist()
    return Drawing(Marker.TEXT_VIEW_FACING, (0.0, 0.0, LETTERS * size), position=place, text=text)
