# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The first hit of each ray in exact arithmetic, and the errors of answers."""

import math
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...scene.shapes.shape import ShapeKind, Shapes
from ..page import Cell
from ..scenes import Boxes, Floats, Rays

# ---- Where rays enter boxes, spheres and cylinders, in rationals, without the tree


Vector = NDArray[np.object_]  # of rationals
ROOT_BITS = 256


def exact(values: Iterable[float]) -> Vector:
    """The values as rationals."""
    return np.array([Fraction(value) for value in values])


class Interval(NamedTuple):
    """Where along a ray, in units of its direction."""

    begin: Fraction | float
    end: Fraction | float


EVERYWHERE = Interval(-math.inf, math.inf)


def slab(low: Fraction, high: Fraction, origin: Fraction, direction: Fraction) -> Interval | None:
    """Where a coordinate is between two planes; None is nowhere."""
    if not direction:
        return EVERYWHERE if low <= origin <= high else None
    ends = (low - origin) / direction, (high - origin) / direction
    return Interval(*ends) if direction > 0 else Interval(*ends[::-1])


def root(square: Fraction) -> Fraction:
    """The square root, cut off after so many bits that it is that of a double."""
    shifted = square.numerator * square.denominator << 2 * ROOT_BITS
    return Fraction(math.isqrt(shifted), square.denominator << ROOT_BITS)


def disc(start: Vector, direction: Vector, radius: Fraction) -> Interval | None:
    """Where a point is within a radius of the origin."""
    a, b, c = direction @ direction, start @ direction, start @ start - radius * radius
    if not a:
        return EVERYWHERE if c <= 0 else None
    under = b * b - a * c
    if under < 0:
        return None
    return Interval((-b - root(under)) / a, (-b + root(under)) / a)


def enter(intervals: Iterable[Interval | None]) -> Fraction | None:
    """Where a ray enters what all intervals have in common."""
    common = Interval(Fraction(0), math.inf)
    for one in intervals:
        if one is None:
            return None
        common = Interval(max(common.begin, one.begin), min(common.end, one.end))
    return Fraction(common.begin) if common.begin <= common.end else None


def enter_box(lo: Vector, hi: Vector, origin: Vector, direction: Vector) -> Fraction | None:
    """Where a ray enters a closed box."""
    return enter(map(slab, lo, hi, origin, direction))


class Solid(NamedTuple):
    """A box, sphere or cylinder."""

    kind: int
    centre: Vector
    half: Vector
    axes: Vector  # its own, as rows

    def entry(self, origin: Vector, direction: Vector) -> Fraction | None:
        """Where a ray enters."""
        start, direction = self.axes @ (origin - self.centre), self.axes @ direction
        if self.kind == ShapeKind.SPHERE:
            return enter([disc(start, direction, self.half[0])])
        slabs = [slab(-h, h, *ray) for h, *ray in zip(self.half, start, direction, strict=True)]
        if self.kind == ShapeKind.CYLINDER:
            return enter([disc(start[:2], direction[:2], self.half[0]), slabs[2]])
        return enter(slabs)


def _axes(quaternion: Sequence[float]) -> Vector:
    """Rows that turn the world into the frame of a shape; not of unit length is no matter."""
    x, y, z, w = exact(quaternion)
    length = x * x + y * y + z * z + w * w
    if not length:
        return np.eye(3, dtype=np.object_)
    rows = (
        (x * x - y * y - z * z + w * w, 2 * (x * y + z * w), 2 * (x * z - y * w)),
        (2 * (x * y - z * w), y * y - x * x - z * z + w * w, 2 * (y * z + x * w)),
        (2 * (x * z + y * w), 2 * (y * z - x * w), z * z - x * x - y * y + w * w),
    )
    return np.array(rows) / length


# ---- The first hit of each ray, by brute force and without rounding


Rows = NDArray[np.int64]
NOTHING = -1


class Truth(NamedTuple):
    """What real arithmetic says of n rays.

    `rows` (n,) are the first objects hit, the lowest among equals, NOTHING where none is; `ts` the
    exact distances to them. `entry(row, ray)` is where a ray enters an object; None beyond the
    rows. `lengths` (n,) are those of the directions, m: distances are in units of them.
    """

    rows: Rows
    ts: list[Fraction | None]
    entry: Callable[[int, int], Fraction | None]
    lengths: Floats


def boxes_truth(boxes: Boxes, rays: Rays) -> Truth:
    """Truth of axis-aligned boxes, coordinates between 1e-150 and 1e150."""
    corners = [(exact(lo), exact(hi)) for lo, hi in zip(*(x.tolist() for x in boxes), strict=True)]

    def entry(row: int, origin: Vector, direction: Vector) -> Fraction | None:
        return enter_box(*corners[row], origin, direction)

    return _truth(entry, boxes.centers, boxes.edges, rays)


def shapes_truth(shapes: Shapes, rays: Rays) -> Truth:
    """Truth of turned boxes, spheres and cylinders: the shapes of the quaternions as given."""
    columns = (shapes.kind, shapes.position, shapes.size, shapes.orientation)
    solids = [
        Solid(kind, exact(centre), exact(size) / 2, _axes(turn))
        for kind, centre, size, turn in zip(*(column.tolist() for column in columns), strict=True)
    ]

    def entry(row: int, origin: Vector, direction: Vector) -> Fraction | None:
        return solids[row].entry(origin, direction)

    return _truth(entry, shapes.position, shapes.size, rays)


