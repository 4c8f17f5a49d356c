# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a scene tells about itself."""

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree.access import CORNERS, SIDES, Ids, checks
from .results import LAST_NODE_HANDLE, NO_NODE, Obstacle
from .rows import text
from .shapes.mesh import Mesh, convex_polygon
from .shapes.shape import Floats, ShapeKind, Shapes, different, rotations, shapes_of
from .store import Obstacles, run_in_thread

MOST_COUNTED = 100_000  # boxes, whose cost takes 5 ms

# ---- The surfaces of obstacles as polygons, and what is seen of them from above.

AROUND, UP = 24, 12  # faces of a sphere, and of a cylinder's side


def _sphere() -> Floats:
    """Quadrilaterals (n, 4, 3) of a ball of diameter 1."""
    turn = np.linspace(0.0, 2.0 * np.pi, AROUND + 1)
    rise = np.linspace(-0.5 * np.pi, 0.5 * np.pi, UP + 1)
    ring, height = np.cos(rise)[:, None], np.sin(rise)[:, None] + 0.0 * turn
    grid = 0.5 * np.stack((ring * np.cos(turn), ring * np.sin(turn), height), axis=2)
    return _between(grid)


def _cylinder() -> Floats:
    """The same of a cylinder of diameter and height 1; those of a base meet in its middle."""
    turn = np.linspace(0.0, 2.0 * np.pi, AROUND + 1)
    ring = 0.5 * np.array((0.0, 1.0, 1.0, 0.0))[:, None]
    height = np.array((-0.5, -0.5, 0.5, 0.5))[:, None] + 0.0 * turn
    return _between(np.stack((ring * np.cos(turn), ring * np.sin(turn), height), axis=2))


def _between(grid: Floats) -> Floats:
    """Quadrilaterals between the points of a grid, which goes up, and around counter-clockwise."""
    below, above = grid[:-1], grid[1:]
    sides = (below[:, :-1], below[:, 1:], above[:, 1:], above[:, :-1])
    return np.stack(sides, axis=2).reshape(-1, 4, 3)


UNIT = {
    ShapeKind.BOX: (CORNERS - 0.5)[SIDES],
    ShapeKind.SPHERE: _sphere(),
    ShapeKind.CYLINDER: _cylinder(),
}


def surfaces(shapes: Shapes) -> Iterator[Floats]:
    """Yield the polygons of canonical shapes, (m, 4, 3) or (m, 3, 3) for each."""
    turns = rotations(shapes.orientation)
    for row, kind in enumerate(shapes.kind.tolist()):
        local = _local(shapes, row, ShapeKind(kind))
        yield local @ turns[row].T + shapes.position[row]


def _local(shapes: Shapes, row: int, kind: ShapeKind) -> Floats:
    size = shapes.size[row]
    if kind == ShapeKind.MESH and shapes.mesh is not None:
        mesh = shapes.mesh[row]
        corners: Floats = mesh.vertices[mesh.corners]
        return corners
    if kind == ShapeKind.CAPSULE:
        ball = UNIT[ShapeKind.SPHERE] * size[0]
        straight = size[2] - size[0]
        middle = ball.mean(axis=1, keepdims=True)[..., 2:]
        side = UNIT[ShapeKind.CYLINDER][AROUND : 2 * AROUND] * (size[0], size[1], straight)
        return np.concatenate((ball + np.sign(middle) * (0.0, 0.0, 0.5 * straight), side))
    return UNIT[kind] * size


def faces_of(shapes: Shapes) -> list[Floats]:
    """All the polygons of canonical shapes, one after the other."""
    return [face for surface in surfaces(shapes) for face in surface]


def outlines(shapes: Shapes) -> list[Floats]:
    """The polygon (k, 2) around each shape as seen from above; of a mesh that is not convex its
    triangles instead.
    """
    polygons: list[Floats] = []
    for row, surface in enumerate(surfaces(shapes)):
        flat, mesh = surface[:, :, :2], None if shapes.mesh is None else shapes.mesh[row]
        if mesh is None or mesh.convex:
            polygons.append(convex_polygon(flat.reshape(-1, 2)))
        else:
            polygons.extend(flat)
    return polygons


