# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Saved trees are shown and asked as they are, and only they are imported for that."""

import subprocess
import sys
import threading

import numpy as np
import pytest

from bvh_ros import DynamicBVH
from bvh_ros.scene import Mesh, NodeScene, Shapes
from bvh_ros.view.drawing import Placing, _by_mesh
from bvh_ros.view.main import _is_local, _open, main
from bvh_ros.view.panel import in_words
from bvh_ros.view.worlds import MOST_NAMESPACES, Namespaces, SavedTree, ShownWorld, namespace_of

RNG = np.random.default_rng(4)


@pytest.fixture(params=[(2, 'tree.npz'), (3, 'tree.npz'), (3, 'tree.mapped')])
def saved(request, tmp_path):
    """A tree, and the world that `bvh_view` makes of its file."""
    ndim, name = request.param
    lo = RNG.uniform(0.0, 50.0, (200, ndim))
    tree = DynamicBVH.from_boxes(lo, lo + RNG.uniform(0.1, 3.0, lo.shape))
    tree.remove_many(tree.ids()[::7])
    tree.save(tmp_path / name, mapped=name.endswith('mapped'))
    return tree, _open(str(tmp_path / name), '', threading.Event())


def test_a_saved_tree_is_shown_as_it_was(saved):
    tree, world = saved
    (group,) = world.groups()
    lo, hi = tree.boxes(tree.ids())
    half = 0.5 * group.shapes.size
    np.testing.assert_allclose((group.shapes.position - half)[:, : tree.ndim], lo, rtol=1e-12)
    np.testing.assert_allclose((group.shapes.position + half)[:, : tree.ndim], hi, rtol=1e-12)
    assert world.height == tree.height
    for given, wanted in zip(world.levels(1, 3), tree.levels(1, 3, 99_999), strict=True):
        np.testing.assert_array_equal(given, wanted)


def test_questions_are_answered_by_the_saved_tree(saved):
    tree, world = saved
    for _ in range(50):
        start, goal = RNG.uniform(0.0, 50.0, (2, 3))
        hit = tree.raycast(start[: tree.ndim], (goal - start)[: tree.ndim], 1.0)
        answer = world.raycast(start, goal)
        assert [one.name for one in answer.hits] == ([] if hit is None else [f'box/{hit.id}'])
        near = world.overlap(start, goal).hits
        lo, hi = np.minimum(start, goal), np.maximum(start, goal)
        ids = tree.overlap(lo[: tree.ndim], hi[: tree.ndim])
        assert {one.name for one in near} == {f'box/{one}' for one in ids}
        away = [np.linalg.norm(one.point - (start + goal) / 2) for one in near]
        assert away == sorted(away)
        assert all(one.name in world.scene for one in near)


@pytest.mark.parametrize('unit', [1e-290, 1e-12, 1.0, 1e12, 1e290])
@pytest.mark.parametrize('away', [0.0, 1e3, 1e9])
def test_a_page_tells_apart_what_a_thousandth_of_the_world_is_apart(unit, away):
    placing = Placing()
    lo = np.full(3, away * unit)
    hi = lo + unit
    placing.fit(lo, hi)
    points = lo + np.linspace(0.0, 1.0, 1001)[:, None] * (hi - lo)
    seen = placing.shown(points).astype(np.float32)
    assert (np.abs(seen) < 1e6).all()
    assert (np.diff(seen, axis=0) > 0.0).all()
    np.testing.assert_allclose(placing.in_world(placing.shown(points)), points, rtol=1e-15)


