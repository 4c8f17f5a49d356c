# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A MarkerArray as a list of steps on the scene, many markers a step."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.conversions import rotations
from bvh_ros.ros.conversions.marker_table import Integers, MarkerTable
from bvh_ros.ros.frames import FrameError, Transform
from bvh_ros.scene import Families, Refusal, ShapeKind, Shapes, mesh_of

# visualization_msgs/msg/Marker
ADD_OR_MODIFY, DELETE, DELETE_ALL = 0, 2, 3
SINGLE_SHAPES = {1: ShapeKind.BOX, 2: ShapeKind.SPHERE, 3: ShapeKind.CYLINDER}
LISTED_SHAPES = {6: ShapeKind.BOX, 7: ShapeKind.SPHERE}
TRIANGLES = 11
TYPE_NAMES = (
    *('ARROW', 'CUBE', 'SPHERE', 'CYLINDER', 'LINE_STRIP', 'LINE_LIST', 'CUBE_LIST'),
    *('SPHERE_LIST', 'POINTS', 'TEXT_VIEW_FACING', 'MESH_RESOURCE', 'TRIANGLE_LIST'),
    'ARROW_STRIP',
)
# By marker type.
_KINDS = np.zeros(max(SINGLE_SHAPES) + 1, np.uint8)
_KINDS[list(SINGLE_SHAPES)] = list(SINGLE_SHAPES.values())
IntoNode = Callable[[str, int], 'Transform | None']


class Update(NamedTuple):
    """Add these obstacles, or modify those that exist."""

    names: Families
    shapes: Shapes
    stamp: Integers  # (n,) ns
    expires: Integers  # (n,) ns on the node's clock, 0 = never


class ReplaceList(NamedTuple):
    """The elements `name#0`, `name#1`, ... of a list marker replace its former ones."""

    name: str
    shapes: Shapes
    stamp: int
    expires: int


class Delete(NamedTuple):
    """Remove these obstacles, and the elements of these list markers."""

    names: Families


class DeleteAll(NamedTuple):
    """Remove a namespace, or everything of the source if it is None."""

    namespace: str | None


Step = Update | ReplaceList | Delete | DeleteAll

# What a row asks for; consecutive rows of the first two become one step.
SINGLE, REMOVAL, LISTED, MESH, SWEEP, NOTHING = range(6)


class Reading(NamedTuple):
    """A message, understood."""

    steps: list[Step]
    refusals: list[Refusal]


def steps(table: MarkerTable, *, now: int, into_node: IntoNode, prefix: str = '') -> Reading:
    """Read markers in order.

    Consecutive markers that are added, or deleted, become one step, so that thousands of them go
    down as arrays.

    Parameters
    ----------
    table : MarkerTable
    now : int
        Time of reception on the node's clock, ns: lifetimes begin here, as in RViz.
    into_node : callable
        From a frame and a stamp to the transform into the node's frame, or None if there is none
        to apply; raises FrameError.
    prefix : str
        Begins every obstacle's name.

    Returns
    -------
    Reading
        What to do, in order, and the markers that cannot be used.
    """
    reader = _Reader(table, now, into_node, prefix)
    wish = reader.wishes()
    rows = np.flatnonzero(wish != NOTHING)
    wish = wish[rows]
    begins = np.flatnonzero(np.diff(wish, prepend=NOTHING) | (wish > REMOVAL)).tolist()
    for begin, end in pairwise([*begins, len(rows)]):
        reader.read(int(wish[begin]), rows[begin:end])
    return Reading(reader.steps, sorted(reader.refusals))


