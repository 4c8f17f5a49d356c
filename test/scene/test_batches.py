# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Each row of a batch of questions is what the single question says, bit for bit."""

import math
from functools import partial

import numpy as np
import pytest
from hypothesis import strategies as st
from scene.inside import store_of
from scene.reference import bulging, changed, random_shapes, random_turns, scene_of

from bvh_ros.scene import NO_NODE, Mesh, NodeScene, Numbered, Part, Shapes

NOBODY = np.full(3, np.nan)


def same(one, other):
    np.testing.assert_array_equal(np.asarray(one), np.asarray(other), strict=True)


def scene_with(shapes, planar, masks, meshes=0):
    rng = np.random.default_rng(2)
    scene = scene_of(shapes, planar, of=NodeScene, categories=masks, margin=0.1)
    if meshes:
        held = [Mesh(bulging(rng)) for _ in range(meshes)]
        rows = Shapes.of_meshes(held, rng.uniform(-4, 4, (meshes, 3)), random_turns(rng, meshes))
        scene.update('test', [f'mesh{i}' for i in range(meshes)], rows, stamp=1)
    return scene


def lattice_shapes(rng, count):
    """Boxes whose faces and edges meet: ties, and distances that are a tolerance exactly."""
    size = rng.integers(0, 4, (count, 3)) * 0.5
    return Shapes.boxes(rng.integers(-8, 9, (count, 3)) * 0.5, size)


SCENES = [(False, 'boxes'), (False, 'mixed'), pytest.param((True, 'mesh'), marks=pytest.mark.slow)]


@pytest.fixture(scope='module', params=SCENES, ids=str)
def world(request):
    planar, kind = request.param
    rng = np.random.default_rng([7, planar])
    count = 60
    shapes = lattice_shapes(rng, count) if kind == 'boxes' else random_shapes(rng, count)
    masks = rng.integers(1, 4, count)
    return scene_with(shapes, planar, masks, 4 if kind == 'mesh' else 0), rng


def points_of(rng, count):
    """Half of them on the lattice of the boxes."""
    points = rng.uniform(-6, 6, (count, 3))
    points[::2] = np.round(points[::2] * 2) / 2
    return points


def as_row(hit):
    if hit is None:
        return NO_NODE, math.inf, NOBODY, np.zeros(3)
    return hit.handle, hit.t, hit.point, hit.normal


def assert_wants(lists, ask, *asked):
    """All forms of an answer say what these lists of hits say."""
    ask = partial(ask, *asked)
    handles = [[hit.handle for hit in hits] for hits in lists]
    for threads in (1, 3):
        same(ask(want='any', threads=threads), np.array([bool(row) for row in handles], bool))
        same(ask(want='count', threads=threads), np.array([*map(len, handles)], np.int64))
        firsts = [row[0] if row else NO_NODE for row in handles]
        same(ask(want='first', threads=threads), np.array(firsts, np.uint32))
        told = ask(want='hits', threads=threads)
        same(told.handles, np.array(firsts, np.uint32))
        same(told.counts, np.array([*map(len, handles)], np.int64))
        same(told.distances, np.array([hits[0].t if hits else math.inf for hits in lists]))
        same(told.points, np.array([hits[0].point if hits else NOBODY for hits in lists]))
        offsets, found = ask(want='all', threads=threads)
        same(offsets, np.cumsum([0, *map(len, handles)]))
        same(found, np.array([h for row in handles for h in row], np.uint32))
    assert any(handles)


def test_overlaps_of_boxes(world):
    scene, rng = world
    centers, sizes = points_of(rng, 200), rng.integers(0, 5, (200, 3)) * 0.25
    turns = random_turns(rng, 200)
    turns[:100] = (0.0, 0.0, 0.0, 1.0)
    tolerances, masks = rng.choice([0.0, 0.5, 0.25], 200), rng.integers(0, 4, 200)
    lists = [
        scene.overlap_shape(Shapes.boxes([c], s, [q]), float(t), int(m))
        for c, s, q, t, m in zip(centers, sizes, turns, tolerances, masks, strict=True)
    ]
    assert_wants(lists, scene.overlap_many, centers, sizes, turns, tolerances, masks)
    one = [scene.overlap_shape(Shapes.boxes([c], [0.5, 1, 0.5]), 0.5) for c in centers[:80]]
    assert_wants(one, scene.overlap_many, centers[:80], [0.5, 1, 0.5], None, 0.5)


