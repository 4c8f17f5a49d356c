# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Questions about a scene at a time: as to a scene in which everybody stands where it is then."""

from typing import Any

import numpy as np
import pytest
from scene.meshes import TETRAHEDRON
from scene.reference import changed, scene_of
from turns import unit_quaternions

from bvh_ros.scene import Mesh, Scene, ShapeKind, Shapes

BOX, SPHERE, CYLINDER, *_ = ShapeKind

SECOND = 1_000_000_000
NOW = 1_790_000_000 * SECOND

COUNT = 24


def some_shapes(rng, count):
    """Boxes, turned boxes, spheres and cylinders."""
    kinds = np.array([BOX, BOX, SPHERE, CYLINDER], np.uint8)[np.arange(count) % 4]
    sizes, turns = rng.uniform(0.2, 3, (count, 3)), unit_quaternions(rng.normal(size=(count, 4)))
    sizes[kinds == CYLINDER, 1] = sizes[kinds == CYLINDER, 0]
    sizes[kinds == SPHERE] = sizes[kinds == SPHERE, :1]
    turns[::4] = 0.0, 0.0, 0.0, 1.0
    return Shapes(kinds, rng.uniform(-9, 9, (count, 3)), turns, sizes)


class Moving:
    """A scene of obstacles that move, and the same standing where they are at some time."""

    def __init__(self, rng, planar, max_prediction=np.inf):
        shapes = some_shapes(rng, COUNT)
        mesh = Shapes.of_meshes(
            [Mesh(TETRAHEDRON * (2, 2, 1))], rng.uniform(-9, 9, (1, 3)), [[0, 0, 0.6, 0.8]]
        )
        self.shapes, self.mesh, self.planar = shapes, mesh, planar
        self.names = [*(f'o{i}' for i in range(COUNT)), 'mesh']
        self.speeds = rng.normal(size=(COUNT + 1, 3)) * (rng.random((COUNT + 1, 1)) < 0.8) * 3
        self.stamps = NOW + rng.integers(0, SECOND, COUNT + 1)
        self.masks = (np.arange(COUNT + 1) % 3 + 1).astype(np.uint32)
        self.most = max_prediction
        self.scene = Scene(planar=planar, max_prediction=max_prediction)
        self._tell(self.scene, np.zeros((COUNT + 1, 3)), self.speeds)

    def _tell(self, scene, gone, speeds):
        for names, shapes, rows in (
            (self.names[:-1], self.shapes, slice(0, COUNT)),
            (self.names[-1:], self.mesh, slice(COUNT, None)),
        ):
            placed = changed(shapes, position=shapes.position + gone[rows])
            assert not scene.update(
                's',
                names,
                placed,
                stamp=self.stamps[rows],
                categories=self.masks[rows],
                velocities=None if speeds is None else speeds[rows],
            )

    def at(self, time):
        """The standing scene."""
        since = np.minimum((time - self.stamps) / SECOND, self.most)
        scene = Scene(planar=self.planar)
        self._tell(scene, self.speeds * since[:, None], None)
        return scene


def same_hits(hits, wanted):
    assert [hit.name for hit in hits] == [hit.name for hit in wanted]
    for hit, other in zip(hits, wanted, strict=True):
        assert hit[1:3] == (other.handle, pytest.approx(other.t, abs=1e-9))
        np.testing.assert_allclose(hit.point, other.point, atol=1e-6)
        np.testing.assert_allclose(hit.normal, other.normal, atol=1e-5)
        assert hit.stamp == other.stamp