class _Reader:
    def __init__(self, table: MarkerTable, now: int, into_node: IntoNode, prefix: str) -> None:
        self.table = table
        self.into_node = into_node
        self.prefix = prefix
        self.stamps = np.where(table.stamp == 0, now, table.stamp)
        self.expires = np.where(table.lifetime > 0, table.lifetime + now, 0)
        self.steps: list[Step] = []
        self.refusals: list[Refusal] = []

    def wishes(self) -> Integers:
        """What each row asks for; NOTHING where that cannot be, which is refused."""
        kind, action = self.table.type, self.table.action
        wish = np.full(len(kind), NOTHING)
        add = action == ADD_OR_MODIFY
        wish[add & np.isin(kind, list(SINGLE_SHAPES))] = SINGLE
        wish[add & np.isin(kind, list(LISTED_SHAPES))] = LISTED
        wish[add & (kind == TRIANGLES)] = MESH
        wish[action == DELETE] = REMOVAL
        wish[action == DELETE_ALL] = SWEEP
        for row in np.flatnonzero(wish == NOTHING).tolist():
            self._refuse(row, self._fault(int(kind[row]), int(action[row])))
        brief = add & (wish != NOTHING) & (self.table.lifetime < 0)
        for row in np.flatnonzero(brief).tolist():
            self._refuse(row, f'negative lifetime {self.table.lifetime[row] / 1e9:g} s')
        wish[brief] = NOTHING
        return wish

    def read(self, wish: int, rows: Integers) -> None:
        """Turn consecutive rows that ask for the same into a step."""
        if wish == SINGLE:
            self._update(rows)
        elif wish == REMOVAL:
            self.steps.append(Delete(self._names(rows)))
        elif wish == LISTED:
            self._list(int(rows[0]))
        elif wish == MESH:
            self._mesh(rows)
        else:
            namespace = self.table.namespaces[self.table.namespace[rows[0]]]
            self.steps.append(DeleteAll(self.prefix + namespace if namespace else None))

    def _update(self, rows: Integers) -> None:
        table = self.table
        kind = _KINDS[table.type[rows]]
        size = table.scale[rows]
        self._place(rows, Shapes(kind, table.position[rows], table.orientation[rows], size))

    def _mesh(self, rows: Integers) -> None:
        """The triangles of one marker, three points each; scale multiplies them."""
        row, table = int(rows[0]), self.table
        points = table.points(row) * table.scale[row]
        if len(points) % 3 or not len(points):
            self._refuse(row, f'{len(points)} points are not triangles')
            return
        try:
            mesh = mesh_of(points.reshape(-1, 3, 3))
        except ValueError as error:
            self._refuse(row, str(error))
            return
        self._place(rows, Shapes.of_meshes([mesh], table.position[rows], table.orientation[rows]))

    def _place(self, rows: Integers, shapes: Shapes) -> None:
        """Make a step of shapes that are given in the frames of their markers."""
        known = self._into_node(rows, shapes)
        if not known.all():
            rows, shapes = rows[known], shapes.take(known)
        if len(rows):
            names = self._names(rows)
            self.steps.append(Update(names, shapes, self.stamps[rows], self.expires[rows]))

    def _into_node(self, rows: Integers, shapes: Shapes) -> NDArray[np.bool_]:
        """Bring shapes into the node's frame; which of them are there, the others are refused."""
        frame, stamp = self.table.frame[rows], self.table.stamp[rows]
        known = np.ones(len(rows), np.bool_)
        own = set()
        order = np.lexsort((stamp, frame))
        moves = np.diff(frame[order], prepend=-1) | np.diff(stamp[order], prepend=0)
        for begin, end in pairwise([*np.flatnonzero(moves).tolist(), len(rows)]):
            group = order[begin:end]  # of one frame and one stamp
            number, first = int(frame[group[0]]), int(stamp[group[0]])
            if number in own:
                continue
            try:
                transform = self.into_node(self.table.frame_ids[number], first)
            except FrameError as error:
                known[group] = False
                for row in rows[group].tolist():
                    self._refuse(row, str(error))
                continue
            if transform is None:  # whatever the time
                own.add(number)
                continue
            shapes.position[group] = transform.points(shapes.position[group])
            shapes.orientation[group] = transform.orientations(shapes.orientation[group])
        return known

    def _list(self, row: int) -> None:
        table = self.table
        shared, size = table.position[row], table.scale[row]
        if not all(np.isfinite(x).all() for x in (shared, table.orientation[row], size)):
            self._refuse(row, 'pose or scale of the list is not finite')
            return
        try:
            transform = self.into_node(table.frame_ids[table.frame[row]], int(table.stamp[row]))
        except FrameError as error:
            self._refuse(row, str(error))
            return
        points = table.points(row)
        turn = rotations.normalised(table.orientation[row])
        n = len(points)
        shapes = Shapes(
            np.full(n, LISTED_SHAPES[int(table.type[row])], dtype=np.uint8),
            rotations.rotate(turn, points) + shared,
            np.tile(turn, (n, 1)),
            np.tile(size, (n, 1)),
        )
        stamp, expires = int(self.stamps[row]), int(self.expires[row])
        self.steps.append(ReplaceList(self._name(row), moved(shapes, transform), stamp, expires))

    def _names(self, rows: Integers) -> Families:
        """Two families a namespace: `ns/` and, for negative ids, `ns/-`."""
        table, number = self.table, self.table.id[rows]
        used, place = np.unique(table.namespace[rows], return_inverse=True)
        spaces = [f'{self.prefix}{table.namespaces[space]}/' for space in used.tolist()]
        prefixes = [spaces[i // 2] + '-' * (i % 2) for i in range(2 * len(spaces))]
        return Families(prefixes, 2 * place + (number < 0), np.abs(number))

    def _name(self, row: int) -> str:
        namespace = self.table.namespaces[self.table.namespace[row]]
        return f'{self.prefix}{namespace}/{self.table.id[row]}'

    def _refuse(self, row: int, reason: str) -> None:
        self.refusals.append(Refusal(row, self._name(row), reason))

    @staticmethod
    def _fault(kind: int, action: int) -> str:
        if action != ADD_OR_MODIFY:
            return f'unknown marker action {action}'
        type_name = TYPE_NAMES[kind] if 0 <= kind < len(TYPE_NAMES) else 'unknown'
        return (
            f'marker type {kind} ({type_name}) is not a box, sphere, cylinder or list of triangles'
        )


def moved(shapes: Shapes, transform: Transform | None) -> Shapes:
    """Return the shapes in the node's frame."""
    if transform is None:
        return shapes
    return shapes._replace(
        position=transform.points(shapes.position),
        orientation=transform.orientations(shapes.orientation),
    )