def test_overlaps_of_one_shape(world):
    scene, rng = world
    every = random_shapes(rng, 40)
    mesh = Shapes.of_meshes([Mesh(bulging(rng))], [[0, 0, 0]])
    forms = [every.take(np.flatnonzero(every.kind == kind)[:1]) for kind in range(4)]
    for shape in [*forms, mesh]:
        places, turns = points_of(rng, 40), random_turns(rng, 40)
        for orientations in (turns, None):
            rows = np.tile(shape.orientation, (40, 1)) if orientations is None else orientations
            lists = [
                scene.overlap_shape(changed(shape, position=p[None], orientation=q[None]), 0.1, 3)
                for p, q in zip(places, rows, strict=True)
            ]
            assert_wants(lists, scene.overlap_shape_many, shape, places, orientations, 0.1, 3)


def test_many_points_are_answered_in_their_places(world):
    scene, rng = world
    points = points_of(rng, 1200)  # asked in the order of neighbours
    parts = [scene.nearest_many(some, 2) for some in np.split(points, 4)]
    for told, few in zip(scene.nearest_many(points, 2), zip(*parts, strict=True), strict=True):
        same(told, np.concatenate(few))


@pytest.mark.parametrize('k', [1, 3, 100])
@pytest.mark.parametrize('signed', [False, True])
def test_nearest(world, k, signed):
    scene, rng = world
    points, masks = points_of(rng, 150), rng.integers(0, 4, 150)
    reaches = rng.choice([0.5, 2.0, math.inf], 150)
    ones = [
        scene.nearest(p, k, float(r), int(m), signed)
        for p, r, m in zip(points, reaches, masks, strict=True)
    ]
    for threads in (1, 3):
        told = scene.nearest_many(points, k, reaches, masks, signed, threads)
        handles, distances, where = told
        assert handles.shape == distances.shape == where.shape[:2] == (150, k)
        for i, hits in enumerate(ones):
            rest = k - len(hits)
            same(handles[i], np.array([hit.handle for hit in hits] + [NO_NODE] * rest, np.uint32))
            same(distances[i], np.array([hit.t for hit in hits] + [math.inf] * rest))
            same(where[i], np.array([hit.point for hit in hits] + [NOBODY] * rest))


@pytest.mark.parametrize('signed', [False, True])
def test_clearances(world, signed):
    """As an obstacle of the same shape has it in the same scene."""
    scene, rng = world
    shapes, masks = random_shapes(rng, 40), rng.integers(1, 4, 40)
    names, kept = scene.names(), scene.handles()
    for threads in (1, 3):
        told = scene.clearance_many(shapes, signed=signed, threads=threads)
        handles, distances, points, others = told
        for i in range(40):
            scene.update('other', ['asked'], shapes.take([i]), stamp=2)
            found = scene.clearance('asked', signed)
            scene.remove('other', ['asked'])
            same([handles[i], distances[i]], [found.handle, found.distance])
            same(np.stack((points[i], others[i])), np.stack((found.point, found.other_point)))
    assert 0 < (distances <= 0.0).sum() < 40
    assert (distances.min() < 0.0) == signed
    assert len(names) == len(kept) == len(scene)
    reach = max(float(np.median(distances)), 0.0)
    near = scene.clearance_many(shapes, reach, signed=signed)
    same(near[0], np.where(distances <= reach, handles, NO_NODE).astype(np.uint32))
    same(near[1], np.where(distances <= reach, distances, math.inf))
    seen = scene.clearance_many(shapes, mask=masks, signed=signed)
    same(seen[1] >= distances, np.ones(40, bool))


