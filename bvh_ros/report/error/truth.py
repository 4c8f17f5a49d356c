# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What each ray meets first, in exact arithmetic, and the errors of answers."""

import math
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...scene.shapes.shape import ShapeKind, Shapes
from ..page import Cell
from ..scenes import Boxes, Floats, Rays

# ---- Where rays enter boxes, spheres and cylinders, in whole numbers: nothing of the tree is
# used.


Whole = list[int]
ROOT_BITS = 256


def bits_below_the_point(values: Iterable[float]) -> int:
    """Least number of binary places that writes all the values exactly."""
    return max((x.as_integer_ratio()[1].bit_length() - 1 for x in values), default=0)


def whole(values: Iterable[float], bits: int) -> Whole:
    """The values in units of 2**-bits."""
    ratios = (x.as_integer_ratio() for x in values)
    return [n << (bits + 1 - d.bit_length()) for n, d in ratios]


def enter_slabs(near: Sequence[int], far: Sequence[int], way: Sequence[int]) -> Fraction | None:
    """Where a ray enters a closed box; near and far are its planes seen from the ray's origin."""
    entry, entry_over = 0, 1
    leave, leave_over = 1, 0  # infinity
    for a, b, d in zip(near, far, way, strict=True):
        if d == 0:
            if a > 0 or b < 0:
                return None
            continue
        if d < 0:
            a, b, d = -b, -a, -d
        if a * entry_over > entry * d:
            entry, entry_over = a, d
        if b * leave_over < leave * d:
            leave, leave_over = b, d
    if entry * leave_over > leave * entry_over:
        return None
    return Fraction(entry, entry_over)


def _disc_interval(
    start: Sequence[int], way: Sequence[int], radius: int
) -> tuple[Fraction, Fraction] | None:
    """Where a line along a way that is not zero is within a radius of the origin."""
    a = sum(d * d for d in way)
    b = sum(o * d for o, d in zip(start, way, strict=True))
    c = sum(o * o for o in start) - radius * radius
    under = b * b - a * c
    if under < 0:
        return None
    root = Fraction(math.isqrt(under << (2 * ROOT_BITS)), 1 << ROOT_BITS)
    return (-b - root) / a, (-b + root) / a


def enter_sphere(start: Sequence[int], way: Sequence[int], radius: int) -> Fraction | None:
    """Where a ray enters the ball around the origin."""
    if sum(o * o for o in start) <= radius * radius:
        return Fraction(0)
    if not any(way):
        return None
    found = _disc_interval(start, way, radius)
    return found[0] if found and found[0] >= 0 else None


def enter_cylinder(
    start: Sequence[int], way: Sequence[int], radius: int, half_height: int
) -> Fraction | None:
    """Where a ray enters the cylinder about the z axis: an endless one and a slab."""
    x, y, z = start
    if x * x + y * y <= radius * radius and abs(z) <= half_height:
        return Fraction(0)
    entry, leave = Fraction(0), None
    if way[0] or way[1]:
        found = _disc_interval(start[:2], way[:2], radius)
        if found is None:
            return None
        entry, leave = max(entry, found[0]), found[1]
    elif x * x + y * y > radius * radius:
        return None
    if way[2]:
        low, high = sorted(Fraction(side * half_height - z, way[2]) for side in (-1, 1))
        entry, leave = max(entry, low), high if leave is None else min(leave, high)
    elif abs(z) > half_height:
        return None
    return entry if leave is not None and entry <= leave else None


class WholeShapes:
    """Shapes in whole numbers, for rays whose numbers need no more than `bits` binary places."""

    def __init__(self, shapes: Shapes, bits: int) -> None:
        half, turn = (shapes.size * 0.5).tolist(), shapes.orientation.tolist()
        self.bits = max(bits, *map(bits_below_the_point, (shapes.position.ravel().tolist(),)))
        self.bits = max(self.bits, bits_below_the_point(x for row in half for x in row))
        self._kinds: list[int] = shapes.kind.tolist()
        self._half = [whole(row, self.bits) for row in half]
        self._centre = [whole(row, self.bits) for row in shapes.position.tolist()]
        self._turn = [_stretched_rotation(row) for row in turn]

    def entry(self, row: int, origin: Whole, way: Whole) -> Fraction | None:
        """Where a ray, in units of 2**-bits, enters a shape."""
        rows, stretch = self._turn[row]
        offset = [o - c for o, c in zip(origin, self._centre[row], strict=True)]
        start = [sum(m * x for m, x in zip(line, offset, strict=True)) for line in rows]
        ahead = [sum(m * x for m, x in zip(line, way, strict=True)) for line in rows]
        half = [stretch * h for h in self._half[row]]
        if self._kinds[row] == ShapeKind.SPHERE:
            return enter_sphere(start, ahead, half[0])
        if self._kinds[row] == ShapeKind.CYLINDER:
            return enter_cylinder(start, ahead, half[0], half[2])
        near = [-h - s for h, s in zip(half, start, strict=True)]
        far = [h - s for h, s in zip(half, start, strict=True)]
        return enter_slabs(near, far, ahead)


