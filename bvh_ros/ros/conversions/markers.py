# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A MarkerArray as one change of the scene: what goes, and what comes."""

from __future__ import annotations

from collections.abc import Callable, Generator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from bvh_ros.ros.conversions import rotations
from bvh_ros.ros.conversions.marker_names import MarkerNames
from bvh_ros.ros.conversions.marker_order import (
    LISTED,
    LISTED_SHAPES,
    MESH,
    NOTHING,
    SINGLE,
    SINGLE_SHAPES,
    TRIANGLES,
    Mask,
    last_of_lists,
    order_of,
    why_not,
)
from bvh_ros.ros.conversions.marker_table import Floats, Integers, MarkerTable
from bvh_ros.ros.conversions.mesh_reading import examined
from bvh_ros.ros.world.frames import FrameError, Transform
from bvh_ros.scene import Block, Families, Mesh, Refusals, ShapeKind, Shapes
from bvh_ros.scene.shapes.shape import FINE, as_shapes, canonicalise

# By marker type.
_KINDS = np.zeros(12, np.uint8)
for _kinds in (SINGLE_SHAPES, LISTED_SHAPES):
    _KINDS[list(_kinds)] = list(_kinds.values())
TOO_FAR_AHEAD = 'its stamp is too far in the future'
AT_A_TIME = 256  # lists or frames between two pauses
ELEMENTS = 8192  # between two pauses
IntoNode = Callable[[str, int], 'Transform | None']


class Change(NamedTuple):
    """What a message asks for. What goes goes first."""

    clears: bool  # everything of the source goes
    namespaces: list[str]  # whose obstacles go
    removed: Families  # who goes, as a single obstacle or as a list
    names: Families  # (n,) who comes or is modified: single ones, and elements of lists
    shapes: Shapes  # (n,)
    stamp: Integers  # (n,) ns
    expires: Integers  # (n,) ns on the node's clock, 0 = never
    lists: dict[str, int]  # list markers, and how many elements each has now
    singles: Families  # those among the names that are no elements
    refusals: Refusals  # the markers that cannot be used


def change(
    table: MarkerTable,
    *,
    now: int,
    into_node: IntoNode,
    latest: int | None = None,
    prefix: str = '',
    planar: bool = False,
) -> Generator[None, None, Change]:
    """Read markers; pause now and then, nothing is changed yet.

    Parameters
    ----------
    now : int
        Time of reception on the node's clock, ns: lifetimes begin here, as in RViz.
    into_node : callable
        From a frame and a stamp to the transform into the node's frame, or None if there is none
        to apply; raises FrameError.
    latest : int, optional
        No later stamp is believed, ns: what such a marker removes stays.
    prefix : str
        Begins every obstacle's name.
    planar : bool
        Whether the scene is.
    """
    reader = _Reader(table, into_node, prefix, planar)
    reader.refuse_later_than(latest)
    order = order_of(table, reader.faulty)
    reader.faulty[order.wish == NOTHING] = True
    good = order.alive.copy()
    yield from reader.find_frames(good)
    yield from reader.make_meshes(np.flatnonzero(good & (order.wish == MESH)))
    yield from reader.read_lists(np.flatnonzero(good & (order.wish == LISTED)))
    good &= ~reader.faulty
    if reader.points:
        bad = reader.bad_singles(good & (order.wish == SINGLE))  # the scene says why
        good = last_of_lists(order, good & ~bad) | bad
    rows = np.flatnonzero(good)
    counts = reader.counts(rows)
    of = np.repeat(rows, counts)
    shapes = yield from reader.shapes(rows, of)
    names, singles, lists = reader.names.with_elements(rows, counts, reader.listed(rows))
    stamp = np.where(table.stamp == 0, now, table.stamp)[of]
    lifetime = table.lifetime[of]
    return Change(
        order.clears,
        [f'{prefix}{table.namespaces[space]}' for space in order.swept.tolist()],
        reader.names.singles(order.removed),
        names,
        shapes,
        stamp,
        np.where(lifetime > 0, lifetime + now, 0),
        lists,
        singles,
        reader.refusals(),
    )


