# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles and lines in viser's scene; only what has changed is sent.

Positions travel as float32, as every browser draws them, after `Placing` has moved them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import trimesh
import viser
from numpy.typing import NDArray

from bvh_ros.scene import Mesh, ShapeKind, Shapes
from bvh_ros.scene.shapes.shape import rotations
from bvh_ros.tree.access import CORNERS, EDGES, PALETTE
from bvh_ros.view.worlds import Floats, Overlay

# ---- Between the world, in metres and doubles, and the page, where seven digits are left.


SMALLEST, LARGEST = 1e-2, 1e5  # m: worlds that the page shows in metres
FAR = 100.0  # times its own size: farther from the origin, a world is shown about its middle


class Placing:
    """Where the page's origin lies in the world, and how long its unit is.

    A browser draws in float32: on a map in UTM coordinates (5e6 m) it would tell half a metre
    apart, and what is 1e12 or 1e-12 m large fits no camera. Both stay as they are until `fit`.

    Attributes
    ----------
    origin : (3,) array
        m.
    unit : float
        m.
    """

    def __init__(self) -> None:
        self.origin = np.zeros(3)
        self.unit = 1.0

    def fit(self, lo: Floats, hi: Floats) -> None:
        """Choose them for a world between two corners (3,), m."""
        middle, half = 0.5 * lo + 0.5 * hi, float((0.5 * hi - 0.5 * lo).max())
        largest = max(half, 1e-300)
        if not SMALLEST <= 2.0 * min(half, LARGEST) <= LARGEST:
            self.unit = 10.0 ** np.floor(np.log10(largest))
        if np.abs(middle).max() > FAR * largest:
            step = 10.0 ** np.ceil(np.log10(largest))  # the grid stays at round coordinates
            self.origin = np.rint(middle / step) * step

    def shown(self, points: Floats) -> Floats:
        """Where points (..., 3) of the world, m, are on the page."""
        placed: Floats = (points - self.origin) / self.unit
        return placed

    def meant(self, points: Floats) -> Floats:
        """Which points of the world, m, are meant by points (..., 3) of the page."""
        places: Floats = self.origin + self.unit * points
        return places


# ---- Obstacles and lines in viser's scene; only what has changed is sent.


MOST_SHADOWS = 2_000  # obstacles; beyond, shadows cost the browser more than they show
COLOURS = np.rint(255 * PALETTE).astype(np.uint8)
GAMMA = 2.2
SPOT = 4.0  # times the width of a line
Key = tuple[int, str]  # colour, and which mesh


class Triangles(NamedTuple):
    """A mesh of size 1, or of its own."""

    vertices: Floats
    faces: NDArray[Any]
    flat: bool


def _unit(made: trimesh.Trimesh, flat: bool) -> Triangles:
    return Triangles(np.asarray(made.vertices), np.asarray(made.faces), flat)


def as_sent(colours: Any) -> NDArray[np.uint8]:
    """Colours from 0 to 1 as viser's page wants them: it takes them for linear light."""
    sent: NDArray[np.uint8] = np.rint(255 * np.asarray(colours) ** GAMMA).astype(np.uint8)
    return sent


def _cylinder() -> Triangles:
    """Its side is smooth up to the rims, which it does not share with its ends."""
    made = trimesh.creation.cylinder(0.5, 1.0, sections=24)
    end = np.abs(made.face_normals[:, 2]) > 0.5
    corners = np.concatenate((made.faces[end], made.faces[~end] + len(made.vertices)))
    return Triangles(np.tile(made.vertices, (2, 1)), corners, False)


UNIT = {
    ShapeKind.BOX: _unit(trimesh.creation.box(), True),
    ShapeKind.SPHERE: _unit(trimesh.creation.icosphere(2, 0.5), False),
    ShapeKind.CYLINDER: _cylinder(),
}


