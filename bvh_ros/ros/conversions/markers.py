# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A MarkerArray as a list of steps on the scene, many markers a step."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.conversions import rotations
from bvh_ros.ros.frames import FrameError, Transform
from bvh_ros.scene import Refusal, ShapeKind, Shapes

# visualization_msgs/msg/Marker
ADD_OR_MODIFY, DELETE, DELETE_ALL = 0, 2, 3
SINGLE_SHAPES = {1: ShapeKind.BOX, 2: ShapeKind.SPHERE, 3: ShapeKind.CYLINDER}
LISTED_SHAPES = {6: ShapeKind.BOX, 7: ShapeKind.SPHERE}
TYPE_NAMES = (
    *('ARROW', 'CUBE', 'SPHERE', 'CYLINDER', 'LINE_STRIP', 'LINE_LIST', 'CUBE_LIST'),
    *('SPHERE_LIST', 'POINTS', 'TEXT_VIEW_FACING', 'MESH_RESOURCE', 'TRIANGLE_LIST'),
    'ARROW_STRIP',
)


class Update(NamedTuple):
    """Add these obstacles, or modify those that exist."""

    names: list[str]
    shapes: Shapes
    stamp: int  # ns
    expires: NDArray[np.int64]  # (n,) ns on the node's clock, 0 = never


class ReplaceList(NamedTuple):
    """The elements `name#0`, `name#1`, ... of a list marker replace its former ones."""

    name: str
    shapes: Shapes
    stamp: int
    expires: int


class Delete(NamedTuple):
    """Remove these obstacles, and the elements of these list markers."""

    names: list[str]


class DeleteAll(NamedTuple):
    """Remove a namespace, or everything of the source if it is None."""

    namespace: str | None


Step = Update | ReplaceList | Delete | DeleteAll


class Reading(NamedTuple):
    """A message, understood."""

    steps: list[Step]
    refusals: list[Refusal]


def steps(
    markers: Iterable[Any],
    *,
    now: int,
    into_node: Callable[[str, int], Transform | None],
    prefix: str = '',
) -> Reading:
    """Read markers in order.

    Consecutive markers of one kind, frame and stamp become one step, so that thousands of them go
    down as arrays.

    Parameters
    ----------
    markers : iterable of visualization_msgs/Marker
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
    reader = _Reader(now, into_node, prefix)
    for row, marker in enumerate(markers):
        reader.read(row, marker)
    reader.end_run()
    return Reading(reader.steps, reader.refusals)


class _Reader:
    """Collects markers of one kind, frame and stamp into a run until something else comes."""

    def __init__(
        self, now: int, into_node: Callable[[str, int], Transform | None], prefix: str
    ) -> None:
        self.now = now
        self.into_node = into_node
        self.prefix = prefix
        self.steps: list[Step] = []
        self.refusals: list[Refusal] = []
        self._frame: tuple[str, int] = ('', 0)
        self._first_row = 0
        self._rows: dict[str, tuple[float, ...]] = {}  # by name: a name twice ends the run

    def read(self, row: int, marker: Any) -> None:
        namespace = self.prefix + marker.ns
        name = f'{namespace}/{marker.id}'
        action = marker.action
        if action == ADD_OR_MODIFY:
            reason = self._add(row, name, marker)
            if reason:
                self.refusals.append(Refusal(row, name, reason))
        elif action == DELETE:
            self.end_run()
            if self.steps and isinstance(self.steps[-1], Delete):
                self.steps[-1].names.append(name)
            else:
                self.steps.append(Delete([name]))
        elif action == DELETE_ALL:
            self.end_run()
            self.steps.append(DeleteAll(namespace if marker.ns else None))
        else:
            self.refusals.append(Refusal(row, name, f'unknown marker action {action}'))

    def _add(self, row: int, name: str, marker: Any) -> str | None:
        """Take one marker in; return why not."""
        lifetime = nanoseconds(marker.lifetime)
        if lifetime < 0:
            return f'negative lifetime {lifetime / 1e9:g} s'
        expires = self.now + lifetime if lifetime else 0
        kind = SINGLE_SHAPES.get(marker.type)
        if kind is not None:
            self._single(row, name, kind, marker, expires)
            return None
        kind = LISTED_SHAPES.get(marker.type)
        if kind is not None:
            self.end_run()
            return self._list(name, kind, marker, expires)
        known = 0 <= marker.type < len(TYPE_NAMES)
        type_name = TYPE_NAMES[marker.type] if known else 'unknown'
        return f'marker type {marker.type} ({type_name}) is not a box, sphere or cylinder'

    def _single(self, row: int, name: str, kind: ShapeKind, marker: Any, expires: int) -> None:
        header = marker.header
        frame = (header.frame_id, nanoseconds(header.stamp))
        if frame != self._frame or name in self._rows:
            self.end_run()
            self._frame = frame
        if not self._rows:
            self._first_row = row
        at, turned, scale = marker.pose.position, marker.pose.orientation, marker.scale
        self._rows[name] = (
            *(at.x, at.y, at.z, turned.x, turned.y, turned.z, turned.w),
            *(scale.x, scale.y, scale.z, kind, expires),
        )

    def end_run(self) -> None:
        """Turn the collected markers into one step."""
        if not self._rows:
            return
        rows, self._rows = self._rows, {}
        names = list(rows)
        table = np.array([row[:11] for row in rows.values()], dtype=np.float64)
        # Times in ns do not fit a double: they travel beside the table.
        expires = np.array([row[11] for row in rows.values()], dtype=np.int64)
        shapes = Shapes(table[:, 10].astype(np.uint8), table[:, :3], table[:, 3:7], table[:, 7:10])
        try:
            shapes = moved(shapes, self.into_node(*self._frame))
        except FrameError as error:
            first = self._first_row
            self.refusals += [Refusal(first + i, n, str(error)) for i, n in enumerate(names)]
            return
        self.steps.append(Update(names, shapes, self._frame[1] or self.now, expires))

    def _list(self, name: str, kind: ShapeKind, marker: Any, expires: int) -> str | None:
        at, turned, scale = marker.pose.position, marker.pose.orientation, marker.scale
        shared = (at.x, at.y, at.z, turned.x, turned.y, turned.z, turned.w)
        size = (scale.x, scale.y, scale.z)
        if not all(map(math.isfinite, (*shared, *size))):
            return 'pose or scale of the list is not finite'
        stamp = nanoseconds(marker.header.stamp)
        try:
            transform = self.into_node(marker.header.frame_id, stamp)
        except FrameError as error:
            return str(error)
        points = np.array([(p.x, p.y, p.z) for p in marker.points], dtype=np.float64)
        points = points.reshape(-1, 3)
        turn = rotations.normalised(shared[3:])
        n = len(points)
        shapes = Shapes(
            np.full(n, kind, dtype=np.uint8),
            rotations.rotate(turn, points) + shared[:3],
            np.tile(turn, (n, 1)),
            np.tile(size, (n, 1)),
        )
        self.steps.append(ReplaceList(name, moved(shapes, transform), stamp or self.now, expires))
        return None


def moved(shapes: Shapes, transform: Transform | None) -> Shapes:
    """Return the shapes in the node's frame."""
    if transform is None:
        return shapes
    return shapes._replace(
        position=transform.points(shapes.position),
        orientation=transform.orientations(shapes.orientation),
    )


def nanoseconds(time: Any) -> int:
    """Return a builtin_interfaces Time or Duration in ns."""
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)