def test_a_ray_at_a_mesh_tells_its_triangle():
    corners = np.array([[(0, 0, 0), (2, 0, 0), (2, 2, 0)], [(0, 0, 0), (2, 2, 0), (0, 2, 1)]])
    place, scene = np.array((5.0, -1.0, 2.0)), NodeScene()
    scene.update('us', ['sheet'], Shapes.of_meshes(Mesh(corners), [place]), stamp=0)
    scene.update('us', ['box'], Shapes.boxes([(0, 9, 0)], 1.0), stamp=0)
    world = ShownWorld('sheet', scene)
    above, below = place + np.array((0.5, 1.5, 5.0)), place + np.array((0.5, 1.5, -5.0))
    answer = world.raycast(above, below)
    (hit,) = answer.hits
    assert (hit.name, hit.triangle) == ('sheet', 1)
    a, b, c = corners[1] + place
    np.testing.assert_allclose(answer.edges, [(a, b), (b, c), (c, a)], atol=1e-12)
    assert ' m, triangle 1 <' in in_words(answer)
    other = world.raycast(np.array((0.0, 9.0, 5.0)), np.array((0.0, 9.0, -5.0)))
    assert ([hit.triangle for hit in other.hits], len(other.edges)) == ([-1], 0)
    assert 'triangle' not in in_words(other)
    ((_, triangles, _),) = _by_mesh(scene.shapes_of('us', 1))
    assert triangles.side == 'double'  # it is seen from below, too


def test_a_click_on_a_planar_world_asks_for_what_stands_there():
    scene = NodeScene(planar=True)
    scene.update('us', ['post'], Shapes.boxes([(2, 3, 0)], 1.0), stamp=0)
    world = ShownWorld('flat', scene)
    eye = np.array((0.0, 0.0, 10.0))
    assert [hit.name for hit in world.pick(eye, np.array((2, 3, -10.0)), 1.0).hits] == ['post']
    assert world.pick(eye, np.array((2, 5, -10.0)), 1.0).hits == []


def test_a_file_that_holds_no_tree(tmp_path):
    (tmp_path / 'no.npz').write_bytes(b'no')
    with pytest.raises(ValueError, match='no'):
        SavedTree(tmp_path / 'no.npz')


@pytest.mark.parametrize(
    ('name', 'namespace'),
    [('a/b/3', 'a/b'), ('a/3#17', 'a'), ('cloud#9', ''), ('box', ''), ('/3', '')],
)
def test_the_namespace_of_a_name(name, namespace):
    assert namespace_of(name) == namespace


def test_namespaces_of_those_who_come_and_go():
    scene, split = NodeScene(), Namespaces()
    for names in (['a/1', 'b/1', 'a/2'], ['b/2', 'a/2', 'c/1'], ['c/1']):
        places = [(k, 0, 0) for k in range(len(names))]
        scene.replace('us', '', names, Shapes.boxes(places, 0.5), stamp=0)
        found = dict(split.split(scene, ShownWorld('', scene).groups()))
        wanted = {name[0] for name in names}
        assert {name for name, shapes in found.items()} == wanted
        for letter in wanted:
            places = sorted(k for k, name in enumerate(names) if name[0] == letter)
            assert sorted(found[letter].position[:, 0].tolist()) == places


def test_obstacles_without_namespace_or_with_too_many_go_by_their_source():
    scene = NodeScene()
    for source, names in (
        ('cloud', ['cloud#1', 'cloud#2']),
        ('mixed', ['a/1', 'post']),
        ('many', [f'{k}/0' for k in range(MOST_NAMESPACES + 1)]),
    ):
        places = [(k, 0, 0) for k in range(len(names))]
        scene.update(source, names, Shapes.boxes(places, 0.5), stamp=0)
    found = Namespaces().split(scene, ShownWorld('', scene).groups())
    counts = [(name, len(shapes.kind)) for name, shapes in found]
    assert sorted(counts) == [('a', 1), ('cloud', 2), ('many', MOST_NAMESPACES + 1), ('mixed', 1)]


def test_a_saved_tree_needs_no_ros_and_the_worlds_no_viser():
    program = 'import sys, bvh_ros.view.worlds; print(*{"rclpy", "viser"} & {*sys.modules})'
    done = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True)
    assert (done.returncode, done.stdout.split()) == (0, []), done.stderr


@pytest.mark.parametrize(
    ('host', 'local'),
    [('127.0.0.1', True), ('::1', True), ('localhost', True), ('0.0.0.0', False), ('x', False)],
)
def test_who_can_reach_the_page(host, local):
    assert _is_local(host) == local


@pytest.mark.parametrize('what', ['/nowhere/tree.npz', 'bvh', 'nowhere/bag'])
def test_what_there_is_not_is_said_before_anything_is_served(what, capsys):
    with pytest.raises(SystemExit):
        main([what])
    said = capsys.readouterr()
    assert not said.out
    assert f'there is no file or folder {what}' in said.err
