# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles and lines in viser's scene; only what has changed is sent.

Positions travel as float32, as every browser draws them, after `Placing` has moved them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import trimesh
import viser
from numpy.typing import NDArray

from bvh_ros.scene import Mesh, ShapeKind, Shapes
from bvh_ros.scene.shapes.shape import rotations
from bvh_ros.tree.access import BLOCKED_COLOUR, PALETTE
from bvh_ros.view.worlds import Floats, Overlay

# ---- World coordinates (doubles) and page coordinates (float32)


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

    def in_world(self, points: Floats) -> Floats:
        """Where points (..., 3) of the page are in the world, m."""
        places: Floats = self.origin + self.unit * points
        return places


# ---- Obstacles and lines in the scene of viser; only changes are sent


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
    side: str = 'front'  # from where they are seen


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


class Shown:
    """A node of viser's scene, there from the first `draw` to `clear`; only changes are sent."""

    def __init__(
        self, server: viser.ViserServer, add: Callable[..., Any], name: str, **fixed: Any
    ) -> None:
        self._server, self._add, self._name, self._fixed = server, add, name, fixed
        self._handle: Any = None

    def draw(self, **values: Any) -> None:
        """Show it with these properties."""
        if self._handle is None:
            self._handle = self._add(self._name, **self._fixed, **values)
            return
        with self._server.atomic():
            for name, value in values.items():
                setattr(self._handle, name, value)

    def clear(self) -> None:
        """Show nothing."""
        if self._handle is not None:
            self._handle.remove()
            self._handle = None


class Obstacles:
    """Instanced meshes, one for each colour and kind of shape."""

    def __init__(self, server: viser.ViserServer, placing: Placing) -> None:
        self._server, self._placing = server, placing
        self._shown: dict[Key, Shown] = {}
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
            for key in self._shown.keys() - instances.keys():
                self._shown.pop(key).clear()
            for key, several in instances.items():
                self._place(key, several, meshes[key[1]], shadows)

    def _place(self, key: Key, several: list[Shapes], triangles: Triangles, shadows: bool) -> None:
        colour, name = key
        places, orientation, size = (
            np.concatenate([one[column] for one in several]) for column in (1, 2, 3)
        )
        vertices, scales = triangles.vertices, (size / self._placing.unit).astype(np.float32)
        if name.startswith('mesh'):
            vertices, scales = vertices / self._placing.unit, np.ones_like(scales)
        if key not in self._shown:
            self._shown[key] = Shown(
                self._server, self._server.scene.add_batched_meshes_simple,
                f'/obstacles/{colour}_{name}', vertices=vertices, faces=triangles.faces,
                batched_colors=as_sent(PALETTE[colour]), lod='off', flat_shading=triangles.flat,
                side=triangles.side,
            )  # fmt: skip
        self._shown[key].draw(
            batched_wxyzs=orientation[:, (3, 0, 1, 2)].astype(np.float32),
            batched_positions=self._placing.shown(places).astype(np.float32),
            batched_scales=scales, cast_shadow=shadows, receive_shadow=shadows,
        )  # fmt: skip


def _by_mesh(shapes: Shapes) -> Iterator[tuple[str, Triangles, Shapes]]:
    """What is drawn with one mesh: its name, its triangles, and where."""
    capsules = shapes.kind == ShapeKind.CAPSULE
    for some in (shapes, *_parts(shapes.take(capsules))) if capsules.any() else (shapes,):
        for kind, triangles in UNIT.items():
            rows = np.flatnonzero(some.kind == kind)
            if len(rows):
                yield kind.name.lower(), triangles, some.take(rows)
    rows_of: dict[bytes, list[int]] = {}
    meshes: dict[bytes, Mesh] = {}
    for row in np.flatnonzero(shapes.kind == ShapeKind.MESH).tolist():
        mesh: Mesh = shapes.mesh[row]  # type: ignore[index]
        rows_of.setdefault(mesh.key, []).append(row)
        meshes[mesh.key] = mesh
    for key, several in rows_of.items():
        # One that is not convex may be open, and is wound anyhow.
        side = 'front' if meshes[key].convex else 'double'
        triangles = Triangles(meshes[key].vertices, _wound(meshes[key]), True, side)
        yield f'mesh_{key.hex()[:16]}', triangles, shapes.take(several)


def _wound(mesh: Mesh) -> NDArray[np.int32]:
    """Its corners (m, 3), counter-clockwise from outside; those of a mesh keep their order."""
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
    above, below = (balls._replace(position=balls.position + shift) for shift in (up, -up))
    return cylinders, above, below


class Lines:
    """Line segments under one name."""

    def __init__(
        self, server: viser.ViserServer, placing: Placing, name: str, width: float
    ) -> None:
        add, self._placing = server.scene.add_line_segments, placing
        self._shown = Shown(server, add, name, thickness=width, thickness_units='screen')

    def draw(self, segments: Floats, colours: Floats) -> None:
        """Show segments (n, 2, 3), m, in colours (n, 3) from 0 to 1."""
        if not len(segments):
            self._shown.clear()
            return
        points = self._placing.shown(segments).astype(np.float32)
        each = np.repeat(as_sent(colours)[:, None], 2, axis=1)
        self._shown.draw(points=points, colors=each)

    def clear(self) -> None:
        """Show nothing."""
        self._shown.clear()


class Dots:
    """Points under one name, of a size in units of the page."""

    def __init__(
        self, server: viser.ViserServer, placing: Placing, name: str, colour: Any
    ) -> None:
        add, self._placing = server.scene.add_point_cloud, placing
        self._shown = Shown(
            server, add, name, colors=as_sent(colour), point_shape='circle', precision='float32',
            point_shading='gradient',
        )  # fmt: skip

    def draw(self, points: Floats, size: float) -> None:
        """Show points (n, 3), m."""
        if not len(points):
            self._shown.clear()
            return
        self._shown.draw(points=self._placing.shown(points).astype(np.float32), point_size=size)


class Overlays:
    """The last queries and hits, and the virtual scan."""

    def __init__(self, server: viser.ViserServer, placing: Placing) -> None:
        self._lines = Lines(server, placing, '/queries/rays', 2.0)
        self._hits = Dots(server, placing, '/queries/hits', BLOCKED_COLOUR)
        self._scan = Dots(server, placing, '/scan', PALETTE[2])
        self._shown: Overlay | None = None

    def draw(self, overlay: Overlay, size: float) -> None:
        """Show these; `size` is that of the world on the page."""
        if overlay is self._shown:
            return
        self._shown = overlay
        self._lines.draw(overlay.lines, overlay.colours)
        self._hits.draw(overlay.spots, 0.006 * size)
        self._scan.draw(overlay.scan, 0.004 * size)