def _truth(
    enter: Callable[[int, Vector, Vector], Fraction | None],
    centres: Floats,
    sizes: Floats,
    rays: Rays,
) -> Truth:
    """By brute force: the nearest first, by a ball around each, until none can be nearer."""
    exact_rays = [tuple(map(exact, ray)) for ray in zip(*(x.tolist() for x in rays), strict=True)]
    lengths = np.linalg.norm(rays.directions, axis=1)
    reach = np.linalg.norm(sizes, axis=1) * 0.501 + 1e-9
    rows, ts = np.full(len(lengths), NOTHING, np.int64), list[Fraction | None]()

    def entry(row: int, ray: int) -> Fraction | None:
        return enter(row, *exact_rays[ray]) if row < len(sizes) else None

    for ray, (origin, direction) in enumerate(zip(*rays, strict=True)):
        offset, unit = centres - origin, direction / lengths[ray]
        along, slack = offset @ unit, reach + 1e-12 * np.abs(offset).max()  # more than rounding
        apart = np.linalg.norm(offset - np.maximum(along, 0.0)[:, None] * unit, axis=1)
        nearest = (along - slack) / lengths[ray]  # no nearer than that
        first, best = None, math.inf
        for row in sorted(np.flatnonzero(apart <= slack).tolist(), key=nearest.__getitem__):
            if nearest[row] > 1.000001 * best:
                break
            t = entry(row, ray)
            if t is not None and (first is None or (t, row) < first):
                first, best = (t, row), float(t)
        ts.append(first[0] if first else None)
        if first:
            rows[ray] = first[1]
    return Truth(rows, ts, entry, lengths)


def brute_force(boxes: Boxes, rays: Rays) -> 'Answer':
    """The usual slab test in float64 and numpy, ray by ray."""
    rows, ts = np.full(len(rays.origins), NOTHING, np.int64), np.full(len(rays.origins), np.inf)
    with np.errstate(all='ignore'):
        for ray, (origin, direction) in enumerate(zip(*rays, strict=True)):
            inverse = 1.0 / direction
            first, last = (boxes.lo - origin) * inverse, (boxes.hi - origin) * inverse
            near, far = np.where(inverse > 0, first, last), np.where(inverse > 0, last, first)
            entry = np.fmax.reduce(near, axis=1, initial=0.0)  # 0 * inf is NaN: bounds nothing
            leave = np.fmin.reduce(far, axis=1, initial=np.inf)
            entered = np.flatnonzero(entry <= leave)
            if len(entered):
                rows[ray] = entered[entry[entered].argmin()]
                ts[ray] = entry[rows[ray]]
    return Answer(rows, ts)


# ---- Wrong answers, counted; errors of distances in metres and in ulp


class Answer(NamedTuple):
    """First objects on n rays: rows (n,), NOTHING where nothing is hit, and the distances."""

    rows: Rows
    ts: Floats


class Score(NamedTuple):
    """What is wrong with an answer."""

    rays: int
    wrong_hits: int  # a hit where there is none
    wrong_misses: int  # no hit where there is one
    wrong_first: int  # the wrong object comes first: it is farther, or not hit at all
    wrong_by: float  # how much farther at most, m; inf if it is not hit at all
    distances: Floats  # |t - exact t|, m, of all rays that hit something and should
    relative: float  # largest relative error of t where the first object is right
    ulps: float  # the same in units in the last place of the exact t

    @property
    def wrong(self) -> float:
        """Share of the rays with a wrong answer."""
        return (self.wrong_hits + self.wrong_misses + self.wrong_first) / self.rays

    @property
    def mean(self) -> float:
        """Mean error of the distance."""
        return float(self.distances.mean()) if len(self.distances) else 0.0


HEADER = (
    'wrong hits', 'wrong misses', 'wrong first', 'by at most, m', 'wrong, % of rays',
    'distance: mean error, m', '95 %, m', 'largest, m', 'right object: largest, relative',
    'largest, ulp',
)  # fmt: skip


def cells(score: Score) -> list[Cell]:
    """The score as cells under `HEADER`."""
    far = float(np.percentile(score.distances, 95)) if len(score.distances) else 0.0
    largest = float(score.distances.max(initial=0.0))
    by = score.wrong_by if score.wrong_first else None
    counts: list[Cell] = [score.wrong_hits, score.wrong_misses, score.wrong_first, by]
    return [*counts, 100 * score.wrong, score.mean, far, largest, score.relative, score.ulps]


def score(answers: Sequence[Answer], truths: Sequence[Truth]) -> Score:
    """Compare in all worlds. Of objects entered at the same distance any may be the first."""
    rays = hits = misses = firsts = 0
    distances: list[float] = []
    relative = ulps = by = 0.0
    for answer, truth in zip(answers, truths, strict=True):
        rays += len(answer.rows)
        pairs = zip(answer.rows.tolist(), answer.ts.tolist(), strict=True)
        for ray, (row, t) in enumerate(pairs):
            exact_t = truth.ts[ray]
            if exact_t is None or row == NOTHING:
                hits += exact_t is None and row != NOTHING
                misses += exact_t is not None and row == NOTHING
                continue
            error, length = abs(Fraction(t) - exact_t), float(truth.lengths[ray])
            distances.append(float(error) * length)
            entry = exact_t if row == truth.rows[ray] else truth.entry(row, ray)
            if entry != exact_t:
                firsts += 1
                by = max(by, math.inf if entry is None else float(entry - exact_t) * length)
            elif error and not exact_t:
                relative = ulps = math.inf
            elif error:
                relative = max(relative, float(error / exact_t))
                ulps = max(ulps, float(error / Fraction(math.ulp(float(exact_t)))))
    return Score(rays, hits, misses, firsts, by, np.array(distances), relative, ulps)
