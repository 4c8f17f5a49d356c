# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures of the world, the tree and the queries for RViz."""

from __future__ import annotations

import struct
import sys
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.ros.conversions import outlines, rotations
from bvh_ros.ros.conversions.query_clouds import FREE, UNANSWERED, Floats
from bvh_ros.ros.parts.part import OnDemandPublisher
from bvh_ros.scene import ShapeKind, Shapes, inspection
from bvh_ros.tree.access import BLOCKED_COLOUR, FREE_COLOUR, PALETTE, plotting

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.conversions.plans import Query
    from bvh_ros.ros.conversions.query_clouds import Hits, Rays
    from bvh_ros.ros.parameters import DrawSettings
    from bvh_ros.ros.world.world import World
    from bvh_ros.scene import NodeScene, SceneHit

# `~/scene` and `~/tree`: the world and the tree as few markers, while there are subscribers.
#
# RViz becomes unusable with thousands of markers, so boxes of one size and orientation are one
# CUBE_LIST, spheres of one size one SPHERE_LIST, and all boxes that have few like them the
# triangles of one TRIANGLE_LIST. Meshes are drawn by their own triangles, altogether as many as
# the boxes that `draw.limit` allows.

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

    A capsule is drawn as the box around it, and so are meshes of too many triangles.
    """

    def __init__(self, node: Node, world: World, settings: DrawSettings) -> None:
        super().__init__(node, MarkerArray, '~/scene')
        self._world = world
        self._limit = settings.limit

    def message(self) -> bytes:
        """Return the serialised MarkerArray of the world as it is now."""
        scene, drawings, drawn, boxed = self._world.scene, [], 0, 0
        left = self._limit * len(outlines.TRIANGLES) // 3
        for number, source in enumerate(scene.sources()):
            shapes, boxes = with_few_triangles(scene.shapes_of(source, self._limit - drawn), left)
            left -= int(triangles_of(shapes).sum())
            boxed += boxes
            colour = COLOURS[number % len(COLOURS)].tolist()
            for drawing, count in obstacles(shapes, source, colour):
                drawings.append(drawing)
                drawn += count
        signs = [f'{drawn} of {len(scene)} obstacles are drawn'] if drawn < len(scene) else []
        signs += [f'{boxed} meshes are drawn as boxes'] if boxed else []
        if signs and scene.bounds is not None:
            drawings.append(_sign('\n'.join(signs), *scene.bounds))
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
            size, turn = some.size[rows[0]], some.orientation[rows[0]]
            yield (
                Drawing(
                    LISTS[kind], size, colour, namespace, (0, 0, 0), turn,
                    _unturned(some.position[rows], turn),
                ),
                len(rows),
            )  # fmt: skip
        some = some.take(rest)
        if kind in SINGLES:
            for row in range(min(len(some.kind), MOST_SINGLES)):
                place = some.position[row], some.orientation[row]
                yield Drawing(SINGLES[kind], some.size[row], colour, namespace, *place), 1
        elif kind == ShapeKind.MESH:
            surfaces = inspection.triangles(some)
            singles, several = surfaces[:MOST_SINGLES], surfaces[MOST_SINGLES:]
            for corners, count in (
                *((surface, 1) for surface in singles),
                *([(np.concatenate(several), len(several))] if several else []),
            ):
                points = corners.reshape(-1, 3)
                yield (
                    Drawing(Marker.TRIANGLE_LIST, (1, 1, 1), colour, namespace, points=points),
                    count,
                )
        elif len(some.kind):
            corners = outlines.triangles(some)
            yield (
                Drawing(Marker.TRIANGLE_LIST, (1, 1, 1), colour, namespace, points=corners),
                len(some.kind),
            )


def triangles_of(shapes: Shapes) -> NDArray[np.int64]:
    """Return how many triangles each of the meshes has, in order."""
    rows = np.flatnonzero(shapes.kind == ShapeKind.MESH)
    meshes = () if shapes.mesh is None else shapes.mesh[rows]
    return np.array([len(mesh.corners) for mesh in meshes], np.int64)


def with_few_triangles(shapes: Shapes, most: int) -> tuple[Shapes, int]:
    """Return shapes whose meshes have at most so many triangles together, and how many meshes have
    become the boxes around them: the first that is too much, and those that follow.
    """
    rows = np.flatnonzero(shapes.kind == ShapeKind.MESH)
    rows = rows[np.cumsum(triangles_of(shapes)) > most]
    if not len(rows):
        return shapes, 0
    kind, position = shapes.kind.copy(), shapes.position.copy()
    kind[rows], position[rows] = ShapeKind.BOX, inspection.middles(shapes.take(rows))
    return shapes._replace(kind=kind, position=position), len(rows)


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


# `~/queries`: the last questions and their hits, while there are subscribers.

RAY_LINE, SPOT = 0.01, 0.08  # m: width of a line, diameter of a hit
FREE_RGBA, BLOCKED_RGBA = ((*colour.tolist(), 1.0) for colour in (FREE_COLOUR, BLOCKED_COLOUR))
EMPTY_WORLD = 10.0  # m that a ray without end is drawn long where there is nothing


class Answer(NamedTuple):
    """An answer, as lines and points."""

    lines: Floats  # (n, 2, 3), m
    blocked: NDArray[np.bool_]  # (n,), whether a line meets an obstacle
    spots: Floats  # (m, 3), hits, m


class QueryDrawing(OnDemandPublisher):
    """Shows the last answer to each question since the last message; green is free, red is not.

    So a repeated question leaves no trail of old hits. A ray ends where it hits, and one without
    end somewhat behind the world. A queried box is drawn by its edges, and so is the triangle of a
    mesh that a ray of a service hits.
    """

    def __init__(self, node: Node, world: World, settings: DrawSettings) -> None:
        super().__init__(node, MarkerArray, '~/queries')
        self._world = world
        self._limit = settings.limit
        self._answers: dict[object, Answer] = {}  # by question, the oldest first

    def add_rays(self, rays: Rays, hits: Hits) -> None:
        """Remember rays in the node's frame; those without an answer are left out."""
        rows = np.flatnonzero(hits.obstacles != UNANSWERED)[-self._limit :]
        origins, directions = rays.origins[rows], rays.directions[rows]
        blocked = hits.obstacles[rows] != FREE
        lengths = np.linalg.norm(directions, axis=1)
        with np.errstate(divide='ignore'):
            beyond = self._beyond_the_world(origins) / lengths
        t = np.where(blocked, hits.t[rows], np.minimum(rays.t_max[rows], beyond))
        t[lengths == 0.0] = 0.0
        ends = origins + t[:, None] * directions
        question = origins.tobytes(), directions.tobytes()
        lines = np.stack((origins, ends), axis=1)
        self._remember(question, Answer(lines, blocked, hits.points[rows][blocked]))

    def add_query(
        self, query: Query, hits: Sequence[SceneHit], scene: NodeScene, *, is_box: bool
    ) -> None:
        """Remember a query of a service, and the hits of a scene that answer it."""
        spots = np.array([hit.point for hit in hits]).reshape(-1, 3)
        start, goal = np.array(query.start), np.array(query.goal)
        lines = np.stack((start, goal))[None]
        if is_box:
            turn = rotations.normalised(query.orientation)
            half = rotations.rotate(turn * (-1.0, -1.0, -1.0, 1.0), (goal - start) * 0.5)
            half = np.abs(half)[None] + query.tolerance
            ends = outlines.edges(-half, half)
            lines = (start + goal) * 0.5 + rotations.rotate(turn, ends)
        rows = ((hit.handle, hit.triangle, hit.uv, hit.point) for hit in hits)
        triangles = scene.triangles_met(rows)
        lines = np.concatenate((lines, plotting.around(triangles)))
        blocked = np.full(len(lines), bool(hits))
        self._remember((query, is_box), Answer(lines, blocked, spots))

    def message(self) -> bytes | None:
        """Return the serialised MarkerArray, or None without queries since the last."""
        if not self._answers:
            return None
        answers = zip(*self._answers.values(), strict=True)
        lines, blocked, spots = (np.concatenate(one)[-self._limit :] for one in answers)
        self._answers.clear()
        colours = np.where(blocked[:, None], BLOCKED_RGBA, FREE_RGBA).astype(np.float32)
        drawings = [
            Drawing(
                Marker.LINE_LIST, (RAY_LINE, 0.0, 0.0), namespace='rays',
                points=lines.reshape(-1, 3), colours=np.repeat(colours, 2, axis=0),
            ),
            Drawing(Marker.SPHERE_LIST, (SPOT, SPOT, SPOT), BLOCKED_RGBA, 'hits', points=spots),
        ]  # fmt: skip
        frames, clock = self._world.frames, self.node.get_clock()
        return marker_array(drawings, frames.frame_id, clock.now().nanoseconds)

    def _remember(self, question: object, answer: Answer) -> None:
        drawable = np.isfinite(answer.lines).all(axis=(1, 2))
        lines, blocked = answer.lines[drawable], answer.blocked[drawable]
        self._answers.pop(question, None)
        self._answers[question] = answer._replace(lines=lines, blocked=blocked)
        if len(self._answers) > self._limit:
            del self._answers[next(iter(self._answers))]

    def _beyond_the_world(self, origins: Floats) -> Floats:
        """Return how long a ray from each place has to be to end behind all obstacles."""
        bounds = self._world.scene.bounds
        if bounds is None:
            return np.full(len(origins), EMPTY_WORLD)
        lo, hi = bounds
        from_middle = origins[:, : len(lo)] - (lo + hi) * 0.5
        lengths: Floats = np.linalg.norm(from_middle, axis=1) + np.linalg.norm(hi - lo)
        return lengths