def _stretched_rotation(quaternion: list[float]) -> tuple[list[list[int]], int]:
    """Rows that turn the world into the shape's frame, stretched by the second value: |q|^2."""
    if not any(quaternion):
        quaternion = [0.0, 0.0, 0.0, 1.0]
    x, y, z, w = whole(quaternion, bits_below_the_point(quaternion))
    columns: Any = (
        (x * x - y * y - z * z + w * w, 2 * (x * y + z * w), 2 * (x * z - y * w)),
        (2 * (x * y - z * w), y * y - x * x - z * z + w * w, 2 * (y * z + x * w)),
        (2 * (x * z + y * w), 2 * (y * z - x * w), z * z - x * x - y * y + w * w),
    )
    return [list(column) for column in columns], x * x + y * y + z * z + w * w


# ---- The first thing that each ray meets, by brute force and without rounding.


Rows = NDArray[np.int64]
NOTHING = -1


class Truth(NamedTuple):
    """What real arithmetic says of n rays."""

    rows: Rows
    """(n,) of the object met first, the lowest among equals; NOTHING where none is."""
    ts: list[Fraction | None]
    """Exact distance to it."""
    entry: Callable[[int, int], Fraction | None]
    """Exact distance at which a ray enters an object: entry(row, ray)."""
    lengths: Floats
    """(n,) of the directions, m: distances are in units of them."""


def _ray_bits(rays: Rays) -> int:
    values = (*rays.origins.ravel().tolist(), *rays.directions.ravel().tolist())
    return bits_below_the_point(values)


def boxes_truth(boxes: Boxes, rays: Rays) -> Truth:
    """Truth of axis-aligned boxes; coordinates between 1e-150 and 1e150, so that no bound of the
    filter overflows.
    """
    values = (*boxes.lo.ravel().tolist(), *boxes.hi.ravel().tolist())
    bits = max(_ray_bits(rays), bits_below_the_point(values))
    starts = [whole(row, bits) for row in rays.origins.tolist()]
    ways = [whole(row, bits) for row in rays.directions.tolist()]

    def entry(row: int, ray: int) -> Fraction | None:
        low, high = whole(boxes.lo[row].tolist(), bits), whole(boxes.hi[row].tolist(), bits)
        near = [plane - o for plane, o in zip(low, starts[ray], strict=True)]
        far = [plane - o for plane, o in zip(high, starts[ray], strict=True)]
        return enter_slabs(near, far, ways[ray])

    def candidates(ray: int) -> Rows:
        """Boxes that may be the first: difference and quotient round once each, so an entry or
        exit is right within 2**-50 of its value, and 1e-300.
        """
        with np.errstate(all='ignore'):
            planes = (np.stack(boxes) - rays.origins[ray]) / rays.directions[ray]
            planes[:, np.isnan(planes).any(axis=0)] = [[-np.inf], [np.inf]]  # along a plane
            more = np.copysign(2.0**-50, planes)
            lower, upper = planes * (1.0 - more) - 1e-300, planes * (1.0 + more) + 1e-300
        entry, surely_in = (
            np.maximum(side.min(axis=0).max(axis=1), 0.0) for side in (lower, upper)
        )
        surely_out, leave = (side.max(axis=0).min(axis=1) for side in (lower, upper))
        nearest = surely_in[surely_in <= surely_out].min(initial=np.inf)
        return np.flatnonzero((entry <= leave) & (entry <= nearest) & (entry < np.inf))

    return _settle(rays, candidates, entry)


