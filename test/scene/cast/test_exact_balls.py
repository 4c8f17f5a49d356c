# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Swept balls among axis-aligned boxes are decided as real arithmetic decides.

The reference asks of a box only whether it has been touched by a time t, in rationals, and finds
out which of two was touched first by halving the time until one has been touched and one has not.
"""

import math
from fractions import Fraction
from functools import cmp_to_key, lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from scene.inside import boxes_of
from scene.reference import scene_of
from tree.adversary import coordinates, nudge
from tree.reference import effort

from bvh_ros.scene import ShapeKind, Shapes

BOX, CYLINDER, CAPSULE = ShapeKind.BOX, ShapeKind.CYLINDER, ShapeKind.CAPSULE
HALVINGS = 250  # two roots that agree in so many digits are equal: checked below


class Sweep(NamedTuple):
    start: list[float]
    way: list[float]
    radius: float


@lru_cache(maxsize=1000)
def whole(numbers):
    """Doubles in units of a power of two in which all of them are whole, and that of the unit."""
    ratios = [number.as_integer_ratio() for number in numbers]
    over = max(under for _, under in ratios)
    return [above * (over // under) for above, under in ratios], over


def square_gap(lo, hi, sweep, t):
    """Squared distance of the ball's centre from the box at t."""
    ndim = len(lo)
    numbers, over = whole((*lo, *hi, *sweep.start, *sweep.way))
    above, under = t.numerator, t.denominator
    total = 0
    for low, high, x, step in (numbers[axis::ndim] for axis in range(ndim)):
        place = x * under + above * step
        total += max(low * under - place, place - high * under, 0) ** 2
    return Fraction(total, (over * under) ** 2)


def moments(lo, hi, sweep):
    """Times between which the squared gap is one quadratic, and where each has its vertex."""
    times = {Fraction(0), Fraction(1)}
    for low, high, x, step in zip(lo, hi, sweep.start, sweep.way, strict=True):
        if step != 0.0:
            times |= {(Fraction(plane) - Fraction(x)) / Fraction(step) for plane in (low, high)}
    times = sorted(t for t in times if 0 <= t <= 1)
    for a, b in pairwise(times):
        # A parabola through three points has its vertex where the chords' slopes say.
        m = (a + b) / 2
        first, second, third = (square_gap(lo, hi, sweep, t) for t in (a, m, b))
        bend = first - 2 * second + third
        if bend > 0:
            vertex = m + (b - a) / 4 * (first - third) / bend
            if a < vertex < b:
                times.append(vertex)
    return times


def touched_by(lo, hi, sweep, times, t):
    """Whether the ball touches the box at any time up to t."""
    limit = Fraction(sweep.radius) ** 2
    return any(square_gap(lo, hi, sweep, min(time, t)) <= limit for time in times)


def order_of(one, other, sweep):
    """-1, 0 or 1: which of two touched boxes is touched first. A box is (lo, hi, times)."""
    low, high = Fraction(0), Fraction(1)
    if touched_by(*one[:2], sweep, one[2], low) or touched_by(*other[:2], sweep, other[2], low):
        high = low
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        by = [touched_by(*box[:2], sweep, box[2], middle) for box in (one, other)]
        if by[0] != by[1]:
            return -1 if by[0] else 1
        low, high = (low, middle) if by[0] else (middle, high)
    return 0


def expected_rows(boxes, sweep, skip_inside):
    """Rows of the boxes that are touched, first to last, ties by row."""
    met = []
    for row, (lo, hi) in enumerate(boxes):
        times = moments(lo, hi, sweep)
        inside = touched_by(lo, hi, sweep, [Fraction(0)], Fraction(0))
        if touched_by(lo, hi, sweep, times, Fraction(1)) and not (inside and skip_inside):
            met.append((row, (lo, hi, times)))

    def compare(one, other):
        return order_of(one[1], other[1], sweep) or one[0] - other[0]

    return [row for row, _ in sorted(met, key=cmp_to_key(compare))]