@pytest.mark.slow
@pytest.mark.parametrize('planar', [False, True])
@pytest.mark.parametrize('most', [np.inf, 0.7])
def test_everything_is_as_where_all_stand_there(planar, most):
    rng = np.random.default_rng(11)
    moving = Moving(rng, planar, most)
    scene = moving.scene
    for number in range(12):
        time = NOW + int(rng.integers(-SECOND, 3 * SECOND))
        there, mask = moving.at(time), int(rng.choice([1, 2, 0xFFFFFFFF]))
        start, goal = np.sort(rng.uniform(-9, 9, (2, 3)), axis=0)
        turn = [0, 0, 0.6, 0.8] if number % 2 else [0, 0, 0, 1]
        reach = float(number % 3) * 0.7
        box = start, goal, turn, reach, mask
        same_hits(scene.overlap(*box, at=time), there.overlap(*box))
        for shape in (moving.mesh, moving.shapes.take([number]), moving.shapes.take([2])):
            placed = changed(shape, position=rng.uniform(-9, 9, (1, 3)))
            hits = scene.overlap_shape(placed, reach, mask, at=time)
            same_hits(hits, there.overlap_shape(placed, reach, mask))
        centers, sizes = rng.uniform(-9, 9, (9, 3)), rng.uniform(0, 5, (9, 3))
        tolerances, masks = rng.uniform(0, 1, 9), np.full(9, mask)
        asked = centers, sizes, None, tolerances, masks
        for want in ('any', 'count', 'first'):
            found = scene.overlap_many(*asked, want=want, at=time, threads=2)
            assert found.dtype == there.overlap_many(*asked, want=want).dtype
            assert found.tolist() == there.overlap_many(*asked, want=want).tolist()
        for want in ('all', 'hits'):
            found = scene.overlap_many(*asked, want=want, at=[time] * 9)
            for one, other in zip(found, there.overlap_many(*asked, want=want), strict=True):
                assert one.dtype == other.dtype
                np.testing.assert_allclose(one, other, atol=1e-6)
        found = scene.overlap_shape_many(moving.mesh, centers, want='all', at=time)
        wanted = there.overlap_shape_many(moving.mesh, centers, want='all')
        assert [part.tolist() for part in found] == [part.tolist() for part in wanted]
        for signed in (False, True):
            for k, limit in ((1, np.inf), (4, 3.0), (40, np.inf)):
                hits = scene.nearest(centers[0], k, limit, mask, signed, at=time)
                same_hits(hits, there.nearest(centers[0], k, limit, mask, signed))
                found = scene.nearest_many(centers, k, limit, masks, signed, at=time)
                wanted = there.nearest_many(centers, k, limit, masks, signed)
                for one, other in zip(found, wanted, strict=True):
                    assert one.dtype == other.dtype
                    np.testing.assert_allclose(one, other, atol=1e-6)
            found = scene.clearance_many(
                moving.shapes.take(np.arange(9)), 4.0, mask, signed, at=time
            )
            wanted = there.clearance_many(moving.shapes.take(np.arange(9)), 4.0, mask, signed)
            assert found[0].tolist() == wanted[0].tolist()
            np.testing.assert_allclose(found[1], wanted[1], atol=1e-9)
            name = moving.names[number]
            one, other = (
                s.clearance(name, signed, **t) for s, t in ((scene, {'at': time}), (there, {}))
            )
            assert (one.name, one.handle) == (other.name, other.handle)
            assert one.distance == pytest.approx(other.distance, abs=1e-9)
        for radius in (0.0, 0.4):
            way = start, goal, radius, mask
            for skip in (False, True):
                hits = scene.raycast_all(*way, skip, at=time)
                same_hits(hits, there.raycast_all(*way, skip))
                first = scene.raycast(*way, skip, at=time)
                assert [first.name if first else None] == [*(hit.name for hit in hits), None][:1]


@pytest.mark.slow
@pytest.mark.parametrize('planar', [False, True])
@pytest.mark.parametrize('most', [np.inf, 0.7])
def test_a_dense_batch_is_answered_as_each_of_its_points(planar, most):
    rng, count = np.random.default_rng(12), 150
    moving = Moving(rng, planar, most)
    points, times = rng.uniform(-9, 9, (count, 3)), NOW + rng.integers(-SECOND, 3 * SECOND, count)
    assert count >= len(moving.names)
    for k, limit, signed in ((1, np.inf, False), (3, 4.0, True), (40, np.inf, False)):
        asked = k, limit, 0xFFFFFFFF, signed
        handles, distances, _ = moving.scene.nearest_many(points, *asked, threads=2, at=times)
        for row, time in enumerate(times.tolist()):
            hits = moving.scene.nearest(points[row], *asked, at=time)
            assert handles[row, : len(hits)].tolist() == [hit.handle for hit in hits]
            assert distances[row, : len(hits)].tolist() == [hit.t for hit in hits]
            assert np.isinf(distances[row, len(hits) :]).all()