# A drawing as the bytes of a MarkerArray, with the fields that `cdr.marker_array` reads.
#
# A Python object for every point would take longer than to find it: a drawing of ten thousand
# boxes has hundreds of thousands.

IDENTITY = (0.0, 0.0, 0.0, 1.0)
WHITE = (1.0, 1.0, 1.0, 1.0)
HEADER = bytes((0, int(sys.byteorder == 'little'), 0, 0))
ORIGIN = (0.0, 0.0, 0.0)

Vector = Sequence[float] | NDArray[np.float64]


class Drawing(NamedTuple):
    """What a marker needs to be drawn; the rest of its fields is zero."""

    kind: int  # Marker.CUBE_LIST and so on
    scale: Vector
    colour: Sequence[float] = WHITE  # red, green, blue, alpha: 0 to 1
    namespace: str = ''
    position: Vector = ORIGIN
    orientation: Vector = IDENTITY
    points: NDArray[np.float64] = np.empty((0, 3))
    colours: NDArray[np.float32] = np.empty((0, 4), np.float32)  # one a point
    text: str = ''


def marker_array(drawings: Sequence[Drawing], frame_id: str, stamp: int) -> bytes:
    """Return a serialised MarkerArray that draws this and nothing else.

    Parameters
    ----------
    frame_id : str
        Frame of all of them.
    stamp : int
        ns.
    """
    writer = _Writer()
    writer.put('I', 1 + len(drawings))
    clear = Drawing(Marker.CUBE, (0.0, 0.0, 0.0))
    _write(writer, clear, frame_id, stamp, 0, Marker.DELETEALL)
    for number, drawing in enumerate(drawings):
        _write(writer, drawing, frame_id, stamp, number, Marker.ADD)
    return bytes(writer.data)


