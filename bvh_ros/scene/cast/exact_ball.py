# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Swept balls: the first obstacle, or all; among axis-aligned boxes in exact arithmetic.

The squared distance of origin + t * direction from a box is convex in t and, between two of
planes of faces, a quadratic with rational coefficients. So the first contact is the smaller root
of one of them, middle - sqrt(square), and squaring twice compares two of those.

The closed form of `shapes.enter_rounded_box` rounds: each offset of the origin from a face
once, the unit direction by less than 4 u, and what is made of them (a minimum, a square root, a
sum of lengths) leaves origin + s * direction within 40 u L of the surface of the box grown by it
(u = 2**-53, L the sum of the largest offsets, the radius and the length of the path, which past
all boxes counts no more than up to them). Only a box within 40 u L of
the other answer can be missed or hit wrongly. A ball smaller by the slack of
128 u L therefore comes surely late, and one larger by it surely early:

    ------|-----------|------------|----->  t        before `early` the box is surely not touched,
        early         t          late               after `late` it surely was

Two boxes whose brackets do not meet are in order. What the brackets leave open, exact arithmetic
decides. A thin ray meets boxes at the t of the tree, within THIN_SLACK of the exact one; what is
closer, exact arithmetic decides as well. Other shapes have their t as computed: by it, and by
their handles, they are put between the boxes.
"""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from functools import cmp_to_key
from heapq import merge
from itertools import pairwise
from math import isqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.access import INSIDE, OpenTree
from ..distance import batch
from ..names import Slots
from ..shapes.footprint import ROUND
from ..shapes.shape import Floats
from ..store import Columns
from .arguments import BoxHit, Hits, Sweep, world_of
from .query import AT, EARLY, LATE, MINUTE, SWEEP_SLACK, Candidates, described

# ---- the exact time of contact


DIGITS = 70  # bits of a root, at least, before it is rounded to a double
Axis = tuple[int, int, int]  # sides of the box from the origin, and the direction


class Root(NamedTuple):
    """The number middle - sqrt(square)."""

    middle: Fraction
    square: Fraction

    def __float__(self) -> float:
        """Within one ulp: as a quotient in which nothing cancels; not for numbers below zero."""
        if not self.square:
            return float(self.middle)
        total = self.middle + _square_root(self.square)
        return float((self.middle**2 - self.square) / total) if total else 0.0


START = Root(Fraction(0), Fraction(0))


def rational(t: float) -> Root:
    """A double as a root."""
    return Root(Fraction(t), Fraction(0))


def first_touch(
    lo: Sequence[float],
    hi: Sequence[float],
    origin: Sequence[float],
    direction: Sequence[float],
    radius: float,
) -> Root | None:
    """The least t from 0 to 1 at which origin + t * direction is within `radius` of the box; None
    if there is none, START if it is from the beginning.
    """
    ndim, (size, *numbers) = len(lo), _whole(radius, *lo, *hi, *origin, *direction)
    lows, highs, here, steps = (numbers[i : i + ndim] for i in range(0, 4 * ndim, ndim))
    axes = [
        (low - x, high - x, step)
        for low, high, x, step in zip(lows, highs, here, steps, strict=True)
    ]
    flat = _flat_touch(axes, size)
    if flat is not None:
        return flat
    limit = size**2
    if _quadratic(axes, Fraction(0))[2] <= limit:
        return START
    planes = {Fraction(plane, step) for low, high, step in axes if step for plane in (low, high)}
    crossings = sorted({Fraction(0), Fraction(1), *(t for t in planes if 0 < t < 1)})
    for begin, end in pairwise(crossings):
        a, b, c = _quadratic(axes, (begin + end) / 2)
        if a == 0:
            continue  # as far away all along as at its begin
        middle = Fraction(b, a)
        closest = min(max(middle, begin), end)
        if (a * closest - 2 * b) * closest + c <= limit:
            return Root(middle, middle**2 - Fraction(c - limit, a))
    return None


def _whole(*numbers: float) -> list[int]:
    """Doubles in units of one power of two: integers, as these take a tenth of the time."""
    ratios = [number.as_integer_ratio() for number in numbers]
    bits = max(divisor.bit_length() for _, divisor in ratios)
    return [number << (bits - divisor.bit_length()) for number, divisor in ratios]


def _flat_touch(axes: list[Axis], size: int) -> Root | None:
    """`first_touch` where that is of a face, which takes much less time; None where it is not."""
    for axis, (low, high, step) in enumerate(axes):
        ahead, length = (low - size, step) if step > 0 else (-high - size, -step)
        others = axes[:axis] + axes[axis + 1 :]
        if 0 < ahead <= length and all(
            below * length <= step * ahead <= above * length for below, above, step in others
        ):
            return Root(Fraction(ahead, length), Fraction(0))
    return None


def _quadratic(axes: list[Axis], t: Fraction) -> tuple[int, int, int]:
    """The squared distance next to t: a t**2 - 2 b t + c, over the axes on which it is outside."""
    a = b = c = 0
    for low, high, step in axes:
        if not low <= step * t <= high:
            plane = low if step * t < low else high
            a, b, c = a + step**2, b + step * plane, c + plane**2
    return a, b, c


def compare(one: Root, other: Root) -> int:
    """Sign of one - other."""
    if one == other:
        return 0
    gap = one.middle - other.middle
    lean = _sign(one.square - other.square)  # of the difference of the square roots
    if _sign(gap) != lean:
        return _sign(_sign(gap) - lean)
    # Both differences have the same sign: |gap| against |sqrt a - sqrt b|, by their squares.
    rest = one.square + other.square - gap**2
    return lean * (1 if rest < 0 else _sign(4 * one.square * other.square - rest**2))


def _sign(x: Fraction | int) -> int:
    return (x > 0) - (x < 0)


def _square_root(x: Fraction) -> Fraction:
    """Rounded down, to a relative error below 2**-DIGITS."""
    product = x.numerator * x.denominator
    shift = max(DIGITS + 1 - product.bit_length() // 2, 0)
    return Fraction(isqrt(product << 2 * shift), x.denominator << shift)


# ---- rays and balls among boxes: brackets of the times, and what exact arithmetic decides


THIN_SLACK = 2.0**-50  # 4 ulp: a t is within 2 of the exact one
FEW = 64  # boxes whose roots are computed one by one


def in_exact_order(
    tree: OpenTree, columns: Columns, sweep: Sweep, found: Candidates
) -> Iterable[BoxHit]:
    """The first obstacle that a ray or ball meets from `origin` to `origin + direction`, or all in
    order, ties by handle: slot, t, point and normal of each. `found` are all that it may meet
    first, or at all.
    """
    world, ndim, origin = world_of(tree, columns), tree.ndim, sweep.origin
    segment = origin[:ndim], sweep.direction[:ndim]
    slots, ts, features = _in_order(columns, found, sweep, ndim)
    if sweep.skip_inside:
        outside = features != INSIDE
        slots, ts, features = slots[outside], ts[outside], features[outside]
    if not sweep.every:
        slots, ts, features = slots[:1], ts[:1], features[:1]
    # Of one type, however many there are: rows of one column are contiguous, others are not.
    hits = Hits(slots, np.ascontiguousarray(ts), np.ascontiguousarray(features))
    return described(world, segment, sweep.radius, hits, origin)


def _in_order(columns: Columns, found: Candidates, sweep: Sweep, ndim: int) -> Hits:
    """The hits, in order of their times, then handles; exact times of axis-aligned boxes."""
    slots, times, features = found
    is_thin = sweep.radius == 0.0
    if is_thin and len(slots) == 1:
        return Hits(slots, times[AT], features[AT])
    order = np.lexsort((columns.node_handle[slots], times[AT]))
    slots, times, features = slots[order], times[:, order], features[:, order]
    ts, at_features = times[AT], features[AT]
    if is_thin:
        if all(late > _surely_after(early) for early, late in pairwise(ts.tolist())):
            return Hits(slots, ts, at_features)
        late = _surely_after(ts)
        times, features = np.array((2.0 * ts - late, ts, late)), np.array((at_features,) * 3)
    is_box = ~_shaped(columns)[slots]
    open_ones = np.flatnonzero(_undecided(times, features) & is_box)
    if not len(open_ones):
        return Hits(slots, ts, at_features)
    sweep = Sweep(sweep.origin[:ndim], sweep.direction[:ndim], *sweep[2:])
    roots = _exact(columns, slots, times[EARLY], open_ones, sweep)
    handles = columns.node_handle[slots]
    boxes = _sorted(np.flatnonzero(is_box), handles, ts, roots)
    for row, root in roots.items():
        if root is not None and not is_thin:  # one ray has the t of the kernel everywhere
            ts[row], at_features[row] = float(root), INSIDE if root is START else ROUND
    order = merged(boxes, np.flatnonzero(~is_box), ts, handles)
    return Hits(slots[order], ts[order], at_features[order])


def _surely_after(t: Any) -> Any:
    """A time by which a thin ray has met a box that it meets at `t`, as computed."""
    return t * (1.0 + THIN_SLACK) + MINUTE


def merged(boxes: Slots, others: Slots, ts: Floats, handles: Slots) -> Slots:
    """Rows of hits in order of t, then handles. Boxes are in exact order, which their t as doubles
    may not have: they keep it, and each t becomes the largest up to it.
    """
    ts[boxes] = np.maximum.accumulate(ts[boxes])
    keys = list(zip(ts.tolist(), handles.tolist(), strict=True))
    return np.array([*merge(boxes.tolist(), others.tolist(), key=keys.__getitem__)], np.int64)


def _shaped(columns: Columns) -> NDArray[np.bool_]:
    shaped: NDArray[np.bool_] = (
        columns.geometry if columns.footprint is None else columns.footprint
    )['shaped']
    return shaped


def _undecided(times: Floats, features: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Of hits that are sorted by t: which may not be any, or may belong elsewhere."""
    early, late = times[EARLY], times[LATE]
    inside = features[LATE] == INSIDE  # surely: all of those are tied at zero
    doubtful: NDArray[np.bool_] = np.isinf(late) | ((features[EARLY] == INSIDE) & ~inside)
    if len(late) > 1:
        before = np.maximum.accumulate(np.where(inside, -np.inf, late))[:-1]
        after = np.minimum.accumulate(np.where(inside, np.inf, early)[::-1])[::-1][1:]
        doubtful[1:] |= ~inside[1:] & (early[1:] <= before)
        doubtful[:-1] |= ~inside[:-1] & (late[:-1] >= after)
    return doubtful


