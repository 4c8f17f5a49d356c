# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles that grow while nobody tells of them: as the same obstacles, standing where they are
predicted, asked with so much more of a reach each.
"""

import numpy as np
import pytest
from scene.reference import scene_of
from scene.test_then import COUNT, NOW, SECOND, Moving

from bvh_ros.scene import Scene, ShapeKind, Shapes

BOX, SPHERE, CYLINDER, *_ = ShapeKind

pytestmark = pytest.mark.slow
RATE = 0.4  # m/s


class Growing(Moving):
    """A scene of obstacles that move and grow, at a rate of metres a second."""

    def __init__(self, rng, planar, max_prediction, rate=RATE):
        super().__init__(rng, planar, max_prediction)
        self.scene = Scene(planar=planar, max_prediction=max_prediction, uncertainty=rate)
        self.rate = rate
        self._tell(self.scene, np.zeros((COUNT + 1, 3)), self.speeds)
        axes = slice(2 if planar else 3)
        self.moves = self.speeds[:, axes].any(axis=1)

    def growth(self, time):
        """Of each obstacle, by name."""
        grown = np.where(self.moves, self.rate * np.abs(time - self.stamps) / SECOND, 0.0)
        return dict(zip(self.names, grown, strict=True))


def worlds(rate=RATE):
    rng = np.random.default_rng(21)
    for planar in (False, True):
        for most in (np.inf, 0.7):
            growing = Growing(rng, planar, most, rate)
            for _ in range(6):
                yield rng, growing, NOW + int(rng.integers(-2 * SECOND, 4 * SECOND))


def test_overlaps_and_distances_are_those_of_what_has_grown():
    for rng, growing, time in worlds():
        scene, there, growth = growing.scene, growing.at(time), growing.growth(time)
        start, goal = np.sort(rng.uniform(-9, 9, (2, 3)), axis=0)
        middle, reach = start * 0.5 + goal * 0.5, 0.2
        near = {hit.name: hit for hit in there.nearest(middle, COUNT + 1)}
        hits = scene.overlap(start, goal, tolerance=reach, at=time)
        wanted = {
            name
            for name, grown in growth.items()
            if name in {h.name for h in there.overlap(start, goal, tolerance=reach + grown)}
        }
        assert {hit.name for hit in hits} == wanted
        assert [hit.t for hit in hits] == sorted(hit.t for hit in hits)
        for hit in hits:
            assert hit.t == pytest.approx(max(near[hit.name].t - growth[hit.name], 0), abs=1e-9)
        boxes = (start + goal)[None] / 2, (goal - start)[None], None, reach
        count = scene.overlap_many(*boxes, want='count', at=time)
        assert count == [len(hits)]
        for signed in (False, True):
            near = {hit.name: hit for hit in there.nearest(middle, COUNT + 1, signed=signed)}
            apart = {name: near[name].t - growth[name] for name in near}
            apart = apart if signed else {name: max(gap, 0.0) for name, gap in apart.items()}
            for k, limit in ((1, np.inf), (4, 3.0), (COUNT + 1, np.inf)):
                gaps = sorted(gap for gap in apart.values() if gap <= limit)[:k]
                hits = scene.nearest(middle, k, limit, signed=signed, at=time)
                assert [hit.t for hit in hits] == pytest.approx(gaps, abs=1e-9)
                handles, distances, points = scene.nearest_many(
                    [middle], k, limit, signed=signed, at=time
                )
                assert distances[0, : len(gaps)].tolist() == [hit.t for hit in hits]
                assert handles[0, : len(gaps)].tolist() == [hit.handle for hit in hits]
                axes = slice(2 if growing.planar else 3)
                for hit, point in zip(hits, points[0], strict=False):
                    assert hit.t == pytest.approx(apart[hit.name], abs=1e-9)
                    assert np.array_equal(hit.point, point)
                    length = np.linalg.norm((hit.point - middle)[axes])
                    assert length == pytest.approx(abs(hit.t), abs=1e-6)


def test_clearances_are_those_of_what_has_grown():
    for _, growing, time in worlds():
        scene, growth = growing.scene, growing.growth(time)
        shapes = growing.shapes.take(np.arange(5))
        for signed in (False, True):
            apart = {}
            for name in growing.names:  # alone: how far each is
                alone = growing.at(time)
                alone.remove('s', [other for other in growing.names if other != name])
                apart[name] = alone.clearance_many(shapes, signed=signed)[1] - growth[name]
            least = np.min(list(apart.values()), axis=0)
            least = least if signed else np.maximum(least, 0.0)
            _, found, points, others = scene.clearance_many(shapes, signed=signed, at=time)
            np.testing.assert_allclose(found, least, atol=1e-9)
            length = np.linalg.norm(points - others, axis=1)
            np.testing.assert_allclose(length, np.abs(found), atol=1e-6)
            one = scene.clearance('mesh', signed, at=time)
            two = scene.clearance(one.name, signed, at=time)
            assert two.distance <= one.distance + 1e-9  # both have grown, whoever is asked
            if one.distance > 0.0:
                pair = growing.at(time)
                kept = {'mesh', one.name}
                pair.remove('s', [other for other in growing.names if other not in kept])
                gap = pair.clearance('mesh').distance - growth['mesh'] - growth[one.name]
                assert one.distance == pytest.approx(gap, abs=1e-9)


@pytest.mark.parametrize('rate', [0.0, RATE])
def test_rays_and_balls_never_miss_what_has_grown(rate):
    for rng, growing, time in worlds(rate):
        scene, axes = growing.scene, slice(2 if growing.planar else 3)
        start, goal = rng.uniform(-9, 9, (2, 3))
        until = time + int(rng.integers(0, 2 * SECOND))
        for radius in (0.0, 0.3):
            there, growth = growing.at(time), growing.growth(time)
            hits = scene.raycast_all(start, goal, radius, at=time)
            wanted = {}
            for name, grown in growth.items():
                for hit in there.raycast_all(start, goal, radius + grown):
                    if hit.name == name:
                        wanted[name] = hit.t
            assert {hit.name for hit in hits} == set(wanted)
            for hit in hits:
                assert hit.t == pytest.approx(wanted[hit.name], abs=1e-9)
            hits = scene.raycast_all(start, goal, radius, at=time, until=until)
            met, last = {hit.name: hit.t for hit in hits}, growing.growth(until)
            for t in np.linspace(0.0, 1.0, 40):
                then = time + round(t * (until - time))
                place, growth = start + t * (goal - start), growing.growth(then)
                for hit in growing.at(then).nearest(place, COUNT + 1):
                    if hit.t < radius + growth[hit.name] - 1e-6:
                        assert met[hit.name] <= t + 1e-6
            for hit in hits:  # and it is met as large as it is at either end
                then = time + round(hit.t * (until - time))
                place = start + hit.t * (goal - start)
                near = {h.name: h for h in growing.at(then).nearest(place, COUNT + 1)}[hit.name]
                most = radius + max(last[hit.name], growing.growth(time)[hit.name])
                assert near.t == pytest.approx(most, abs=1e-6) or (hit.t == 0 and near.t < most)
                assert np.linalg.norm((hit.point - place)[axes]) < most + 1e-6
            assert [hit.t for hit in hits] == sorted(met.values())
            first = scene.raycast(start, goal, radius, at=time, until=until)
            many = scene.sweep_many([start] * 2, [goal] * 2, radius, at=time, until=until)
            assert ([first.t] * 2 if first else [np.inf] * 2) == many.t.tolist()


@pytest.mark.parametrize('planar', [False, True])
@pytest.mark.parametrize('most', [np.inf, 0.7])
def test_who_begins_within_what_has_grown_is_there(planar, most):
    """t is 0, the point the start, and there is no normal; outside there is, and it leads out."""
    rng, axes = np.random.default_rng(5), slice(2 if planar else 3)
    growing, seen = Growing(rng, planar, most), set()
    scene = growing.scene
    for _ in range(200):
        start, goal = rng.uniform(-9, 9, (2, 3))
        time = NOW + int(rng.integers(-2 * SECOND, 4 * SECOND))
        near = {hit.name: hit.t for hit in scene.nearest(start, COUNT + 1, at=time)}
        for radius in (0.0, 0.6):
            for until in (None, time):
                times = {'at': time, 'until': until}
                hits = scene.raycast_all(start, goal, radius, **times)
                many = scene.sweep_many([start] * 2, [goal] * 2, radius, **times)
                first = scene.raycast(start, goal, radius, **times)
                if hits:
                    assert (
                        many.points[0].tolist() == first.point.tolist() == hits[0].point.tolist()
                    )
                    normals = many.normals[0].tolist(), first.normal.tolist()
                    assert normals == (hits[0].normal.tolist(),) * 2
                for hit in hits:
                    if hit.t > 0.0:
                        continue
                    within = near[hit.name] == 0.0
                    seen.add((within, radius))
                    assert hit.normal.any() != within
                    way = (start - hit.point)[axes]
                    assert within == (not way.any())
                    if not within:
                        assert np.linalg.norm(way) == pytest.approx(near[hit.name], abs=1e-9)
                        assert way @ hit.normal[axes] > 0.0
    assert seen == {(True, 0.0), (True, 0.6), (False, 0.6)}


def test_what_does_not_grow_and_what_is_refused():
    for wrong in (-1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match='uncertainty'):
            Scene(uncertainty=wrong)
    boxes, speeds = Shapes.boxes([[5, 0, 0], [0, 5, 0]], [1, 1, 1]), [[0, 0, 1], [0, 0, 0]]
    scene = scene_of(boxes, stamp=NOW, velocities=speeds, uncertainty=1.0)
    later = NOW + 2 * SECOND
    assert {h.name: h.t for h in scene.nearest([0, 0, 2], 2, at=later)}['0'] == 2.5
    assert scene.nearest([0, 3, 0], at=later)[0].t == 1.5
    assert scene.nearest([5, 0, 3])[0].t == 2.5  # as last told
    assert scene.nearest([5, 0, 3], at=NOW)[0].t == 2.5
    with pytest.raises(ValueError, match='t_max must end the path where obstacles grow: row 0'):
        scene.raycast_many([[0, 0, 0]], [[1, 0, 0]], at=later)


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('kind', [BOX, SPHERE])
@pytest.mark.parametrize('rate', [1e290, 1e300, 1e308])
def test_who_may_be_anywhere_is_met_everywhere(rate, kind):
    """Also where a growth is beyond the doubles."""
    shape = Shapes([kind], [[50, 0, 0]], [0, 0, 0, 1], 1)
    scene = scene_of(shape, stamp=NOW, velocities=[[1e-9, 0, 0]], uncertainty=rate)
    start, goal, at = [0, 0, 0], [9, 0, 0], NOW + 10**9 * SECOND
    for radius in (0.0, 0.2):
        for until in (None, at + SECOND):
            first = scene.raycast(start, goal, radius, at=at, until=until)
            every = scene.raycast_all(start, goal, radius, at=at, until=until)
            many = scene.sweep_many([start] * 2, [goal] * 2, radius, at=at, until=until)
            for t, point, normal in (first[2:5], every[0][2:5], [rows[1] for rows in many[1:]]):
                assert (t, point.tolist(), normal.tolist()) == (0.0, start, [0, 0, 0])
    assert scene.nearest(start, at=at)[0].t == 0.0
    assert scene.overlap_many([start], [1, 1, 1], want='count', at=at) == [1]