class _Writer:
    """Appends values, each aligned to its own size counted from the end of the header."""

    def __init__(self) -> None:
        self.data = bytearray(HEADER)

    def put(self, kinds: str, *values: Any) -> None:
        self._align(struct.calcsize(kinds[-1]))
        self.data += struct.pack(f'={kinds}', *values)

    def string(self, text: str) -> None:
        characters = text.encode() + b'\0'
        self.put('I', len(characters))
        self.data += characters

    def table(self, rows: NDArray[Any]) -> None:
        self.put('I', len(rows))
        if len(rows):
            self._align(rows.itemsize)
            self.data += rows.tobytes()

    def _align(self, size: int) -> None:
        self.data += bytes(-(len(self.data) - len(HEADER)) % size)


def _write(
    writer: _Writer, drawing: Drawing, frame_id: str, stamp: int, number: int, action: int
) -> None:
    """Append a Marker, its fields in the order of their definition."""
    writer.put('iI', *divmod(stamp, 1_000_000_000))
    writer.string(frame_id)
    writer.string(drawing.namespace)
    writer.put('iii', number, drawing.kind, action)
    writer.put('10d', *drawing.position, *drawing.orientation, *drawing.scale)
    writer.put('4f', *drawing.colour)
    writer.put('iI', 0, 0)  # lifetime: for ever
    writer.put('?', False)  # frame_locked
    writer.table(np.asarray(drawing.points, np.float64))
    writer.table(drawing.colours)
    writer.string('')  # texture_resource
    writer.put('iI', 0, 0)  # texture: header, format and data
    for _ in range(2):
        writer.string('')
    writer.put('I', 0)
    writer.put('I', 0)  # uv_coordinates
    writer.string(drawing.text)
    for _ in range(2):
        writer.string('')  # mesh_resource, mesh_file.filename
    writer.put('I', 0)  # mesh_file.data
    writer.put('?', False)  # mesh_use_embedded_materials