def adversarial_scene(rng, planar, scale, count=8):
    """Boxes on lattices of halves, thirds and tenths; their corners as the tree has them."""
    position = coordinates(rng, (count, 3), scale)
    size = np.abs(coordinates(rng, (count, 3), scale))
    margin = rng.choice([0.0, 0.1 * scale])
    scene = scene_of(Shapes.boxes(position, size), planar, margin=margin)
    return scene, boxes_of(scene)


def adversarial_sweep(rng, boxes, scale):
    """A ball that comes, exactly or nearly, within its radius of a corner, an edge or a face."""
    lo, hi = (np.array(side) for side in boxes[rng.integers(len(boxes))])
    ndim = len(lo)
    legs = np.zeros(3)
    legs[rng.permutation(ndim)[:2]] = [(3, 4), (1, 0), (5, 12), (8, 6)][rng.integers(4)]
    size = scale * rng.choice([1.0, 0.5, 0.1, 1 / 3])
    radius = float(math.hypot(*legs) * size)
    target = np.where(rng.random(ndim) < 0.5, lo, hi)
    target = target + np.where(rng.random(ndim) < 0.5, 1, -1) * legs[:ndim] * size
    way = rng.integers(-3, 4, ndim) * scale
    if rng.random() < 0.5:  # grazes: across the line from the corner to the ball
        way = np.roll(legs[:ndim], 1) * np.array([1.0, -1.0, 1.0][:ndim]) * scale
    start = target - way * rng.choice([0.0, 0.5, 1.0])
    start, way = nudge(rng, start, 0.1), nudge(rng, way, 0.1)
    return Sweep(start.tolist(), way.tolist(), float(nudge(rng, np.array([radius]), 0.3)[0]))


def ask(scene, sweep, **options):
    """Names and times of all hits; the first hit must be the first of them."""
    start = np.zeros(3)
    start[: len(sweep.start)] = sweep.start
    goal = start.copy()
    goal[: len(sweep.way)] += sweep.way
    hits = scene.raycast_all(start, goal, sweep.radius, **options)
    first = scene.raycast(start, goal, sweep.radius, **options)
    assert (first.name if first else None) == (hits[0].name if hits else None)
    assert [hit.t for hit in hits] == sorted(hit.t for hit in hits)
    way = (goal - start)[: len(sweep.start)].tolist()  # as the scene rounds it
    return hits, Sweep(sweep.start, way, sweep.radius)


@pytest.mark.slow
@pytest.mark.parametrize('scale', [1.0, 1e-3, 1e8, 1e-160, 1e150], ids='{:g}'.format)
@pytest.mark.parametrize('planar', [False, True], ids=['3D', '2D'])
def test_balls_are_decided_exactly(planar, scale):
    rng = np.random.default_rng([21, planar, int(abs(math.log10(scale)))])
    met = 0
    for _ in range(effort(5, 100)):
        scene, boxes = adversarial_scene(rng, planar, scale)
        for _ in range(8):
            skip_inside = bool(rng.random() < 0.3)
            given = adversarial_sweep(rng, boxes, scale)
            hits, sweep = ask(scene, given, skip_inside=skip_inside)
            expected = expected_rows(boxes, sweep, skip_inside)
            assert [int(hit.name) for hit in hits] == expected, sweep
            met += len(hits)
            for hit in hits:
                assert_touches_at(boxes[int(hit.name)], sweep, hit.t)
    assert met > 30


def assert_touches_at(box, sweep, t):
    """The reported t is one at which the ball touches, but for rounding; and 0 inside."""
    limit, length = sweep.radius, sum(map(abs, (*sweep.start, *sweep.way, *box[0], *box[1])))
    gap = square_gap(*box, sweep, Fraction(t))
    slack = Fraction(2, 10**14) * (Fraction(length) + Fraction(limit))
    assert gap <= (Fraction(limit) + slack) ** 2
    inside = square_gap(*box, sweep, Fraction(0)) <= Fraction(limit) ** 2
    assert (t == 0.0) == inside or t < 1e-13
    if not inside:
        assert gap >= max(Fraction(limit) - slack, Fraction(0)) ** 2