def shapes_truth(shapes: Shapes, rays: Rays) -> Truth:
    """Truth of turned boxes, spheres and cylinders: the true shapes of the quaternions as given.

    The filter is the ball around each shape.
    """
    solids = WholeShapes(shapes, _ray_bits(rays))
    starts: list[Whole] = [whole(row, solids.bits) for row in rays.origins.tolist()]
    ways: list[Whole] = [whole(row, solids.bits) for row in rays.directions.tolist()]
    reach = np.linalg.norm(shapes.size, axis=1) * 0.5 * 1.001 + 1e-9

    def entry(row: int, ray: int) -> Fraction | None:
        return solids.entry(row, starts[ray], ways[ray])

    def candidates(ray: int) -> Rows:
        offset = shapes.position - rays.origins[ray]
        way = rays.directions[ray] / np.linalg.norm(rays.directions[ray])
        along = np.maximum(offset @ way, 0.0)
        apart = np.linalg.norm(offset - along[:, None] * way, axis=1)
        return np.flatnonzero(apart <= reach)

    return _settle(rays, candidates, entry)


def _settle(
    rays: Rays, candidates: Callable[[int], Rows], entry: Callable[[int, int], Fraction | None]
) -> Truth:
    count = len(rays.origins)
    rows, ts = np.full(count, NOTHING, np.int64), []
    for ray in range(count):
        met = [(t, row) for row in candidates(ray).tolist() if (t := entry(row, ray)) is not None]
        ts.append(min(met)[0] if met else None)
        if met:
            rows[ray] = min(met)[1]
    return Truth(rows, ts, entry, np.linalg.norm(rays.directions, axis=1))


def brute_force(boxes: Boxes, rays: Rays) -> tuple[Rows, Floats]:
    """The usual slab test in float64 and numpy, ray by ray: (rows, t)."""
    rows, ts = np.full(len(rays.origins), NOTHING, np.int64), np.full(len(rays.origins), np.inf)
    with np.errstate(all='ignore'):
        for ray, (origin, direction) in enumerate(zip(*rays, strict=True)):
            inverse = 1.0 / direction
            first, last = (boxes.lo - origin) * inverse, (boxes.hi - origin) * inverse
            near, far = np.where(inverse > 0, first, last), np.where(inverse > 0, last, first)
            entry = np.fmax.reduce(near, axis=1, initial=0.0)  # 0 * inf is NaN: bounds nothing
            leave = np.fmin.reduce(far, axis=1, initial=np.inf)
            met = np.flatnonzero(entry <= leave)
            if len(met):
                rows[ray] = met[entry[met].argmin()]
                ts[ray] = entry[rows[ray]]
    return rows, ts


# ---- What is wrong with answers: counted against the truth, and measured in metres and in ulp.


class Answer(NamedTuple):
    """First objects on n rays."""

    rows: Rows
    """(n,) NOTHING where nothing is met."""
    ts: Floats
    """(n,) computed distances."""


class Score(NamedTuple):
    """What is wrong with an answer."""

    rays: int
    wrong_hits: int
    """Something is met where there is nothing."""
    wrong_misses: int
    """Nothing is met where there is something."""
    wrong_first: int
    """An object is met first that is not: farther, or not met at all."""
    wrong_by: float
    """How much farther at most, m; inf if it is not met at all."""
    distances: Floats
    """|t - exact t| in metres, of all rays that meet something and should."""
    relative: float
    """Largest relative error of t where the first object is right."""
    ulps: float
    """The same in units in the last place of the exact t."""

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
    counts: list[Cell] = [score.wrong_hits, score.wrong_misses, score.wrong_first]
    counts.append(score.wrong_by if score.wrong_first else None)
    return [*counts, 100 * score.wrong, score.mean, far, largest, score.relative, score.ulps]


def score(answer: Answer, truth: Truth) -> Score:
    """Compare. Of objects entered at exactly the same distance any may be called the first."""
    hits = misses = firsts = 0
    distances: list[float] = []
    relative = ulps = by = 0.0
    pairs = zip(answer.rows.tolist(), answer.ts.tolist(), truth.rows.tolist(), strict=True)
    for ray, (row, t, true_row) in enumerate(pairs):
        exact = truth.ts[ray]
        if exact is None or row == NOTHING:
            hits += exact is None and row != NOTHING
            misses += exact is not None and row == NOTHING
            continue
        error = abs(Fraction(t) - exact)
        distances.append(float(error) * float(truth.lengths[ray]))
        entry = exact if row == true_row else truth.entry(row, ray)
        if entry != exact:
            firsts += 1
            by = max(by, _farther(entry, exact) * float(truth.lengths[ray]))
        elif error and not exact:
            relative = ulps = math.inf
        elif error:
            relative = max(relative, float(error / exact))
            ulps = max(ulps, float(error / Fraction(math.ulp(float(exact)))))
    count = len(answer.rows)
    return Score(count, hits, misses, firsts, by, np.array(distances), relative, ulps)


def _farther(entry: Fraction | None, first: Fraction) -> float:
    return math.inf if entry is None else float(entry - first)
