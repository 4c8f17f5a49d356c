# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Convex meshes: against the same solids given otherwise, and python-fcl."""

import math

import fcl
import numpy as np
import pytest
from scene.reference import box_of_triangles, bulging, icosphere, scene_of
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from bvh_ros.scene import Mesh, Scene, ShapeKind, Shapes
from bvh_ros.scene.shapes.hull import MeshStore

CUBE = box_of_triangles((1, 1, 1))


@pytest.mark.parametrize(
    ('triangles', 'words'),
    [
        (np.empty((0, 3, 3)), 'must have shape'),
        (np.zeros((4, 3)), 'must have shape'),
        (
            np.where(np.arange(108).reshape(12, 3, 3) == 9, np.nan, CUBE),
            'triangle 1 is not finite',
        ),
        (CUBE[:-1], 'not closed'),
        (CUBE[:1], 'flat'),
        (np.concatenate([CUBE, [[*CUBE[0, :2], (0, 0, 0)]]]), 'triangle 0 belongs to 3 triangles'),
        (np.concatenate([CUBE, np.full((1, 3, 3), 0.1)]), 'triangle 12 has no area'),
        (np.full((3, 3, 3), 0.1), 'no triangle with an area'),
        (CUBE * (1, 1, 1e-8), 'flat'),
        (np.concatenate([CUBE[:1], CUBE[:1]]), 'flat'),
        (np.concatenate([CUBE, CUBE + 3.0]), 'convex'),
        (CUBE * 1e-150, 'too small'),
    ],
)
def test_what_is_no_convex_solid_is_refused(triangles, words):
    with pytest.raises(ValueError, match=words):
        Mesh(triangles)


def test_a_dent_is_refused_and_float32_is_not():
    rng = np.random.default_rng(1)
    round_one = bulging(rng, 200)
    assert len(Mesh(round_one.astype(np.float32)).vertices) == 200
    dented = (
        np.where((round_one == round_one[0, 0]).all(axis=2, keepdims=True), 0.3, 1) * round_one
    )
    with pytest.raises(ValueError, match='not convex'):
        Mesh(dented)


def test_a_row_needs_its_mesh():
    cube = Mesh(CUBE)
    rows = Shapes.of_meshes([cube, cube], np.zeros((2, 3)))
    assert rows.mesh is not None
    rows.mesh[0] = None
    scene = Scene()
    (refusal,) = scene.update('test', ['a', 'b'], rows, stamp=1)
    assert (refusal.name, 'needs its Mesh' in refusal.reason) == ('a', True)
    (refusal,) = scene.update(
        'test', ['c'], rows.take([1])._replace(size=np.ones((1, 3)) * 2), stamp=1
    )
    assert 'size of it' in refusal.reason


def test_boxes_given_as_triangles_answer_as_boxes():
    rng = np.random.default_rng(2)
    count = 40
    sizes, places = rng.uniform(0.2, 2, (count, 3)), rng.uniform(-4, 4, (count, 3))
    turns, shift = rng.normal(size=(count, 4)), rng.uniform(-1, 1, (count, 3))
    turns[:5] = 0.0
    unit = np.where(turns.any(axis=1)[:, None], turns, (0, 0, 0, 1))
    # The triangles need not lie about the origin of their frame.
    meshes = [Mesh(box_of_triangles(size) + by) for size, by in zip(sizes, shift, strict=True)]
    frames = places - Rotation.from_quat(unit).apply(shift)
    plain = scene_of(Shapes.boxes(places, sizes, turns))
    meshed = scene_of(Shapes.of_meshes(meshes, frames, turns))
    assert sorted(plain.overlap_pairs()) == sorted(meshed.overlap_pairs()) != []
    hits = 0
    for _ in range(150):
        start, goal = rng.uniform(-6, 6, (2, 3))
        for radius in (0.0, 0.4):
            one, other = (
                plain.raycast_all(start, goal, radius),
                meshed.raycast_all(start, goal, radius),
            )
            assert {hit.name for hit in one} == {hit.name for hit in other}
            by_name = {hit.name: hit for hit in other}
            for hit in one:
                hits += 1
                twin = by_name[hit.name]
                assert twin.t == pytest.approx(hit.t, abs=1e-9)
                assert twin.point == pytest.approx(hit.point, abs=1e-6)
                assert twin.normal == pytest.approx(hit.normal, abs=1e-6)
        query = (start, start + goal / 3, rng.normal(size=4))
        for tolerance in (0.0, 0.5):
            one, other = plain.overlap(*query, tolerance), meshed.overlap(*query, tolerance)
            assert [hit.name for hit in one] == [hit.name for hit in other]
            for hit, twin in zip(one, other, strict=True):
                assert twin.point == pytest.approx(hit.point, abs=1e-9)
    assert hits > 300


def test_an_inside_counts():
    """A mesh is solid: what is wholly within it touches it."""
    scene = scene_of(
        Shapes.of_meshes([Mesh(box_of_triangles((4, 4, 4)))], [(0, 0, 0)], [(0.1, 0.2, 0, 1)])
    )
    assert scene.overlap((0, 0, 0), (0.1, 0.1, 0.1))[0].t == 0.0
    assert scene.overlap((0, 0, 0), (0, 0, 0))[0].normal.tolist() == [0, 0, 0]
    assert scene.raycast((0, 0, 0), (9, 0, 0)).t == 0.0
    assert scene.raycast((0, 0, 0), (9, 0, 0), 0.1).t == 0.0
    assert scene.raycast((0, 0, 0), (9, 0, 0), skip_inside=True) is None


