# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the scene returns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from ..tree.access import shown_point, shown_rows
from .shapes.lazy import LazyProperty
from .shapes.shape import Floats, ShapeKind

# ---- What the scene returns.

NO_NODE = 0xFFFFFFFF  # instead of a node handle: nothing is hit
LAST_NODE_HANDLE = 2**31 - 1


class TooManyHitsError(ValueError):
    """More obstacles are hit than the caller allows."""


def require_few(count: int, most: int | None) -> None:
    """Raise TooManyHitsError if there are more than `most`; None is no limit."""
    if most is not None and count > most:
        raise TooManyHitsError(f'there may be {count} hits, more than {most}')


class _Hit(NamedTuple):
    name: str
    handle: int
    """Node handle, 1 to 2^31 - 1, not reused while the scene lives."""
    t: float
    """Rays: 0 at the start, 1 at the goal. Overlaps and nearest: distance of `point` from the
    query's centre, m.
    """
    point: NDArray[np.float64]
    """Shape (3,), m: where a ray meets the obstacle or a swept ball touches it.

    For overlaps its point closest to the centre.
    """
    normal: NDArray[np.float64]
    """Shape (3,), outward; zero where the query starts (for overlaps: has its centre) in the
    obstacle.
    """
    stamp: int
    """Last update of the obstacle, ns."""


class SceneHit(_Hit):
    """An obstacle that a query meets.

    As a tuple it has six fields, name to stamp. A thin ray that enters a mesh meets a triangle,
    too. Any other hit has none: that of another shape, of a swept ball, of an overlap or a nearest
    obstacle, of a ray that starts on a triangle or in the solid, and every hit in a planar scene.
    """

    _triangle: Floats | None = None  # row, u and v of the triangle; None: there is none

    @property
    def triangle(self) -> int:
        """Row of the triangle that is met, in the mesh as it was given; -1 without any.

        On an edge or corner of several triangles it is the lowest row of theirs.
        """
        return -1 if self._triangle is None else int(self._triangle[0])

    @property
    def uv(self) -> Floats:
        """Shape (2,): where in the triangle the point is, as Embree has it; NaN without one.

        The point is ``(1 - u - v) * a + u * b + v * c``. a, b and c are the triangle's corners, in
        the order as given, where the mesh stands. u, v and u + v are from 0 to 1.
        """
        return np.full(2, np.nan) if self._triangle is None else self._triangle[1:]

    def _replace(self, **fields: Any) -> SceneHit:
        hit = super()._replace(**fields)
        hit._triangle = self._triangle
        return hit

    def __repr__(self) -> str:
        triangle = self.triangle
        more = '' if triangle < 0 else f', triangle={triangle}, uv={shown_point(self.uv)}'
        return (
            f'SceneHit({self.name!r}, t={self.t:.6g}, point={shown_point(self.point)}, '
            f'normal={shown_point(self.normal)}, handle={self.handle}, stamp={self.stamp}{more})'
        )


class _Casts(NamedTuple):
    handles: NDArray[np.uint32]
    """(n,) node handles, NO_NODE (0xFFFFFFFF) where the way is free."""
    t: NDArray[np.float64]
    """(n,) from 0 at the start to 1 at the goal; inf where the way is free."""
    points: NDArray[np.float64]
    """(n, 3), m: on the obstacles; NaN where the way is free."""
    normals: NDArray[np.float64]
    """(n, 3) outward; zero where the way is free, or begins in the obstacle."""


class CastHits(_Casts):
    """The first obstacles on n ways.

    As a tuple it has four fields: handles, t, points and normals.
    """

    _triangles: Floats | None = None  # (n, 3) row, u and v of triangles; None: there are none

    @LazyProperty
    def triangles(self) -> NDArray[np.int64]:
        """(n,) rows of triangles, as `SceneHit.triangle`; -1 where a way is free, too."""
        if self._triangles is None:
            return np.full(len(self.handles), -1)
        return self._triangles[:, 0].astype(np.int64)

    @LazyProperty
    def uv(self) -> Floats:
        """(n, 2) as `SceneHit.uv`; NaN where the triangle is -1."""
        if self._triangles is None:
            return np.full((len(self.handles), 2), np.nan)
        return np.ascontiguousarray(self._triangles[:, 1:])

    def _replace(self, **fields: Any) -> CastHits:
        return cast_hits(super()._replace(**fields), self._triangles)

    def __repr__(self) -> str:
        return shown_rows('CastHits', self.handles != NO_NODE, 'rays hit', 't', self.t)