boxes = st.tuples(*[st.integers(-3, 3)] * 3, *[st.integers(0, 3)] * 3)


def test_an_obstacle_at_two_places_is_one(set_slices):
    """Halfway through an update in slices, see slicing.py."""
    set_slices(20, 30)
    rng = np.random.default_rng(5)
    before = random_shapes(rng, 60)
    scene = scene_of(before, names=Numbered('c#', np.arange(60)), of=NodeScene)
    after = changed(before, position=before.position + 0.4)
    parts = (
        Part(Numbered('c#', rows), after.take(rows), 2) for rows in np.arange(60).reshape(2, 30)
    )
    update = scene.in_slices('test', '', 60, lambda length: parts, whole=True)
    next(update)
    assert len(store_of(scene).tree) > len(scene) == 60
    points = rng.uniform(-6, 6, (60, 3))
    lists = [scene.overlap_shape(Shapes.boxes([p], [1, 1, 1]), 0.3) for p in points]
    assert_wants(lists, scene.overlap_many, points, [1, 1, 1], None, 0.3)
    handles = scene.nearest_many(points, 5)[0]
    same(handles, np.array([[h.handle for h in scene.nearest(p, 5)] for p in points], np.uint32))
    ways = points[::-1]
    hits = scene.sweep_many(points, ways, 0.3)
    expected = [as_row(scene.raycast(*row, 0.3))[1] for row in zip(points, ways, strict=True)]
    same(hits.t, np.array(expected))


def test_nothing_is_asked(world):
    scene, _ = world
    none = np.empty((0, 3))
    assert [len(column) for column in scene.sweep_many(none, none, 0.5)] == [0] * 4
    same(scene.overlap_many(none, none), np.empty(0, bool))
    offsets, handles = scene.overlap_shape_many(
        Shapes.boxes([[0, 0, 0]], [1, 1, 1]), none, want='all'
    )
    assert offsets.tolist() == [0]
    assert handles.dtype == np.uint32
    assert [column.shape for column in scene.nearest_many(none, 2)] == [(0, 2), (0, 2), (0, 2, 3)]
    assert [len(column) for column in scene.clearance_many(Shapes.boxes(none, [1, 1, 1]))] == [
        0
    ] * 4
    empty = NodeScene(planar=scene.planar)
    assert empty.overlap_many([[0, 0, 0]], [1, 1, 1], want='first').tolist() == [NO_NODE]
    assert empty.nearest_many([[0, 0, 0]])[1].tolist() == [[math.inf]]
    assert empty.clearance_many(SHAPE)[0].tolist() == [NO_NODE]
    assert empty.sweep_many([[0, 0, 0]], [[1, 0, 0]], 0.5).handles.tolist() == [NO_NODE]


POINT, NAN, ONE = [[0.0, 0, 0]] * 2, [[0.0, 0, 0], [0, math.nan, 0]], [1, 1, 1]
SHAPE = Shapes.boxes([[0, 0, 0]], ONE)