CASES = {
    # a box from lo to hi, a ball from the start along a way: does it touch, and when
    'passes beside a face, touching': ((2, 1, 0), (4, 2, 1), (0, 0.5, 0), (9, 0, 0), 0.5, True),
    'one ulp too small': (
        (2, 1, 0), (4, 2, 1), (0, 0.5, 0), (9, 0, 0), math.nextafter(0.5, 0), False,
    ),
    'a corner by 3, 4, 5': ((3, 4, 0), (9, 9, 1), (0, 0, 0), (4, -3, 0), 5.0, True),
    'tenths that are no tenths': ((0.3, 0.4, 0), (9, 9, 1), (0, 0, 0), (4, -3, 0), 0.5, None),
    'reaches at the end': ((2, 0, 0), (4, 2, 1), (0, 1, 0), (1.5, 0, 0), 0.5, True),
    'short by one ulp': (
        (2, 0, 0), (4, 2, 1), (0, 1, 0), (math.nextafter(1.5, 0), 0, 0), 0.5, False,
    ),
    'stands still and touches': ((2, 0, 0), (4, 2, 1), (1.5, 1, 0), (0, 0, 0), 0.5, True),
    'a ball below the rounding of its place': (
        (1e6, 0, 0), (2e6, 2, 1), (0, 0, 0), (2e6, 0, 0), 1e-30, True,
    ),
    'and beside a face': ((1, 0, 0), (2, 2, 1), (0, -1e-30, 0), (9, 0, 0), 1e-30, True),
    'and not quite': (
        (1, 0, 0), (2, 2, 1), (0, -1e-30, 0), (9, 0, 0), math.nextafter(1e-30, 0), False,
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ('lo', 'hi', 'start', 'way', 'radius', 'touches'), CASES.values(), ids=CASES.keys()
)
def test_one_box(lo, hi, start, way, radius, touches):
    low, high = np.array(lo, float), np.array(hi, float)
    scene = scene_of(Shapes.boxes([(low + high) / 2], [high - low]))
    (box,) = boxes_of(scene)
    hits, sweep = ask(scene, Sweep(list(start), list(way), radius))
    exact = touched_by(*box, sweep, moments(*box, sweep), Fraction(1))
    assert bool(hits) == exact
    assert touches in (None, exact)


def test_equal_times_go_to_the_older():
    """Two corners at the same distance from the way, one nearer by an ulp or not."""
    for lift, expected in ((0.0, ['a', 'b']), (2.0**-52, ['b', 'a'])):
        shapes = Shapes.boxes([[4, 1.5 + lift, 0], [4, -1.5, 0]], [1, 1, 1])
        scene = scene_of(shapes, names=['a', 'b'])
        hits = scene.raycast_all([0, 0, 0], [9, 0, 0], 1.25)
        assert [hit.name for hit in hits] == expected
        assert hits[0].t == pytest.approx((3.5 - 0.75) / 9)


def test_faces_in_one_plane_go_to_the_older():
    """Cars that stand across one another in a lane: a ball meets their sides at once, or first the
    corner of one that is nearer by an ulp.
    """
    rng = np.random.default_rng(8)
    tied = 0
    for _ in range(60):
        lane = float(rng.choice([0.0, 3.6, 7.2]))
        middles = [[x, lane, 0.75] for x in 2e4 + rng.uniform(-3, 3, 4)]
        middles[3][1] = np.nextafter(lane, lane + rng.choice([-9, 0, 9]))
        scene = scene_of(Shapes.boxes(middles, [4.5, 1.8, 1.5]))
        start = np.array([2e4 + rng.uniform(-3, 3), lane - 2.5, 0.75])
        goal = np.add(start, (rng.uniform(-2, 2), rng.uniform(1, 3), 0.0))
        sweep = Sweep(start.tolist(), (goal - start).tolist(), 0.5)
        rows = expected_rows(boxes_of(scene), sweep, False)
        hits = scene.raycast_all(start, goal, 0.5)
        assert [int(hit.name) for hit in hits] == rows
        tied += len(hits) > 1 and hits[0].t == hits[1].t
    assert tied > 9, tied


# names of all hits: of a ball among a box and a round shape whose t are equal as doubles
TIED = {
    'the box is older': (
        (BOX, (1, 0, 1.5), (2, 2, 2)), (CAPSULE, (2, -1.5, 4), (3, 3, 5)),
        ((-1, -2.5, 3.5), (-1, 1, 3.5), 1.5),
    ),
    'the box is younger': (
        (CYLINDER, (-3, 3.5, 1), (1, 1, 4)), (BOX, (-2.5, 3.5, -0.5), (2.5, 3, 1)),
        ((-3, 4, -3.5), (-3, 4, -1), 2.0),
    ),
}  # fmt: skip


@pytest.mark.parametrize(('one', 'other', 'ball'), TIED.values(), ids=TIED.keys())
def test_a_box_and_a_round_shape_that_tie(one, other, ball):
    kinds, positions, sizes = zip(one, other, strict=True)
    turns = np.tile((0.0, 0, 0, 1), (2, 1))
    scene = scene_of(Shapes(np.array(kinds), np.array(positions), turns, np.array(sizes)))
    hits = scene.raycast_all(*ball)
    assert hits[0].t == hits[1].t
    assert [hit.name for hit in hits] == ['0', '1']
    assert scene.raycast(*ball).name == '0'


@pytest.mark.parametrize('planar', [False, True], ids=['3D', '2D'])
def test_order_among_boxes_and_other_shapes(planar):
    """Boxes are in exact order; any other two hits, one after the other, by t and then handle."""
    rng, count, tied = np.random.default_rng([4, planar]), 12, 0
    for _ in range(effort(15, 300)):
        kinds = rng.choice([BOX, BOX, CYLINDER, CAPSULE], count)
        places, sizes = rng.integers(-2, 3, (count, 3)) / 2, rng.integers(2, 5, (count, 3)) / 2.0
        sizes[:, 1] = np.where(kinds == BOX, sizes[:, 1], sizes[:, 0])
        sizes[:, 2] += np.where(kinds == CAPSULE, sizes[:, 0], 0.0)
        places[::4] = np.nextafter(places[::4], rng.choice([-9, 9], places[::4].shape))
        turns = np.tile((0.0, 0, 0, 1), (count, 1))
        scene = scene_of(Shapes(kinds, places, turns, sizes), planar)
        boxes, plain = boxes_of(scene), np.flatnonzero(kinds == BOX).tolist()
        for radius in (0.0, 0.0, 0.0, 0.5, 0.5, 1.5):
            ends = places[rng.integers(count)] + rng.integers(-1, 2, (2, 3)) / 2
            along = rng.integers(3 - planar)
            ends[:, along] = ends[1, along] + (-9, 0)
            if rng.random() < 0.7:
                ends[1, :along], ends[1, along + 1 :] = ends[0, :along], ends[0, along + 1 :]
            axes = slice(3 - planar)
            way = (ends[1] - ends[0])[axes].tolist()
            sweep, skip_inside = Sweep(ends[0, axes].tolist(), way, radius), bool(rng.integers(2))
            asked = scene.raycast_all(*ends, radius, skip_inside=skip_inside)
            rows = [int(hit.name) for hit in asked]
            expected = expected_rows([boxes[row] for row in plain], sweep, skip_inside)
            assert [row for row in rows if row in plain] == [plain[row] for row in expected]
            for (one, hit), (other, later) in pairwise(zip(rows, asked, strict=True)):
                if one not in plain or other not in plain:
                    assert (hit.t, one) < (later.t, other)
                    tied += hit.t == later.t > 0.0
            first = scene.raycast(*ends, radius, skip_inside=skip_inside)
            assert (first.name if first else None) == (asked[0].name if asked else None)
            if radius == 0.0:
                timed = scene.raycast_all(*ends, skip_inside=skip_inside, at=1)
                assert [int(hit.name) for hit in timed] == rows
    assert tied > 9, tied


@pytest.mark.parametrize('planar', [False, True], ids=['3D', '2D'])
def test_a_ball_that_just_touches_a_box_at_a_time(planar):
    """What a ball at a time may miss by rounding, it meets; it ends at whole halves."""
    rng, second = np.random.default_rng(3), 10**9
    shapes = Shapes.boxes([[0.5, 0.5, 0.5], [-200, 0.5, 0.5], [900, 900, 0]], 1.0)
    speeds = [[0, 0, 0], [40, 0, 0], [1, 0, 0]]  # the second one stands at -40 after 4 s
    scene = scene_of(shapes, planar, stamp=0, velocities=speeds)
    starts = rng.uniform(-6, -1, (200, 3))
    for face, at in ((0.0, 1), (-40.5, 4)):
        goals = np.tile([face - 0.5, 0.5, 0.5], (len(starts), 1))
        ends = starts + np.array([face, 0, 0]), goals
        for until in (None, at * second):
            before = at if until is None else at - 1
            hits = scene.sweep_many(*ends, 0.5, at=before * second, until=until)
            assert (hits.t <= 1.0).all(), (hits.t > 1.0).sum()
            assert hits.t.max() > 0.9
        for start, goal, t in zip(*(rows[:9] for rows in ends), hits.t, strict=False):
            asked = start, goal, 0.5
            times = {'at': (at - 1) * second, 'until': at * second}
            assert scene.raycast(*asked, **times).t == t
            assert scene.raycast_all(*asked, **times)[0].t == t
    apart = np.tile([-0.5 - 2.0**-40, 0.5, 0.5], (len(starts), 1))
    assert np.isinf(scene.sweep_many(starts, apart, 0.5, at=second).t).all()


def test_a_ball_at_an_obstacle_that_was_beyond_all_doubles():
    """The obstacle's own frame has no place for the point that it touches."""
    scene = scene_of(Shapes.boxes([[0, 0, 0]], 1.0), stamp=0, velocities=[[1e300, 0, 0]])
    hit = scene.raycast([-5, 0, 0], [5, 0, 0], 0.5, at=-1e9, until=1e9)
    assert hit is not None
    assert np.isfinite(hit.point).all()


def test_however_far_or_small():
    """A ball's way may be longer than the world, come from afar, and the ball be next to
    nothing.
    """
    rng, count = np.random.default_rng(5), 70
    shapes = Shapes.boxes(rng.uniform(0, 20, (count, 3)), [1.5, 1.0, 0.5])
    scene = scene_of(shapes)
    boxes, met = boxes_of(scene), 0
    for far, radius in ((1.0, 1e-300), (1.0, 1e-13), (1e20, 0.2), (1e141, 0.2), (1e17, 0.2)):
        way = rng.normal(size=3) * 10
        target = shapes.position[rng.integers(count)]
        start = target - way * (far if far == 1e17 else 0.5)
        way *= 2 * far
        options = {'skip_inside': far == 1e141}
        hit = scene.raycast(start, start + way, radius, **options)
        goal = start + way
        sweep = Sweep(start.tolist(), (goal - start).tolist(), radius)
        first = expected_rows(boxes, sweep, **options)[:1]
        assert ([int(hit.name)] if hit else []) == first, (far, radius)
        many = scene.sweep_many(start[None], goal[None], radius, **options)
        assert many.t[0] == (hit.t if hit else np.inf)
        met += len(first)
    assert met >= 4
