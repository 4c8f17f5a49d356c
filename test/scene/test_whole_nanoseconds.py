# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A scene decides of whole nanoseconds, few of which are doubles of seconds: who is touched at the
last instant, as fractions tell it.
"""

from fractions import Fraction

import numpy as np
import pytest
from scene.reference import scene_of
from tree.reference import effort

from bvh_ros.scene import Scene, ShapeKind, Shapes

BOX, SPHERE, CYLINDER, *_ = ShapeKind

SECOND = 10**9
HALF = 1  # of every box
# When it began, and how often is told: 10, 30 and 100 Hz, each ns, nearly each second, and as
# rarely as 100 times in 23 days.
BEGINNINGS = 0, 1_790_000_000 * SECOND, -37
STEPS = SECOND // 10, SECOND // 30, SECOND // 100, 1, SECOND - 63, 20_000 * SECOND + 1


class Crowd:
    """Boxes that are told at some of many instants, and where they are at others."""

    def __init__(self, rng, most=None):
        count = int(rng.choice([1, 6, 40]))
        self.begin, self.step = int(rng.choice(BEGINNINGS)), int(rng.choice(STEPS))
        self.most = most
        self.position = rng.integers(-20, 20, (count, 3)).astype(float)
        self.velocity = rng.integers(-15, 16, (count, 3)) / rng.choice([1.0, 2.0, 4.0, 8.0])
        self.stamps = self.instants(rng, count, 30)
        self.scene = Scene(max_prediction=np.inf if most is None else float(most))
        shapes = Shapes.boxes(self.position, np.full((count, 3), 2 * HALF))
        names = [f'box{i}' for i in range(count)]
        told = {'stamp': self.stamps, 'velocities': self.velocity}
        self.scene.update('crowd', names, shapes, **told)
        self._places: dict[tuple[int, int], list[Fraction]] = {}

    def instants(self, rng, count, most):
        return self.begin + rng.integers(0, most, count) * self.step

    def __len__(self):
        return len(self.position)

    def place(self, i, time):
        """The middle of a box, exactly."""
        asked = i, int(time)
        if asked not in self._places:
            since = Fraction(asked[1] - int(self.stamps[i]), SECOND)
            if self.most is not None:
                since = min(since, self.most)
            rows = zip(self.position[i].tolist(), self.velocity[i].tolist(), strict=True)
            self._places[asked] = [Fraction(at) + Fraction(speed) * since for at, speed in rows]
        return self._places[asked]

    def touched(self, point, time):
        """Names of the boxes that a point touches."""
        point = [Fraction(x) for x in point.tolist()]
        return {
            f'box{i}'
            for i in range(len(self))
            if all(abs(x - y) <= HALF for x, y in zip(point, self.place(i, time), strict=True))
        }

    def met(self, start, goal, at, until):
        """{name: t} of the boxes that are met on the way."""
        found = {}
        start, goal = ([Fraction(x) for x in point.tolist()] for point in (start, goal))
        ways = [there - here for here, there in zip(start, goal, strict=True)]
        for i in range(len(self)):
            begin, end = self.place(i, at), self.place(i, until)
            gaps = [x - y for x, y in zip(begin, start, strict=True)]
            speeds = [way - y + x for way, x, y in zip(ways, begin, end, strict=True)]
            enter = reach(gaps, speeds, 0, 1)
            if enter is not None:
                found[f'box{i}'] = enter
        return found

    def first(self, start, goal, at, until, skip):
        """(t, name) of the first box that is met on the way, which stands from its end on; None
        without any.
        """
        found = []
        start, goal = ([Fraction(x) for x in point] for point in (start, goal))
        way = [y - x for x, y in zip(start, goal, strict=True)]
        for i in range(len(self)):
            end = int(self.stamps[i]) + int(self.most * SECOND)
            stop = Fraction(min(max(end - at, 0), until - at), max(until - at, 1))
            gaps = [x - y for x, y in zip(self.place(i, at), start, strict=True)]
            if skip and all(abs(gap) <= HALF for gap in gaps):
                continue
            gone = [x - y for x, y in zip(self.place(i, until), self.place(i, at), strict=True)]
            speeds = [x / stop if stop else x for x in gone]
            met = reach(gaps, [x - y for x, y in zip(way, speeds, strict=True)], 0, stop)
            if met is None:
                then = [x + y for x, y in zip(gaps, gone, strict=True)]
                met = reach(then, way, stop, 1)
            if met is not None:
                found.append((met, i))
        return min(found, default=None)

    def corners(self, rng, times):
        """Points that corners of boxes reach at these times, as nearly as doubles are."""
        points = [
            [float(x + side) for x, side in zip(self.place(i, time), sides, strict=True)]
            for time, i, sides in zip(
                *(times, rng.integers(len(self), size=len(times))),
                rng.integers(-1, 2, (len(times), 3)) * HALF,
                strict=True,
            )
        ]
        return np.array(points)


def reach(gaps, ways, first, last):
    """The least t from first to last at which no |gap - t * way| exceeds HALF, if there is one."""
    for gap, way in zip(gaps, ways, strict=True):
        if way == 0 and abs(gap) > HALF:
            return None
        if way != 0:
            ends = sorted(((gap - HALF) / way, (gap + HALF) / way))
            first, last = max(first, ends[0]), min(last, ends[1])
    return first if first <= last else None


@pytest.mark.parametrize('seed', range(effort(24, 400)))
def test_who_is_met_first_before_and_after_it_has_come_to_rest(seed):
    rng = np.random.default_rng(seed)
    crowd, skip, many = Crowd(rng, most=Fraction(int(rng.integers(9)), 4)), seed % 3 == 0, 30
    at = int(crowd.instants(rng, 1, 40)[0])
    until = at + int(rng.choice([0, 1, crowd.step, SECOND, 3 * SECOND, crowd.most * SECOND]))
    starts = rng.integers(-20, 20, (many, 3)).astype(float)
    goals = starts + rng.integers(-20, 20, starts.shape)
    when = {'skip_inside': skip, 'at': at, 'until': until}
    found = crowd.scene.raycast_many(starts, goals - starts, 1.0, **when)
    for row in range(many):
        wanted = crowd.first(starts[row].tolist(), goals[row].tolist(), at, until, skip)
        hit = crowd.scene.raycast(starts[row], goals[row], **when)
        assert (hit is None) == (wanted is None)
        assert found.t[row] == (np.inf if hit is None else hit.t)
        if hit is not None:
            assert hit.name == f'box{wanted[1]}'
            assert hit.t == pytest.approx(float(wanted[0]), rel=1e-15, abs=0.0)
            assert found.handles[row] == hit.handle


@pytest.mark.parametrize('seed', range(effort(24, 400)))
def test_who_is_touched_at_an_instant(seed):
    rng = np.random.default_rng(seed)
    crowd = Crowd(rng, most=Fraction(1, 2) if seed % 4 == 3 else None)
    times = crowd.instants(rng, 40, 90)
    points = crowd.corners(rng, times)
    wanted = [crowd.touched(*asked) for asked in zip(points, times, strict=True)]
    assert any(wanted)
    for point, time, names in zip(points, times, wanted, strict=True):
        assert {hit.name for hit in crowd.scene.overlap(point, point, at=int(time))} == names
    counts = crowd.scene.overlap_many(points, (0, 0, 0), want='count', at=times)
    assert counts.tolist() == [len(names) for names in wanted]


@pytest.mark.parametrize('seed', range(effort(24, 400)))
def test_who_is_met_until_an_instant(seed):
    rng = np.random.default_rng(seed)
    crowd = Crowd(rng)
    many = 2000 if seed % 8 == 7 else 40  # the more are swept for
    at = crowd.instants(rng, many, 60)
    until = at + rng.integers(1, 40, many) * crowd.step
    goals = crowd.corners(rng, until)
    starts = goals + rng.integers(-3, 4, goals.shape) * rng.integers(0, 2, (many, 1))
    whole = (starts + (goals - starts) == goals).all(axis=1)
    whole &= (goals - (goals - starts) == starts).all(axis=1)
    met = 0
    found = crowd.scene.raycast_many(starts, goals - starts, 1.0, at=at, until=until)
    for row in np.flatnonzero(whole)[:80]:
        way, when = (starts[row], goals[row]), (int(at[row]), int(until[row]))
        wanted = crowd.met(*way, *when)
        hits = crowd.scene.raycast_all(*way, at=when[0], until=when[1])
        assert {hit.name for hit in hits} == set(wanted)
        assert [wanted[hit.name] for hit in hits] == sorted(wanted.values())
        for hit in hits:
            assert hit.t == pytest.approx(float(wanted[hit.name]), rel=1e-15, abs=0.0)
        one = crowd.scene.raycast(*way, at=when[0], until=when[1])
        assert (None if one is None else one.name) == (hits[0].name if hits else None)
        assert found.t[row] == (hits[0].t if hits else np.inf)
        few = crowd.scene.raycast_many(
            *(starts[row : row + 1], (goals - starts)[row : row + 1], 1.0),
            at=when[0],
            until=when[1],
        )
        assert few.t.item() == found.t[row]
        met += bool(hits)
    assert met


def test_who_goes_on_for_no_whole_number_of_nanoseconds():
    """It is the nearest of them: after a third of a second at 3e9 m/s the rest makes a metre."""
    scene = Scene(max_prediction=1 / 3)
    assert scene.max_prediction == 0.333333333
    box = Shapes.boxes([[0.0, 0.0, 0.0]], [[1.0, 1.0, 1.0]])
    scene.update('s', ['fast'], box, stamp=0, velocities=[[3e9, 0.0, 0.0]])
    start, goal, when = [999999999.5, 0.5, 0.0], [1000000001.0, 0.5, 0.0], {'at': SECOND}
    for _ in range(3):
        assert scene.raycast(start, goal, **when).t == 0.0
        assert scene.raycast([1e9, 0.0, 0.0], [1e9 + 1, 0.0, 0.0], **when) is None
        found = scene.raycast_many([start] * 90, [[1.0, 0.0, 0.0]] * 90, 1.0, **when)
        assert (found.t == 0.0).all()
        assert scene.overlap(start, goal, **when)
        assert not scene.overlap([999999999.6, 0.0, 0.0], goal, **when)
        assert scene.nearest(goal, **when)[0].t == 1.5


@pytest.mark.parametrize('most', [None, 1])
def test_copies_know_whole_nanoseconds_and_who_stands(most):
    """A node keeps copies for questions about the past."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        crowd = Crowd(rng, most)
        scenes = crowd.scene, crowd.scene.copy(), crowd.scene.copy().copy()
        for time in crowd.instants(rng, 5, 90).tolist():
            for point in crowd.corners(rng, [time] * 4):
                touched = crowd.touched(point, time)
                for scene in scenes:
                    hits = scene.overlap(point, point, at=time)
                    assert {hit.name for hit in hits} == touched