@pytest.mark.parametrize(
    ('query', 'arguments', 'said'),
    [
        ('sweep_many', (NAN, POINT), 'starts.* row 1'),
        ('sweep_many', (POINT, POINT[:1]), 'goals'),
        ('sweep_many', (POINT, NAN), 'goals.* row 1'),
        ('sweep_many', ([[-1e308, 0, 0]], [[1e308, 0, 0]]), 'row 0'),
        ('sweep_many', (POINT, POINT, [1.0, -1.0]), 'radius.* row 1'),
        ('sweep_many', (POINT, POINT, [1.0, math.inf]), 'radius.* row 1'),
        ('sweep_many', (POINT, POINT, [1.0]), 'radius'),
        ('sweep_many', (POINT, POINT, 0.0, [1, -1]), 'mask.* row 1'),
        ('sweep_many', (POINT, POINT, 0.0, 1, False, 0), 'threads'),
        ('raycast_many', (POINT, [ONE] * 2, [1, math.inf], 1, False, 1, 0.5), 't_max.* row 1'),
        ('overlap_many', (NAN, ONE), 'centers.* row 1'),
        ('overlap_many', (POINT, NAN), 'sizes.* row 1'),
        ('overlap_many', (POINT, [ONE, [1, -1, 1]]), 'row 1 .*negative'),
        ('overlap_many', (POINT, [1, 1]), 'sizes'),
        ('overlap_many', (POINT, ONE, [[0, 0, 0, math.inf]] * 2), 'orientations.* row 0'),
        ('overlap_many', (POINT, ONE, None, [0.0, math.nan]), 'tolerance.* row 1'),
        ('overlap_many', (POINT, ONE, None, math.inf), 'tolerance'),
        ('overlap_many', (POINT, ONE, None, 0.0, 1, 'some'), 'want'),
        ('overlap_many', (POINT, ONE, None, 0.0, 1, ['any']), 'want'),
        ('overlap_many', ([[1e308] * 3], [1.7e308] * 3, [[1, 2, 3, 4]]), 'row 0'),
        ('overlap_shape_many', (Shapes.boxes(POINT, ONE), POINT), 'one row'),
        ('overlap_shape_many', (changed(SHAPE, kind=np.array([9])), POINT), 'row 0'),
        ('overlap_shape_many', (SHAPE, NAN), 'positions.* row 1'),
        ('overlap_shape_many', ('box', POINT), 'Shapes'),
        ('nearest_many', (NAN,), 'points.* row 1'),
        ('nearest_many', (POINT, 0), r'\bk\b'),
        ('nearest_many', (POINT, 1, [1.0, -1.0]), 'max_distance.* row 1'),
        ('clearance_many', (changed(Shapes.boxes(POINT, ONE), position=np.array(NAN)),), 'row 1'),
        ('clearance_many', (Shapes.boxes(POINT, ONE), math.nan), 'max_distance'),
        ('clearance_many', (Shapes.boxes(POINT, ONE), 1.0, 1, False, 1.5), 'threads'),
    ],
)
def test_bad_input_is_refused(query, arguments, said):
    with pytest.raises(ValueError, match=said):
        getattr(NodeScene(), query)(*arguments)


def test_balls_that_may_touch_more_than_there_is_room_for():
    """The room is kept by each thread, and made larger where a ball wants it."""
    for planar in (False, True, False):
        scene = scene_of(Shapes.boxes(np.ones((70, 3)), 1), planar)
        starts = np.array([[-5.0, 1, 1], [-5, 9, 1], [-5, 1.2, 1]])
        goals = np.add(starts, [9, 0, 0])
        for threads in (1, 2):
            found = scene.sweep_many(starts, goals, 0.25, threads=threads)
            assert found.handles.tolist() == [1, NO_NODE, 1]
            assert found.t[0] == pytest.approx(5.25 / 9)


@pytest.mark.parametrize('radius', [None, 0.0, 0.5, [0.0, 0.5, 0.0, 0.5, 0.5]])
@pytest.mark.parametrize('planar', [False, True])
@pytest.mark.parametrize('turned', [False, True])
def test_no_kernel_answers_what_is_not_finite(planar, turned, radius):
    turn = [[0.0, 0.0, 0.3, 0.95]] if turned else None
    scene = scene_of(Shapes.boxes([[0.0] * 3], [1.0] * 3, turn), planar)
    good, rows = np.ones((5, 3)), np.full((5, 3), 30.0)
    for axis in range(3):
        for bad in np.nan, np.inf, -np.inf:
            rows[3] = 30.0
            rows[3, axis] = bad
            with pytest.raises(ValueError, match='origins must be finite: row 3'):
                scene.raycast_many(rows, good, 1.0, radius=radius)
            with pytest.raises(ValueError, match='directions must be finite: row 3'):
                scene.raycast_many(good, rows, 0.0, radius=radius)
    if radius:
        with pytest.raises(ValueError, match='end the path of a ball: row 3 has no end'):
            scene.raycast_many(good, good, [1, 1, 1, np.inf, 1], radius=radius)
