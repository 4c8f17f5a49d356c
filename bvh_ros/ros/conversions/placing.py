# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What all messages of obstacles need: names of parts, rows of shapes, meshes of triangles, frames
of rows.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.world.frames import FrameError, Transform
from bvh_ros.scene import Families, Mesh, ShapeKind, Shapes, mesh_of, unchecked_shapes
from bvh_ros.scene.store import run_in_thread

# ---- Names of obstacles that are numbered parts of something


NOTHING = Families([], np.empty(0, np.int64), np.empty(0, np.int64))


def numbered(spans: Mapping[str, range], after: Families = NOTHING) -> Families:
    """Names that begin with these texts and end in these numbers, after other names."""
    spans = {prefix: span for prefix, span in spans.items() if span}
    if not spans:
        return after
    first = len(after.prefixes)
    family = np.repeat(np.arange(first, first + len(spans)), [len(s) for s in spans.values()])
    numbers = [np.arange(span.start, span.stop) for span in spans.values()]
    return Families(
        [*after.prefixes, *spans],
        np.concatenate((after.family, family)),
        np.concatenate((after.numbers, *numbers)),
    )


# ---- Rows of shapes


Floats = NDArray[np.float64]


def alike(kind: ShapeKind, position: Floats, orientation: Floats, size: Floats) -> Shapes:
    """Rows of one kind, which may be no legal shapes."""
    return unchecked_shapes(np.full(len(position), kind, np.uint8), position, orientation, size)


def joined(several: Sequence[Shapes]) -> Shapes:
    """All rows, one after another."""
    first = [shapes[:4] for shapes in several]
    columns: list[Any] = [np.concatenate(column) for column in zip(*first, strict=True)]
    if any(shapes.mesh is not None for shapes in several):
        meshes = [np.full(len(s.kind), None) if s.mesh is None else s.mesh for s in several]
        columns.append(np.concatenate(meshes))
    return unchecked_shapes(*columns)


def moved(shapes: Shapes, transform: Transform | None) -> Shapes:
    """Return the shapes in the node's frame."""
    if transform is None:
        return shapes
    return shapes._replace(
        position=transform.points(shapes.position),
        orientation=transform.orientations(shapes.orientation),
    )


# ---- Triangles to meshes, while others have their turn


MANY_TRIANGLES = 500  # triangles: more take longer than 10 ms


def examined(
    triangles: NDArray[np.float64], planar: bool, form: str
) -> Generator[None, None, Mesh]:
    """Make a mesh of triangles (n, 3, 3) and all that a scene needs of it; pause now and then.

    A large one takes a second, most of it in numpy, so another thread examines it.

    Raises
    ------
    ValueError
        If they are no mesh of that form, as of `mesh_of`.
    """
    if len(triangles) <= MANY_TRIANGLES:
        mesh = _examine(triangles, planar, form)
        yield
        return mesh
    return (yield from run_in_thread(_examine, triangles, planar, form))


def _examine(triangles: NDArray[np.float64], planar: bool, form: str) -> Mesh:
    mesh = mesh_of(triangles, form)
    # Each is made when it is first read, and stays.
    _ = mesh.reaches
    if planar:
        _ = mesh.outline if mesh.convex else mesh.shadow
    else:
        _ = mesh.tree, mesh.discs, mesh.seeds
    return mesh


# ---- Frames of rows


Integers = NDArray[np.int64]
IntoNode = Callable[[str, int], 'Transform | None']
AT_A_TIME = 256  # frames between two pauses
ELEMENTS = 8192  # between two pauses


class Placing:
    """How rows get into the node's frame. Rows of one frame and one stamp are looked up once.

    Parameters
    ----------
    frame_ids : sequence of str
        The different ones.
    frame, stamp : (n,) int64 arrays
        For each row which of them it names, and when, ns.
    into_node : callable
        From a frame and a stamp to the transform into the node's frame, or None if there is none
        to apply; raises FrameError.
    """

    def __init__(
        self, frame_ids: Sequence[str], frame: Integers, stamp: Integers, into_node: IntoNode
    ) -> None:
        self._frame_ids, self._frame, self._stamp = frame_ids, frame, stamp
        self._into_node = into_node
        self._moved: NDArray[np.bool_] | None = None  # rows in other frames
        self._shift = np.zeros((0, 3))
        self._turn = np.zeros((0, 4))

    def find(self, rows: Integers) -> Generator[None, None, dict[int, str]]:
        """Look up how these rows get there; return why some cannot. Pauses now and then."""
        reasons: dict[int, str] = {}
        frame, stamp = self._frame[rows], self._stamp[rows]
        own = np.zeros(len(self._frame_ids), np.bool_)  # whatever the time
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
            number = int(self._frame[group[0]])
            if own[number]:
                continue
            try:
                transform = self._into_node(self._frame_ids[number], int(self._stamp[group[0]]))
            except FrameError as error:
                reasons.update(dict.fromkeys(group.tolist(), str(error)))
                continue
            if transform is None:
                own[number] = True
            else:
                self._note(group, transform)
        return reasons

    def _note(self, rows: Integers, transform: Transform) -> None:
        if self._moved is None:
            count = len(self._frame)
            self._moved = np.zeros(count, np.bool_)
            self._shift, self._turn = np.zeros((count, 3)), np.zeros((count, 4))
        self._moved[rows] = True
        self._shift[rows], self._turn[rows] = transform.translation, transform.rotation

    def move(self, shapes: Shapes, of: Integers) -> Generator[None, None, None]:
        """Bring shapes into the node's frame, in place; `of` is the row that each comes from."""
        if self._moved is None:
            return
        elsewhere = np.flatnonzero(self._moved[of])
        for begin in range(0, len(elsewhere), ELEMENTS):
            yield
            place = elsewhere[begin : begin + ELEMENTS]
            row = of[place]
            move = Transform(self._shift[row], self._turn[row])
            shapes.position[place] = move.points(shapes.position[place])
            shapes.orientation[place] = move.orientations(shapes.orientation[place])