def cast_hits(columns: Any, triangles: Floats | None) -> CastHits:
    """Hits of four columns, and the triangles (n, 3) that are met: row, u, v; None: none."""
    # As CastHits(...), which would take one more call of a function of Python's.
    hits = tuple.__new__(CastHits, columns)
    if triangles is not None:
        hits._triangles = triangles
    return hits


def joined_hits(parts: Sequence[CastHits]) -> CastHits:
    """Hits one after the other; all or none of them have triangles."""
    triangles = (
        None
        if parts[0]._triangles is None
        else np.concatenate([part._triangles for part in parts])
    )
    return cast_hits([np.concatenate(column) for column in zip(*parts, strict=True)], triangles)


class ShapeSweeps(NamedTuple):
    """The first obstacles on n ways of a shape that may turn."""

    handles: NDArray[np.uint32]
    """(n,) node handles, NO_NODE (0xFFFFFFFF) where the way is free."""
    t: NDArray[np.float64]
    """(n,) from 0 at the start to 1 at the goal: where the shape touches the obstacle, or is not
    farther from it than the resolution; inf where the way is free."""
    free_until: NDArray[np.float64]
    """(n,) up to there it is certain that the shape touches nothing; inf where the way is free."""
    points: NDArray[np.float64]
    """(n, 3), m: the obstacle's closest point then; NaN where the way is free."""
    normals: NDArray[np.float64]
    """(n, 3) from there to the shape; zero where the way is free, or they overlap at the start."""

    def __repr__(self) -> str:
        return shown_rows('ShapeSweeps', self.handles != NO_NODE, 'sweeps hit', 't', self.t)


class BoxHits(NamedTuple):
    """What touches n boxes: how many obstacles, and the first of each."""

    handles: NDArray[np.uint32]
    """(n,) node handles of those nearest to the centres, NO_NODE (0xFFFFFFFF) where there is
    none.
    """
    counts: NDArray[np.int64]
    """(n,) how many there are."""
    distances: NDArray[np.float64]
    """(n,) of the first one's closest point from the centre, m; inf where there is none."""
    points: NDArray[np.float64]
    """(n, 3) that point, m; NaN where there is none."""

    def __repr__(self) -> str:
        touched = self.handles != NO_NODE
        return shown_rows('BoxHits', touched, 'boxes touched', 'distances', self.distances)


class NearestObstacles(NamedTuple):
    """The obstacles nearest to n points, at most k of each, nearest first."""

    handles: NDArray[np.uint32]
    """(n, k) node handles, then NO_NODE (0xFFFFFFFF)."""
    distances: NDArray[np.float64]
    """(n, k), m; then inf."""
    points: NDArray[np.float64]
    """(n, k, 3), m: the obstacles' points closest to the given ones; then NaN."""

    def __repr__(self) -> str:
        found = (self.handles != NO_NODE).any(axis=1)
        nearest = self.distances[:, :1].ravel()
        return shown_rows('NearestObstacles', found, 'points near one', 'distances', nearest)


class Clearances(NamedTuple):
    """How far n shapes are from the nearest obstacle."""

    handles: NDArray[np.uint32]
    """(n,) node handles, NO_NODE (0xFFFFFFFF) where there is no obstacle."""
    distances: NDArray[np.float64]
    """(n,), m: 0 where they touch, or minus the depth; inf where there is none."""
    points: NDArray[np.float64]
    """(n, 3), m: the shape's point that is closest to the obstacle; NaN where there is none."""
    other_points: NDArray[np.float64]
    """(n, 3), m: the obstacle's."""

    def __repr__(self) -> str:
        found = self.handles != NO_NODE
        return shown_rows('Clearances', found, 'shapes near one', 'distances', self.distances)


class Clearance(NamedTuple):
    """How far an obstacle is from the nearest other one."""

    distance: float
    """m; 0 if they touch."""
    name: str
    """Of the other obstacle."""
    handle: int
    """Node handle of the other."""
    point: NDArray[np.float64]
    """Shape (3,), m: the point of the obstacle that is closest to the other; of both if they
    touch.
    """
    other_point: NDArray[np.float64]
    """Shape (3,), m: the point of the other that is closest."""

    def __repr__(self) -> str:
        return (
            f'Clearance({self.name!r}, distance={self.distance:.6g}, '
            f'point={shown_point(self.point)}, other_point={shown_point(self.other_point)}, '
            f'handle={self.handle})'
        )