class Obstacles:
    """Instanced meshes, one for each colour and kind of shape."""

    def __init__(self, server: viser.ViserServer, placing: Placing) -> None:
        self._server, self._placing = server, placing
        self._handles: dict[Key, viser.BatchedMeshHandle] = {}
        self.count = 0

    def draw(self, shapes: Sequence[tuple[int, Shapes]]) -> None:
        """Show these, each of the number of a colour, and nothing else."""
        instances: dict[Key, list[Shapes]] = {}
        meshes: dict[str, Triangles] = {}
        for colour, some in shapes:
            for name, triangles, alike in _by_mesh(some):
                meshes[name] = triangles
                instances.setdefault((colour % len(COLOURS), name), []).append(alike)
        self.count = sum(len(some.kind) for _, some in shapes)
        shadows = self.count <= MOST_SHADOWS
        with self._server.atomic():
            for key in self._handles.keys() - instances.keys():
                self._handles.pop(key).remove()
            for key, several in instances.items():
                self._place(key, several, meshes[key[1]], shadows)

    def _place(self, key: Key, several: list[Shapes], triangles: Triangles, shadows: bool) -> None:
        colour, name = key
        places, orientation, size = (
            np.concatenate([one[column] for one in several]) for column in (1, 2, 3)
        )
        position = self._placing.shown(places).astype(np.float32)
        turns = orientation[:, (3, 0, 1, 2)].astype(np.float32)
        vertices, scales = triangles.vertices, (size / self._placing.unit).astype(np.float32)
        if name.startswith('mesh'):
            vertices, scales = vertices / self._placing.unit, np.ones_like(scales)
        handle = self._handles.get(key)
        if handle is None:
            self._handles[key] = self._server.scene.add_batched_meshes_simple(
                f'/obstacles/{colour}_{name}', vertices, triangles.faces, turns, position,
                batched_scales=scales, batched_colors=as_sent(PALETTE[colour]),
                lod='off', flat_shading=triangles.flat, cast_shadow=shadows,
                receive_shadow=shadows,
            )  # fmt: skip
            return
        handle.batched_positions = position
        handle.batched_wxyzs = turns
        handle.batched_scales = scales
        handle.cast_shadow = handle.receive_shadow = shadows


def _by_mesh(shapes: Shapes) -> list[tuple[str, Triangles, Shapes]]:
    """What is drawn with one mesh: its name, its triangles, and where."""
    found = []
    is_capsule, is_mesh = shapes.kind == ShapeKind.CAPSULE, shapes.kind == ShapeKind.MESH
    if is_capsule.any():
        shapes = _joined(shapes.take(~is_capsule), *_parts(shapes.take(is_capsule)))
        is_mesh = shapes.kind == ShapeKind.MESH
    for kind, triangles in UNIT.items():
        rows = np.flatnonzero(shapes.kind == kind)
        if len(rows):
            found.append((kind.name.lower(), triangles, shapes.take(rows)))
    rows_of: dict[bytes, list[int]] = {}
    held: dict[bytes, Mesh] = {}
    for row in np.flatnonzero(is_mesh).tolist():
        mesh: Mesh = shapes.mesh[row]  # type: ignore[index]
        rows_of.setdefault(mesh.key, []).append(row)
        held[mesh.key] = mesh
    for key, several in rows_of.items():
        triangles = Triangles(held[key].vertices, _wound(held[key]), True)
        found.append((f'mesh_{key.hex()[:16]}', triangles, shapes.take(several)))
    return found


def _wound(mesh: Mesh) -> NDArray[np.int32]:
    """Its corners (m, 3), counter-clockwise seen from outside; in a mesh they are as they came."""
    one, two, three = np.moveaxis(mesh.vertices[mesh.corners] / mesh.radius, 1, 0)
    inward = (np.cross(two - one, three - one) * mesh.normals).sum(axis=1) < 0.0
    return np.where(inward[:, None], mesh.corners[:, ::-1], mesh.corners)