def _exact(
    columns: Columns, slots: Slots, early: Floats, rows: Slots, sweep: Sweep
) -> dict[int, Root | None]:
    """Return, for each of `rows`, the exact time at which the ball touches its box. None where it
    never does; and, if only the first hit counts, where it does so later than another box.
    """
    lows, highs = batch.corners(columns.geometry[slots])
    origin, direction = sweep.origin.tolist(), sweep.direction.tolist()
    ndim, latest = len(origin), np.inf
    roots: dict[int, Root | None] = dict.fromkeys(rows.tolist())
    if len(rows) > FEW:
        rows = rows[_near(lows[rows, :ndim], highs[rows, :ndim], sweep)]
    for row in rows[np.argsort(early[rows])].tolist():
        if early[row] > latest:
            continue
        lo, hi = lows[row, :ndim].tolist(), highs[row, :ndim].tolist()
        root = first_touch(lo, hi, origin, direction, sweep.radius)
        roots[row] = root
        if root is not None and not sweep.every and not (sweep.skip_inside and root is START):
            latest = min(latest, float(root) * (1.0 + SWEEP_SLACK))
    return roots


def _near(lows: Floats, highs: Floats, sweep: Sweep) -> Slots:
    """Rows of boxes of which a ball may be the first to touch one, or may touch, in less time than
    roots take: its centre meets the box grown by the radius, and no later than another box itself.
    """
    with np.errstate(over='ignore'):
        low, high = np.nextafter(lows - sweep.radius, -np.inf), highs + sweep.radius
    most = np.finfo(np.float64).max
    grown = OpenTree.from_boxes(
        np.maximum(low, -most), np.minimum(np.nextafter(high, np.inf), most)
    )
    ray = sweep.origin[None], sweep.direction[None], 1.0
    _, ids, ts = grown.raycast_all_many(*ray)
    latest = np.inf
    if not sweep.every and not sweep.skip_inside:
        latest = OpenTree.from_boxes(lows, highs).raycast_many(*ray).t[0]
    return np.searchsorted(grown.ids(), ids[ts <= latest * (1.0 + SWEEP_SLACK) + MINUTE])


def _sorted(boxes: Slots, handles: Slots, ts: Floats, exact: dict[int, Root | None]) -> Slots:
    """Rows of boxes in order of their roots (else of ts), then handles, without those whose root
    is None.
    """

    def in_order(one: tuple[Root, int, int], other: tuple[Root, int, int]) -> int:
        return compare(one[0], other[0]) or one[1] - other[1]

    rows = []
    for row in boxes.tolist():
        root = exact[row] if row in exact else rational(ts[row].item())
        if root is not None:
            rows.append((root, handles[row].item(), row))
    return np.array([row for _, _, row in sorted(rows, key=cmp_to_key(in_order))], np.int64)