def as_model(mesh, place, turn):
    x, y, z, w = turn
    hull = ConvexHull(mesh.vertices)
    model = fcl.BVHModel()
    model.beginModel(len(mesh.vertices), len(hull.simplices))
    model.addSubModel(mesh.vertices, hull.simplices)
    model.endModel()
    return fcl.CollisionObject(model, fcl.Transform(np.array([w, x, y, z]), np.asarray(place)))


def test_pairs_of_meshes_and_mesh_queries_are_as_far_apart_as_python_fcl_says():
    rng = np.random.default_rng(4)
    sizes = [*rng.integers(5, 40, 30), *rng.integers(70, 300, 10)]  # the larger are climbed
    meshes = [Mesh(bulging(rng, int(size))) for size in sizes]
    turns = rng.normal(size=(40, 4))
    turns /= np.linalg.norm(turns, axis=1)[:, None]
    rows = Shapes.of_meshes(meshes, rng.uniform(-2.5, 2.5, (40, 3)), turns)
    scene = scene_of(rows)
    centres = np.array([scene.get(str(i)).position for i in range(40)])
    models = [as_model(*row) for row in zip(meshes, centres, turns, strict=True)]

    def holds(i, j):
        """Whether mesh i has a corner of j inside: to python-fcl meshes are surfaces."""
        corner = Rotation.from_quat(turns[j]).apply(meshes[j].vertices[0]) + centres[j]
        local = Rotation.from_quat(turns[i]).inv().apply(corner - centres[i])
        faces = meshes[i].vertices[meshes[i].corners[:, 0]]
        return (np.einsum('ni,ni->n', meshes[i].normals, local - faces) <= 0.0).all()

    pairs = set(scene.overlap_pairs())
    assert 20 < len(pairs) < 500
    for i in range(40):
        found = {hit.name for hit in scene.overlap_shape(rows.take([i]), 0.3)}
        for j in range(40):
            distance = fcl.distance(models[i], models[j])
            if holds(i, j) or holds(j, i):
                distance = 0.0
            if i < j:
                assert ((str(i), str(j)) in pairs) == (distance <= 0.0)
            assert (str(j) in found) == (distance <= 0.3)


def test_a_ball_touches_a_mesh_of_many_faces_where_python_fcl_says():
    rng = np.random.default_rng(9)
    mesh, place, turn = Mesh(icosphere(3) * (1, 0.6, 0.3)), (0.5, -0.2, 0.1), rng.normal(size=4)
    turn /= np.linalg.norm(turn)
    scene = scene_of(Shapes.of_meshes([mesh], [place], [turn]))
    model = as_model(mesh, scene.get('0').position, turn)
    hits = 0

    def distance(centre):
        ball = fcl.CollisionObject(fcl.Sphere(0.25), fcl.Transform(centre))
        return fcl.distance(ball, model)

    for _ in range(60):
        start = rng.normal(size=3)
        start *= 3 / np.linalg.norm(start)
        goal = rng.normal(size=3) * 1.2 - start
        hit = scene.raycast(start, goal, 0.25)
        if hit is None:
            steps = np.linspace(0, 1, 200)[:, None]
            assert min(distance(at) for at in start + steps * (goal - start)) > 0.0
            continue
        hits += 1
        centre = start + hit.t * (goal - start)
        assert distance(centre - 1e-6 * (goal - start)) == pytest.approx(0.0, abs=1e-5)
        assert np.linalg.norm(hit.point - centre) == pytest.approx(0.25, abs=1e-9)
        assert hit.normal == pytest.approx((centre - hit.point) / 0.25, abs=1e-6)
    assert 15 < hits < 60


def test_a_mesh_is_kept_once_and_forgotten_with_its_last_obstacle():
    mesh, other = CUBE, CUBE * 2
    scene = scene_of(Shapes.of_meshes([Mesh(mesh), Mesh(mesh), Mesh(other)], np.eye(3) * 9))
    store = scene._held.columns.meshes
    assert len(store) == 2
    first = store.hulls
    moved = Shapes.of_meshes([Mesh(mesh)], [(5, 5, 5)])
    assert scene.update('test', ['0'], moved, stamp=2) == []
    assert store.hulls is first
    assert scene.raycast((5, 5, 0), (5, 5, 9)).name == '0'
    scene.remove('test', ['2'])
    assert len(store) == 1
    assert scene.update('test', ['0', '1'], Shapes.boxes(np.eye(3)[:2], (1, 1, 1)), stamp=3) == []
    assert len(store) == 0
    assert scene._held.columns.hulls is None
    assert scene.get('0').kind == ShapeKind.BOX
    assert math.isclose(scene.raycast((1, 0, -5), (1, 0, 5)).t, 0.45)


def test_meshes_that_come_and_go_are_found_in_arrays_that_do_not_grow_for_ever():
    store, rng = MeshStore(), np.random.default_rng(2)
    meshes = [Mesh(CUBE * (1 + k)) for k in range(20)]
    held = {}
    for _ in range(3000):
        mesh = meshes[rng.integers(20)]
        if mesh.key in held and rng.random() < 0.6:
            store.release(held.pop(mesh.key))
        elif mesh.key not in held:
            held[mesh.key] = store.take(mesh)
        for known in meshes[:3]:
            if known.key in held:
                begin, end = store.hulls.spans[held[known.key]]['vertices']
                assert np.array_equal(store.hulls.vertices[begin:end], known.vertices)
    assert len(store) == len(held)
    assert len(store.hulls.vertices) < 3000