def test_what_is_kept_of_a_world_goes_with_it():
    """One question after the other, while arrays grow and somebody goes."""
    scene, at, up = Scene(), NOW + SECOND, [0.0, 1.0, 0.0]
    places = np.column_stack((np.arange(300.0), np.zeros((300, 2))))
    names = [str(number) for number in range(300)]

    def seen():
        touched = scene.overlap([-1, 0.9, -1], [400, 1.1, 1], at=at)
        near = [hit.name for hit in scene.nearest([0, 1, 0], 2, at=at)]
        ball = scene.raycast([-5, 1, 0], [400, 1, 0], 0.1, at=at)
        assert ball.name == near[0]
        return len(touched), near

    for count in (1, 2, 300):
        boxes = Shapes.boxes(places[:count], [0.5, 0.5, 0.5])
        scene.update('s', names[:count], boxes, stamp=NOW, velocities=[up] * count)
        assert seen() == (count, names[: min(2, count)])
    scene.update('s', ['0'], Shapes.boxes([[0, 5, 0]], [0.5, 0.5, 0.5]), stamp=NOW)
    assert seen() == (299, ['1', '2'])


@pytest.mark.parametrize('at', [0, np.empty(0, np.int64)])
def test_no_row_is_asked_at_no_time(at: Any):
    """Bounds are fitted to no time at the first question."""
    for ask in ('overlap_many', 'nearest_many', 'clearance_many'):
        none = np.empty((0, 3))
        boxes = Shapes.boxes([[0, 0, 0]], [1, 1, 1])
        scene = scene_of(boxes, names=['one'], stamp=0, velocities=[[1.0, 0, 0]])
        asked = {
            'overlap_many': (none, [1, 1, 1]),
            'nearest_many': (none,),
            'clearance_many': (Shapes.boxes(none, [1, 1, 1]),),
        }
        found = getattr(scene, ask)(*asked[ask], at=at)
        assert not len(found if ask == 'overlap_many' else found[0])


def test_what_is_refused_and_what_nothing_moves():
    scene = Scene()
    with pytest.raises(ValueError, match='max_prediction'):
        Scene(max_prediction=-1.0)
    box = Shapes.boxes([[5, 0, 0]], [1, 1, 1])
    for moving in (False, True):
        scene.update('s', ['one'], box, stamp=NOW, velocities=[[float(moving), 0, 0]])
        assert [h.name for h in scene.overlap([4, 0, 0], [5, 1, 1], at=NOW)] == ['one']
        assert scene.nearest([0, 0, 0], at=NOW + SECOND)[0].t == 4.5 + moving
        assert scene.clearance('one', at=NOW) is None
        assert scene.overlap_many(np.empty((0, 3)), [1, 1, 1], want='count', at=NOW).shape == (0,)
        assert scene.nearest_many(np.empty((0, 3)), 3, at=NOW)[0].shape == (0, 3)
        assert scene.nearest_many([[0, 0, 0]], 3, at=NOW)[0].shape == (1, 3)
        for wrong in (float('nan'), 'x', [1, 2], 1 << 70):
            for ask in (
                lambda t: scene.overlap([0, 0, 0], [1, 1, 1], at=t),
                lambda t: scene.nearest([0, 0, 0], at=t),
                lambda t: scene.overlap_many([[0, 0, 0]], [1, 1, 1], at=t),
                lambda t: scene.clearance('one', at=t),
                lambda t: scene.clearance_many(box, at=t),
            ):
                with pytest.raises(ValueError, match='at must be'):
                    ask(wrong)
    scene.update('s', ['fast'], box, stamp=NOW, velocities=[[1e300, -1e300, 0]])
    far = 1 << 62
    assert scene.nearest([0, 0, 0], 2, at=far)[0].name == 'one'
    assert scene.overlap([4, -1, -1], [6, 1, 1], at=far) == []