class _Reader:
    """Reads one message, stage by stage."""

    def __init__(self, table: MarkerTable, into_node: IntoNode, prefix: str, planar: bool) -> None:
        self.table = table
        self.into_node = into_node
        self.names = MarkerNames(table, prefix)
        self.planar = planar
        self.faulty = np.zeros(len(table.id), np.bool_)
        self.reasons: dict[int, str] = {}  # of the rows where it is not the type or action
        self.meshes: dict[int, Mesh] = {}
        self.points: dict[int, Floats] = {}  # of lists
        self.moved: Mask | None = None  # rows in other frames
        self.shift = np.zeros((0, 3))
        self.turn = np.zeros((0, 4))

    def refuse(self, row: int, reason: str) -> None:
        self.faulty[row] = True
        self.reasons[row] = reason

    def refuse_later_than(self, latest: int | None) -> None:
        if latest is not None:
            for row in np.flatnonzero(self.table.stamp > latest).tolist():
                self.refuse(row, TOO_FAR_AHEAD)

    def refusals(self) -> Refusals:
        return Refusals(Block(np.flatnonzero(self.faulty), self.names.of, self._reason))

    def find_frames(self, good: Mask) -> Generator[None, None, None]:
        """Look up how markers get into the node's frame; refuse those that cannot."""
        table, rows = self.table, np.flatnonzero(good)
        frame, stamp = table.frame[rows], table.stamp[rows]
        own = np.zeros(len(table.frame_ids), np.bool_)  # whatever the time
        order = np.lexsort((stamp, frame))
        moves = np.ones(len(rows), np.bool_)
        for given in (frame[order], stamp[order]):
            moves[1:] &= given[1:] == given[:-1]
        moves[1:] = ~moves[1:]
        ends = [*moves.nonzero()[0].tolist(), len(rows)]
        for place, (begin, end) in enumerate(pairwise(ends)):
            if place % AT_A_TIME == AT_A_TIME - 1:
                yield
            group = rows[order[begin:end]]  # of one frame and one stamp
            frame_number = int(table.frame[group[0]])
            if own[frame_number]:
                continue
            try:
                transform = self.into_node(
                    table.frame_ids[frame_number], int(table.stamp[group[0]])
                )
            except FrameError as error:
                self.faulty[group] = True
                good[group] = False
                self.reasons.update(dict.fromkeys(group.tolist(), str(error)))
                continue
            if transform is None:
                own[frame_number] = True
            else:
                self._note_transform(group, transform)

    def _note_transform(self, rows: Integers, transform: Transform) -> None:
        if self.moved is None:
            count = len(self.faulty)
            self.moved = np.zeros(count, np.bool_)
            self.shift, self.turn = np.zeros((count, 3)), np.zeros((count, 4))
        self.moved[rows] = True
        self.shift[rows], self.turn[rows] = transform.translation, transform.rotation

    def make_meshes(self, rows: Integers) -> Generator[None, None, None]:
        """Examine lists of triangles, three points each; scale multiplies them."""
        for row in rows.tolist():
            points = self.table.points(row) * self.table.scale[row]
            if len(points) % 3 or not len(points):
                self.refuse(row, f'{len(points)} points are not triangles')
                continue
            try:
                triangles = points.reshape(-1, 3, 3)
                self.meshes[row] = yield from examined(triangles, self.planar)
            except ValueError as error:
                self.refuse(row, str(error))
                yield

    def read_lists(self, rows: Integers) -> Generator[None, None, None]:
        """Find the points of list markers."""
        if not len(rows):
            return
        table = self.table
        given = np.hstack((table.position[rows], table.orientation[rows], table.scale[rows]))
        finite = np.isfinite(given).all(axis=1)
        for row in rows[~finite].tolist():
            self.refuse(row, 'pose or scale of the list is not finite')
        for number, row in enumerate(rows[finite].tolist()):
            self.points[row] = table.points(row)
            if number % AT_A_TIME == AT_A_TIME - 1:
                yield

    def bad_singles(self, which: Mask) -> Mask:
        """Which single markers the scene would refuse for their shapes."""
        rows, table = np.flatnonzero(which), self.table
        given = table.position[rows], table.orientation[rows], table.scale[rows]
        bad = np.zeros(len(which), np.bool_)
        bad[rows] = (
            canonicalise(as_shapes(Shapes(_KINDS[table.type[rows]], *given))).faults != FINE
        )
        return bad

    def listed(self, rows: Integers) -> Mask:
        """Which of these are lists."""
        if not self.points:
            return np.zeros(len(rows), np.bool_)
        return np.array([row in self.points for row in rows.tolist()], np.bool_)

    def counts(self, rows: Integers) -> Integers:
        """How many obstacles each marker is."""
        if not self.points:
            return np.ones(len(rows), np.int64)
        found = (len(self.points[row]) if row in self.points else 1 for row in rows.tolist())
        return np.fromiter(found, np.int64, len(rows))

    def shapes(self, rows: Integers, of: Integers) -> Generator[None, None, Shapes]:
        """Obstacles in the node's frame; `of` is the marker that each comes from."""
        shapes = yield from self._placed(rows, of)
        if self.meshes:
            held = np.empty(len(of), object)
            for at in np.flatnonzero(self.table.type[of] == TRIANGLES).tolist():
                held[at] = mesh = self.meshes[int(of[at])]
                shapes.kind[at], shapes.size[at] = ShapeKind.MESH, mesh.size
            shapes = shapes._replace(mesh=held)
        if self.moved is not None:
            yield from self._move(shapes, of)
        return shapes

    def _placed(self, rows: Integers, of: Integers) -> Generator[None, None, Shapes]:
        """The shapes in their markers' frames; elements of lists at their points."""
        table, count, done = self.table, len(of), 0
        position, turn, size = (np.empty((count, width)) for width in (3, 4, 3))
        points = [self.points[row] for row in rows.tolist() if row in self.points]
        local = np.concatenate(points) if points else position[:0]
        for begin in range(0, count, ELEMENTS):
            if begin:
                yield
            some = slice(begin, begin + ELEMENTS)
            marker = of[some]
            position[some], size[some] = table.position[marker], table.scale[marker]
            turn[some] = table.orientation[marker]
            if done == len(local):
                continue
            place = begin + np.flatnonzero(np.isin(table.type[marker], list(LISTED_SHAPES)))
            turn[place] = rotations.normalised(turn[place])
            position[place] += rotations.rotate(turn[place], local[done : done + len(place)])
            done += len(place)
        return Shapes(_KINDS[table.type[of]], position, turn, size)

    def _move(self, shapes: Shapes, of: Integers) -> Generator[None, None, None]:
        """Bring what stands in other frames into the node's."""
        elsewhere = np.flatnonzero(self.moved[of]) if self.moved is not None else of[:0]
        for begin in range(0, len(elsewhere), ELEMENTS):
            yield
            place = elsewhere[begin : begin + ELEMENTS]
            marker = of[place]
            move = Transform(self.shift[marker], self.turn[marker])
            shapes.position[place] = move.points(shapes.position[place])
            shapes.orientation[place] = move.orientations(shapes.orientation[place])

    def _reason(self, row: int) -> str:
        if row in self.reasons:
            return self.reasons[row]
        return why_not(self.table, row)


def moved(shapes: Shapes, transform: Transform | None) -> Shapes:
    """Return the shapes in the node's frame."""
    if transform is None:
        return shapes
    return shapes._replace(
        position=transform.points(shapes.position),
        orientation=transform.orientations(shapes.orientation),
    )
