# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles and lines in viser's scene; only what has changed is sent.

Positions travel as float32, as every browser draws them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import trimesh
import viser
from numpy.typing import NDArray

from bvh_ros.scene import Mesh, ShapeKind, Shapes
from bvh_ros.tree.plotting import CORNERS, EDGES, PALETTE, corners_of
from bvh_ros.view.worlds import Floats, Overlay

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


UNIT = {
    ShapeKind.BOX: _unit(trimesh.creation.box(), True),
    ShapeKind.SPHERE: _unit(trimesh.creation.icosphere(2, 0.5), False),
    ShapeKind.CYLINDER: _unit(trimesh.creation.cylinder(0.5, 1.0, sections=24), True),
}


class Obstacles:
    """Instanced meshes, one for each colour and kind of shape.

    What is neither box, sphere, cylinder nor mesh is drawn as the box around it.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._handles: dict[Key, viser.BatchedMeshHandle] = {}
        self.count = 0

    def draw(self, shapes: Sequence[tuple[int, Shapes]]) -> None:
        """Show these, each of the number of a colour, and nothing else."""
        instances: dict[Key, list[Shapes]] = {}
        meshes: dict[str, Triangles] = {}
        for colour, some in shapes:
            for name, triangles, rows in _by_mesh(some):
                meshes[name] = triangles
                instances.setdefault((colour % len(COLOURS), name), []).append(some.take(rows))
        self.count = sum(len(some.kind) for _, some in shapes)
        shadows = self.count <= MOST_SHADOWS
        with self._server.atomic():
            for key in self._handles.keys() - instances.keys():
                self._handles.pop(key).remove()
            for key, several in instances.items():
                self._place(key, several, meshes[key[1]], shadows)

    def _place(self, key: Key, several: list[Shapes], triangles: Triangles, shadows: bool) -> None:
        colour, name = key
        position, orientation, size = (
            np.concatenate([one[column] for one in several]).astype(np.float32)
            for column in (1, 2, 3)
        )
        turns = orientation[:, (3, 0, 1, 2)]
        scales = np.ones_like(size) if name.startswith('mesh') else size
        handle = self._handles.get(key)
        if handle is None:
            self._handles[key] = self._server.scene.add_batched_meshes_simple(
                f'/obstacles/{colour}_{name}', triangles.vertices, triangles.faces, turns,
                position, batched_scales=scales, batched_colors=as_sent(PALETTE[colour]),
                lod='off', flat_shading=triangles.flat, cast_shadow=shadows,
                receive_shadow=shadows,
            )  # fmt: skip
            return
        handle.batched_positions = position
        handle.batched_wxyzs = turns
        handle.batched_scales = scales
        handle.cast_shadow = handle.receive_shadow = shadows


def _by_mesh(shapes: Shapes) -> list[tuple[str, Triangles, NDArray[np.int64]]]:
    """What is drawn with one mesh: its name, its triangles, and the rows."""
    found = []
    kind = np.where(np.isin(shapes.kind, [*UNIT, ShapeKind.MESH]), shapes.kind, ShapeKind.BOX)
    if shapes.mesh is None:
        kind = np.where(kind == ShapeKind.MESH, ShapeKind.BOX, kind)
    for one, triangles in UNIT.items():
        rows = np.flatnonzero(kind == one)
        if len(rows):
            found.append((one.name.lower(), triangles, rows))
    rows_of: dict[bytes, list[int]] = {}
    held: dict[bytes, Mesh] = {}
    for row in np.flatnonzero(kind == ShapeKind.MESH).tolist():
        mesh: Mesh = shapes.mesh[row]  # type: ignore[index]
        rows_of.setdefault(mesh.key, []).append(row)
        held[mesh.key] = mesh
    for key, several in rows_of.items():
        wound = trimesh.Trimesh(held[key].vertices, held[key].corners, process=False)
        wound.fix_normals()  # the triangles of a mesh are wound as they came
        found.append((f'mesh_{key.hex()[:16]}', _unit(wound, True), np.array(several)))
    return found


class Lines:
    """Line segments under one name, there only while there are any."""

    def __init__(self, server: viser.ViserServer, name: str, width: float) -> None:
        self._server, self._name, self._width = server, name, width
        self._handle: viser.LineSegmentsHandle | None = None

    def draw(self, segments: Floats, colours: Floats) -> None:
        """Show segments (n, 2, 3), colours (n, 3) from 0 to 1."""
        if not len(segments):
            self.clear()
            return
        points = segments.astype(np.float32)
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
    """Points under one name, of a size in metres."""

    def __init__(
        self, server: viser.ViserServer, name: str, colour: Sequence[float] | Floats
    ) -> None:
        self._server, self._name = server, name
        self._colour = as_sent(colour)
        self._handle: viser.PointCloudHandle | None = None

    def draw(self, points: Floats, size: float) -> None:
        """Show points (n, 3)."""
        if self._handle is not None and not len(points):
            self._handle.remove()
            self._handle = None
        elif self._handle is not None:
            with self._server.atomic():
                self._handle.points, self._handle.point_size = points.astype(np.float32), size
        elif len(points):
            self._handle = self._server.scene.add_point_cloud(
                self._name, points, self._colour, point_size=size, point_shape='circle',
                precision='float32', point_shading='gradient',
            )  # fmt: skip


class Overlays:
    """The last queries and hits, and the virtual scan."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._lines = Lines(server, '/queries/rays', 2.0)
        self._hits = Dots(server, '/queries/hits', PALETTE[6])
        self._scan = Dots(server, '/scan', PALETTE[5])
        self._shown: Overlay | None = None

    def draw(self, overlay: Overlay, size: float) -> None:
        """Show these; `size` is that of the world, m."""
        if overlay is self._shown:
            return
        self._shown = overlay
        self._lines.draw(overlay.lines, overlay.colours)
        self._hits.draw(overlay.spots, 0.006 * size)
        self._scan.draw(overlay.scan, 0.004 * size)


def edges(lo: Floats, hi: Floats) -> Floats:
    """Return the edges (n * 12, 2, 3) of boxes (n, 3), or (n * 4, 2, 3) of flat ones (n, 2)."""
    flat = lo.shape[1] == 2
    around = EDGES[(EDGES < 4).all(axis=1)] if flat else EDGES
    ends = corners_of(lo, hi)[:, around].reshape(-1, 2, lo.shape[1])
    return np.pad(ends, ((0, 0), (0, 0), (0, 1))) if flat else ends


def edges_of(position: Floats, turn: Floats, size: Floats) -> Floats:
    """Return the twelve edges (12, 2, 3) of a box that is turned by a rotation matrix."""
    corners = ((CORNERS - 0.5) * size) @ turn.T + position
    return corners[EDGES]