def triangles(shapes: Shapes) -> list[Floats]:
    """The triangles (m, 3, 3) of each of the canonical shapes, which are meshes."""
    assert shapes.mesh is not None
    turns, found = rotations(shapes.orientation), [np.empty((0, 3, 3))] * len(shapes.kind)
    meshes, which = different(shapes.mesh)
    for number, mesh in enumerate(meshes):
        rows = np.flatnonzero(which == number)
        places = mesh.vertices @ turns[rows].swapaxes(1, 2) + shapes.position[rows, None]
        for row, corners in zip(rows.tolist(), places, strict=True):
            found[row] = corners[mesh.corners]
    return found


def middles(shapes: Shapes) -> Floats:
    """Middles (n, 3) of canonical shapes' own boxes: the frame of a mesh may begin elsewhere."""
    places = shapes.position.copy()
    rows = np.flatnonzero(shapes.kind == ShapeKind.MESH)
    if shapes.mesh is not None and len(rows):
        meshes, which = different(shapes.mesh[rows])
        spans = [(mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)) for mesh in meshes]
        local, turns = 0.5 * np.array(spans).sum(axis=1), rotations(shapes.orientation[rows])
        places[rows] += np.einsum('nij,nj->ni', turns, local[which])
    return places


# ---- What a scene tells about itself.