def _parts(capsules: Shapes) -> tuple[Shapes, Shapes, Shapes]:
    """The cylinders and balls that capsules consist of."""
    width, length = capsules.size[:, 0], capsules.size[:, 2]
    straight = np.maximum(length - width, 0.0)
    up = rotations(capsules.orientation)[:, :, 2] * (0.5 * straight[:, None])
    cylinders = capsules._replace(
        kind=np.full_like(capsules.kind, ShapeKind.CYLINDER),
        size=np.stack((width, width, straight), axis=1),
    ).take(straight > 0.0)
    balls = capsules._replace(
        kind=np.full_like(capsules.kind, ShapeKind.SPHERE),
        size=np.repeat(width[:, None], 3, axis=1),
    )
    above, below = (balls._replace(position=balls.position + way) for way in (up, -up))
    return cylinders, above, below


def _joined(*several: Shapes) -> Shapes:
    meshes = [np.full(len(one.kind), None) if one.mesh is None else one.mesh for one in several]
    columns = [np.concatenate([one[column] for one in several]) for column in range(4)]
    return Shapes._make([*columns, np.concatenate(meshes)])


class Lines:
    """Line segments under one name, there only while there are any."""

    def __init__(
        self, server: viser.ViserServer, placing: Placing, name: str, width: float
    ) -> None:
        self._server, self._placing = server, placing
        self._name, self._width = name, width
        self._handle: viser.LineSegmentsHandle | None = None

    def draw(self, segments: Floats, colours: Floats) -> None:
        """Show segments (n, 2, 3), m, in colours (n, 3) from 0 to 1."""
        if not len(segments):
            self.clear()
            return
        points = self._placing.shown(segments).astype(np.float32)
        each = np.repeat(as_sent(colours)[:, None], 2, axis=1)
        if self._handle is None:
            self._handle = self._server.scene.add_line_segments(
                self._name, points, each, thickness=self._width, thickness_units='screen'
            )
        else:
            with self._server.atomic():
                self._handle.points, self._handle.colors = points, each

    def clear(self) -> None:
        """Show nothing."""
        if self._handle is not None:
            self._handle.remove()
            self._handle = None


class Dots:
    """Points under one name, of a size in units of the page."""

    def __init__(
        self,
        server: viser.ViserServer,
        placing: Placing,
        name: str,
        colour: Sequence[float] | Floats,
    ) -> None:
        self._server, self._placing = server, placing
        self._name, self._colour = name, as_sent(colour)
        self._handle: viser.PointCloudHandle | None = None

    def draw(self, points: Floats, size: float) -> None:
        """Show points (n, 3), m."""
        places = self._placing.shown(points).astype(np.float32)
        if self._handle is not None and not len(points):
            self._handle.remove()
            self._handle = None
        elif self._handle is not None:
            with self._server.atomic():
                self._handle.points, self._handle.point_size = places, size
        elif len(points):
            self._handle = self._server.scene.add_point_cloud(
                self._name, places, self._colour, point_size=size, point_shape='circle',
                precision='float32', point_shading='gradient',
            )  # fmt: skip


class Overlays:
    """The last queries and hits, and the virtual scan."""

    def __init__(self, server: viser.ViserServer, placing: Placing) -> None:
        self._lines = Lines(server, placing, '/queries/rays', 2.0)
        self._hits = Dots(server, placing, '/queries/hits', PALETTE[6])
        self._scan = Dots(server, placing, '/scan', PALETTE[5])
        self._shown: Overlay | None = None

    def draw(self, overlay: Overlay, size: float) -> None:
        """Show these; `size` is that of the world on the page."""
        if overlay is self._shown:
            return
        self._shown = overlay
        self._lines.draw(overlay.lines, overlay.colours)
        self._hits.draw(overlay.spots, 0.006 * size)
        self._scan.draw(overlay.scan, 0.004 * size)


def edges_of(position: Floats, turn: Floats, size: Floats) -> Floats:
    """Return the twelve edges (12, 2, 3) of a box that is turned by a rotation matrix."""
    corners = ((CORNERS - 0.5) * size) @ turn.T + position
    return corners[EDGES]