@pytest.mark.parametrize('second', [0, 1, 3, 100, 2_000_000])
@pytest.mark.parametrize('late', [-1, 0, 1])
def test_who_stands_from_the_very_start_is_met_by_a_ball_that_begins_at_it(second, late):
    """It touches to the last digit, and goes into the box."""
    stamp = second * SECOND
    first = Shapes.boxes([[500.0, 0, 0]], [1, 1, 1])
    scene = scene_of(first, stamp=0, velocities=[[1.0, 0, 0]], max_prediction=1e-9)
    box = Shapes.boxes([[-5.5, -4.0, 1.0]], [[3.0, 2.5, 1.0]])
    scene.update('s', ['box'], box, stamp=stamp, velocities=[[-7.0, -3.0, -4.0]])
    start = np.array([-4.500000007, -3.500000003, 1.999999996])
    goal = start - np.array([357.0, 153.0, 204.0])
    at = stamp + 1 + late
    when = {'at': at, 'until': at + 51 * SECOND}
    hit = scene.raycast(start, goal, 0.5, **when)
    assert hit is not None
    assert hit.name == 'box'
    assert hit.t < 1e-9
    found = scene.sweep_many([start] * 80, [goal] * 80, 0.5, **when)
    assert (found.t == hit.t).all()


@pytest.mark.parametrize('days', [0, 1, 25])
@pytest.mark.parametrize('radius', [0.0, 0.25])
def test_other_shapes_are_where_they_are_after_weeks(days, radius):
    """Seconds on a clock that ran for weeks are rounded to half a nanosecond: 1e-8 m at 30 m/s."""
    rng, scene = np.random.default_rng(days), Scene(max_prediction=0.5)
    names, kinds, places = (['ball', 'box'], np.array([SPHERE, BOX], np.uint8), np.zeros((2, 3)))
    places[1, 1] = 9.0
    shapes = Shapes(kinds, places, [0, 0, 0, 1], np.ones((2, 3)))
    for stamp in (0, *(days * 86_400 * SECOND + rng.integers(1, SECOND, 50)).tolist()):
        scene.update('s', names, shapes, stamp=stamp, velocities=[[30.0, 0.0, 0.0]] * 2)
        at = stamp + int(rng.integers(0, SECOND))
        until = at + int(rng.integers(1, SECOND))
        gone = [30 * Fraction(min(time - stamp, SECOND // 2), SECOND) for time in (at, until)]
        rest = min(Fraction(max(stamp + SECOND // 2 - at, 0), until - at), 1)
        for y in (0.0, 9.0):
            start, goal, gap = [-5.0, y, 0.0], [95.0, y, 0.0], Fraction(9, 2) - Fraction(radius)
            frozen = scene.raycast(start, goal, radius, at=at).t
            assert abs(frozen * 100 - float(gap + gone[0])) < 1e-12 * 100
            met = (gap + gone[0]) / (100 - (gone[1] - gone[0]) / rest) if rest else Fraction(2)
            met = met if rest and met <= rest else (gap + gone[1]) / 100
            hit = scene.raycast(start, goal, radius, at=at, until=until)
            assert abs(hit.t - float(met)) * 100 < 1e-12 * 100
            assert abs(hit.point[0] - float(met * 100 - 5 + Fraction(radius))) < 1e-12 * 100
            many = scene.sweep_many([start] * 80, [goal] * 80, radius, at=at, until=until)
            assert (many.t == hit.t).all()