class Inspection:
    """Names, sizes and soundness of a scene."""

    def __init__(self, store: Obstacles) -> None:
        self._store = store

    def get(self, name: str) -> Obstacle:
        """What is known of one obstacle. KeyError if there is none of this name."""
        slot = self._store.slot(name)
        columns = self._store.columns
        geometry = columns.geometry[slot]
        group = self._store.groups.group(int(columns.group[slot]))
        return Obstacle(
            name,
            int(columns.node_handle[slot]),
            ShapeKind(int(geometry['kind'])),
            geometry['position'].copy(),
            geometry['orientation'].copy(),
            geometry['half'] * 2.0,
            int(columns.stamp[slot]),
            int(columns.expires[slot]),
            group.source,
            group.name,
        )

    def handles(self) -> NDArray[np.int64]:
        """Node handles of all obstacles, ascending."""
        handles = self._store.columns.node_handle
        return np.sort(handles[(handles > 0) & ~self._store.columns.shadow])

    def names(self, after: int = 0) -> list[tuple[int, str]]:
        """(node handle, name) of the obstacles with a handle above `after`, by handle."""
        return list(self.names_still_there(*self.newcomers(after)))

    def newcomers(self, after: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Node handles above `after`, ascending, and a number for each that
        `names_still_there` takes.
        """
        slots = self._store.columns.used()
        slots = slots[~self._store.columns.shadow[slots]]
        handles = self._store.columns.node_handle[slots]
        first = int(np.searchsorted(handles, checks.whole('after', after, 0), side='right'))
        return handles[first:], slots[first:]

    def names_still_there(
        self, handles: NDArray[np.int64], slots: NDArray[np.int64]
    ) -> Iterator[tuple[int, str]]:
        """(node handle, name) of those newcomers that are still there."""
        there = self._store.columns.node_handle[slots] == handles
        for handle, slot in zip(handles[there].tolist(), slots[there].tolist(), strict=True):
            yield handle, self._store.registry.name(slot)

    def name_of(self, handle: int) -> str:
        """Name of the obstacle with this node handle. KeyError if there is none (any more)."""
        handle = checks.whole('handle', handle, 0)
        slots = np.flatnonzero(self._store.columns.node_handle == handle)
        if handle == NO_NODE:
            raise KeyError(f'handle {handle} is NO_NODE, no obstacle: names_of has None for it')
        if handle <= 0 or not len(slots):
            raise KeyError(f'no obstacle has the node handle {handle}')
        return self._store.registry.name(int(slots[0]))

    def names_of(self, handles: ArrayLike) -> NDArray[np.object_]:
        """Names of the obstacles with these node handles, as the answers of batches have them.

        Parameters
        ----------
        handles : array_like of int, any shape
            NO_NODE stands for no obstacle.

        Returns
        -------
        ndarray of object, the same shape
            A name each, None for NO_NODE.

        Raises
        ------
        ValueError
            If they are no handles.
        KeyError
            If an obstacle is not there (any more).
        """
        given = checks.array_of('handles', handles)
        numbers = checks.numbers('handles', given.reshape(-1))
        wanted, which = np.unique(numbers, return_inverse=True)
        columns = self._store.columns.node_handle
        slots = np.flatnonzero((columns > 0) & np.isin(columns, wanted))
        slot_of = dict(zip(columns[slots].tolist(), slots.tolist(), strict=True))
        names = np.empty(len(wanted), object)
        for row, handle in enumerate(wanted.tolist()):
            if handle in slot_of:
                names[row] = self._store.registry.name(slot_of[handle])
            elif handle != NO_NODE:
                raise KeyError(f'no obstacle has the node handle {handle}')
        return names[which.reshape(-1)].reshape(given.shape)

    def sources(self) -> list[str]:
        """The sources that ever had an obstacle."""
        return list(self._store.groups.by_source())

    def shapes_of(self, source: str, most: int) -> Shapes:
        """Canonical shapes of the first obstacles of a source, by handle: a mesh has the position
        of the middle of its box.
        """
        return self._shapes_at(self._slots_of(source, most))

    def _shapes_at(self, slots: NDArray[np.int64]) -> Shapes:
        geometry = self._store.columns.geometry[slots]
        kind, mesh = geometry['kind'], None
        if (kind == ShapeKind.MESH).any():
            mesh = np.empty(len(slots), object)
            for row in np.flatnonzero(kind == ShapeKind.MESH).tolist():
                store = self._store.columns.meshes[int(geometry['mesh'][row])]
                mesh[row] = store if isinstance(store, Mesh) else store.mesh
        return shapes_of(geometry)._replace(mesh=mesh)

    def own_box(self, name: str) -> tuple[Floats, Floats, Floats]:
        """Middle, orientation and edges of the box around one obstacle, along its own axes.

        KeyError if there is none of this name.
        """
        shapes = self._shapes_at(np.array([self._store.slot(name)]))
        return middles(shapes)[0], shapes.orientation[0], shapes.size[0]

    def triangles_met(self, hits: Iterable[tuple[int, int, Floats, Floats]]) -> Floats:
        """Corners (m, 3, 3) of the triangles that hits, (handle, triangle, uv, point), have met.

        The scene must not have changed since. A triangle that moves stands where it is met. Hits
        without a triangle are left out.
        """
        columns, found = self._store.columns, []
        at_meshes = [hit for hit in hits if hit[1] >= 0]
        slots = np.flatnonzero(np.isin(columns.node_handle, [hit[0] for hit in at_meshes]))
        slot_of = dict(zip(columns.node_handle[slots].tolist(), slots.tolist(), strict=True))
        for handle, triangle, (u, v), point in at_meshes:
            shape = columns.geometry[slot_of[handle]]
            mesh = columns.meshes[int(shape['mesh'])]
            face = mesh.corners[np.searchsorted(mesh.rows, triangle)]
            corners = mesh.vertices[face]
            place = np.array((1.0 - u - v, u, v)) @ corners
            found.append((corners - place) @ rotations(shape['orientation'][None])[0].T + point)
        return np.array(found).reshape(-1, 3, 3)

    def handles_of(self, source: str, most: int) -> NDArray[np.int64]:
        """Node handles of a source's obstacles, row for row those of `shapes_of`."""
        return self._store.columns.node_handle[self._slots_of(source, most)]

    def _slots_of(self, source: str, most: int) -> NDArray[np.int64]:
        """Slots of the first obstacles of a source, by node handle."""
        most = checks.whole('most', most, 0)
        number = self._store.groups.source(text('source', source))
        mine = np.flatnonzero(self._store.columns.source == number)
        handles = self._store.columns.node_handle[mine]
        if len(mine) > most:
            first = np.argpartition(handles, most)[:most]
            mine, handles = mine[first], handles[first]
        return mine[np.argsort(handles, kind='stable')]

    def faces(self) -> dict[str, list[Floats]]:
        """The polygons of each source; of a planar scene, those seen from above."""
        polygons = outlines if self._store.planar else faces_of
        most = len(self._store.columns.source)
        return {source: polygons(self.shapes_of(source, most)) for source in self.sources()}

    def tree_levels(self, first: int, last: int, most: int) -> tuple[Floats, Floats, Ids]:
        """lo, hi and depth of the tree's boxes from depth `first` to `last`; the root's is 0."""
        return self._store.tree.levels(first, last, most)

    def stats(self) -> dict[str, Any]:
        """Sizes, the tree's shape, and which parts this scene uses."""
        return self._figures(self._store.tree.stats())

    def figures(self) -> dict[str, Any]:
        """`stats`; the cost of a tree of more than MOST_COUNTED boxes is NaN."""
        tree = self._store.tree
        cost = tree.cost() if len(tree) <= MOST_COUNTED else math.nan
        return self._figures(tree.figures() | {'cost': cost})

    def _figures(self, tree: dict[str, Any]) -> dict[str, Any]:
        return {
            'boxes': len(self._store),
            'planar': self._store.planar,
            'margin': tree['margin'],
            'height': tree['height'],
            'cost': tree['cost'],
            'sources': self._store.groups.by_source(),
            'shaped': self._store.columns.shaped,
            'bytes': self._store.columns.nbytes + self._store.columns.meshes.nbytes,
            'meshes': len(self._store.columns.meshes),
            'mortal': int(np.count_nonzero(self._store.columns.expires)),
            'node_handles_left': LAST_NODE_HANDLE - self._store.next_node_handle + 1,
            'narrow_phase': self._store.columns.shaped > 0,
            'pairs_compared': self._store.columns.pairs_compared,
            'pairs_in_more_digits': self._store.columns.pairs_in_more_digits,
            'tree': tree,
        }

    def count(self, mask: int) -> int:
        """Number of obstacles that a query with this mask can see."""
        visible = (self._store.columns.categories & checks.mask(mask)) != 0
        return int(np.count_nonzero(visible & ~self._store.columns.shadow))

    def validate(self) -> None:
        """Raise RuntimeError, saying what is broken, unless tree, names and columns agree."""
        self._store.tree.validate()
        self._validate_names()

    def validate_in_turns(self) -> Iterator[None]:
        """`validate` with pauses; the tree is looked at in another thread, as it was at first."""
        tree = self._store.tree
        room = yield from run_in_thread(tree.room_for_copy)
        copy = tree.copied(room)
        yield
        yield from run_in_thread(tree.validate_copy, copy)
        self._validate_names()

    def _validate_names(self) -> None:
        slots = self._store.columns.used()
        handles = self._store.columns.tree_handle
        if not np.array_equal(np.sort(handles[slots]), self._store.tree.ids()):
            raise RuntimeError('the tree and the columns hold different obstacles')
        slots = slots[~self._store.columns.shadow[slots]]
        if (np.diff(handles[slots]) <= 0).any():
            raise RuntimeError('node handles do not ascend with those of the tree')
        if len(self._store.registry) != len(slots):
            raise RuntimeError(f'{len(self._store.registry)} names for {len(slots)} obstacles')
        astray = slots[self._store.registry.leads_to(slots) != slots]
        if len(astray):
            name = self._store.registry.name(int(astray[0]))
            raise RuntimeError(f'the name {name!r} leads to another obstacle')
        if sum(self._store.groups.by_source().values()) != len(slots):
            raise RuntimeError('the groups count other than the obstacles there are')