class Obstacle(NamedTuple):
    """What the scene knows of one obstacle.

    A box turned by right angles is kept as the same box unturned.
    """

    name: str
    handle: int
    kind: ShapeKind
    position: NDArray[np.float64]
    orientation: NDArray[np.float64]
    size: NDArray[np.float64]
    stamp: int
    expires: int
    source: str
    group: str

    def __repr__(self) -> str:
        turn = (
            '' if self.orientation[3] == 1.0 else f'orientation={shown_point(self.orientation)}, '
        )
        return (
            f'Obstacle({self.name!r}, {self.kind.name}, position={shown_point(self.position)}, '
            f'{turn}size={shown_point(self.size)}, source={self.source!r}, '
            f'handle={self.handle}, stamp={self.stamp})'
        )


# ---- Which rows of an update are refused, and why.
#
# A message may have millions of rows, all of them bad. So a refused row is a number in an array,
# and becomes a Python object only when it is read.


FINE = 0  # instead of the number of a reason


class Refusal(NamedTuple):
    """A row that was not taken over; the obstacle of that name, if any, is as before."""

    row: int
    name: str
    reason: str


class Block(NamedTuple):
    """Refused rows of one part of a message."""

    rows: NDArray[np.int64]  # ascending, within the part
    name: Callable[[int], str]  # of a row of the part
    reason: Callable[[int], str]
    first: int = 0  # number of the part's first row in the message

    def refusal(self, place: int) -> Refusal:
        """One of them."""
        row = int(self.rows[place])
        return Refusal(self.first + row, self.name(row), self.reason(row))


class Refusals(Sequence[Refusal]):
    """Refused rows in order; each is made when it is read. Equal to a list of the same."""

    def __init__(self, *blocks: Block) -> None:
        self._blocks = [block for block in blocks if len(block.rows)] if blocks else []

    def extend(self, others: Refusals, first: int = 0) -> None:
        """Add those of a later part, which begins at row `first` of the message."""
        self._blocks += [block._replace(first=first + block.first) for block in others._blocks]

    def __len__(self) -> int:
        return sum(len(block.rows) for block in self._blocks)

    def __iter__(self) -> Iterator[Refusal]:
        for block in self._blocks:
            yield from map(block.refusal, range(len(block.rows)))

    @overload
    def __getitem__(self, place: int) -> Refusal: ...
    @overload
    def __getitem__(self, place: slice) -> list[Refusal]: ...
    def __getitem__(self, place: int | slice) -> Refusal | list[Refusal]:
        if isinstance(place, slice):
            return [self[k] for k in range(*place.indices(len(self)))]
        rest = place + len(self) if place < 0 else place
        if rest >= 0:
            for block in self._blocks:
                if rest < len(block.rows):
                    return block.refusal(rest)
                rest -= len(block.rows)
        raise IndexError(place)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, (list, Refusals)) and list(self) == list(other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        more = f', and {len(self) - 9} more' if len(self) > 9 else ''
        return f'{self[:9]}{more}'


class Reasons:
    """Why rows are refused, as it is found out; of several reasons the last holds."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._codes: NDArray[np.uint16] | None = None  # none where no row is refused
        self._texts = ['']

    def add(self, rows: NDArray[Any], text: str) -> None:
        """Refuse rows, given by number or as a mask."""
        if self._codes is None:
            self._codes = np.zeros(self._count, np.uint16)
        if text not in self._texts:
            self._texts.append(text)
        self._codes[rows] = self._texts.index(text)

    @property
    def good(self) -> NDArray[np.bool_]:
        """(count,) which rows are not refused."""
        if self._codes is None:
            return np.ones(self._count, np.bool_)
        return np.asarray(self._codes == FINE)

    def refusals(self, name: Callable[[int], str]) -> Refusals:
        """All of them; `name` says what a row is called."""
        codes, texts = self._codes, self._texts
        if codes is None:
            return Refusals()
        return Refusals(Block(np.flatnonzero(codes), name, lambda row: texts[codes[row]]))
