# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What RViz is given to draw, read back as rclpy reads it, and against the scene it came from."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from ros.messages import LATCHED, coordinates, marker, write, xyz
from scipy.spatial.transform import Rotation
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.ros.conversions import outlines
from bvh_ros.ros.parts.drawing import Drawing, marker_array, obstacles, with_few_triangles
from bvh_ros.scene import Mesh, NodeScene, ShapeKind, Shapes
from bvh_ros.tree import DynamicBVH

RNG = np.random.default_rng(5)


@pytest.mark.parametrize('text', ['', 'a', 'ab', 'abc', 'é'])
@pytest.mark.parametrize('count', [0, 1, 3])
def test_the_bytes_are_those_of_a_marker_array(text, count):
    points, colours = RNG.normal(size=(count, 3)), RNG.random((count, 4)).astype(np.float32)
    drawing = Drawing(
        Marker.LINE_LIST, (1, 2, 3), (0.5, 0.25, 0.125, 1), text, (4, 5, 6), (0, 0, 1, 0), points,
        colours, text,
    )  # fmt: skip
    data = marker_array([drawing, drawing], 'map' + text, 7_000_000_009)
    clear, one, other = deserialize_message(data, MarkerArray).markers
    assert clear.action == Marker.DELETEALL
    assert clear.ns == ''
    expected = Marker(ns=text, id=0, type=Marker.LINE_LIST, text=text)
    expected.header.frame_id = 'map' + text
    expected.header.stamp.sec, expected.header.stamp.nanosec = 7, 9
    write(expected.pose.position, (4, 5, 6))
    write(expected.pose.orientation, (0, 0, 1, 0))
    write(expected.scale, (1, 2, 3))
    write(expected.color, (0.5, 0.25, 0.125, 1))
    expected.points, expected.colors = one.points, one.colors
    assert one == expected
    assert np.array_equal(xyz(one.points), points)
    read = np.array([coordinates(colour) for colour in one.colors])
    assert np.array_equal(read.reshape(-1, 4), colours)
    assert other.id == 1


def vertices(drawing):
    """Where the corners of what a list draws come to lie, as RViz places them."""
    turn = Rotation.from_quat(drawing.orientation)
    if drawing.kind == Marker.TRIANGLE_LIST:
        return drawing.points
    cube = (outlines.CORNERS - 0.5) * np.asarray(drawing.scale)
    places = turn.apply(drawing.points) + drawing.position
    return (places[:, None] + turn.apply(cube)).reshape(-1, 3)


def test_turned_boxes_come_to_lie_where_they_are():
    count = 60
    turns = Rotation.random(count, random_state=1).as_quat()
    turns[:30] = turns[0]
    size = RNG.uniform(0.1, 2, (count, 3))
    size[:30] = size[0]
    shapes = Shapes.boxes(RNG.uniform(-9, 9, (count, 3)), size, turns)
    drawn = list(obstacles(shapes, 'a', [1, 1, 1, 1]))
    assert [drawing.kind for drawing, _ in drawn] == [Marker.CUBE_LIST, Marker.TRIANGLE_LIST]
    assert [number for _, number in drawn] == [30, 30]
    local = (outlines.CORNERS - 0.5) * size[:, None]
    corners = np.stack([Rotation.from_quat(turns[i]).apply(local[i]) for i in range(count)])
    corners = (corners + shapes.position[:, None]).reshape(-1, 3)
    met = np.vstack([vertices(drawing) for drawing, _ in drawn])
    assert np.abs(met[:, None] - corners).max(axis=2).min(axis=1).max() < 1e-9
    assert np.abs(met[:, None] - corners).max(axis=2).min(axis=0).max() < 1e-9


def test_triangles_face_outwards():
    shapes = Shapes.boxes(RNG.uniform(-9, 9, (5, 3)), RNG.uniform(1, 2, (5, 3)))
    for centre, corners in zip(
        shapes.position, outlines.triangles(shapes).reshape(5, 12, 3, 3), strict=True
    ):
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert ((normals * (corners.mean(axis=1) - centre)).sum(axis=1) > 0).all()
        area = np.linalg.norm(normals, axis=1).sum() / 2
        size = shapes.size[(shapes.position == centre).all(axis=1)][0]
        assert area == pytest.approx(2 * (size * np.roll(size, 1)).sum())


def test_round_shapes_and_what_is_none_of_the_three():
    kind = np.array([1] * 10 + [1, 2, 2, 3], np.uint8)
    size = np.ones((14, 3))
    size[10] = 3.0
    shapes = Shapes(kind, RNG.uniform(-9, 9, (14, 3)), np.tile((0.0, 0, 0, 1), (14, 1)), size)
    drawn = [(drawing.kind, number) for drawing, number in obstacles(shapes, '', [1, 1, 1, 1])]
    assert drawn == [
        (Marker.SPHERE_LIST, 10),
        (Marker.SPHERE, 1),
        (Marker.CYLINDER, 1),
        (Marker.CYLINDER, 1),
        (Marker.TRIANGLE_LIST, 1),
    ]
    assert ShapeKind(3).name == 'CAPSULE'


# A folded sheet of two triangles, away from the origin of its frame.
FOLD = np.array([[(3, 0, 0), (4, 0, 0), (4, 1, 1)], [(3, 0, 0), (4, 1, 1), (3, 1, 0)]], float)


def folds(count):
    """(canonical shapes of so many turned sheets, their triangles)"""
    turns, places = Rotation.random(count, random_state=4), RNG.uniform(-9, 9, (count, 3))
    scene = NodeScene()
    shapes = Shapes.of_meshes(Mesh(FOLD), places, turns.as_quat())
    scene.update('us', [f'{k:03}' for k in range(count)], shapes, stamp=0)
    corners = [turn.apply(FOLD.reshape(-1, 3)) for turn in turns] + places[:, None]
    return scene.shapes_of('us', count), corners


def test_meshes_are_drawn_as_they_are():
    shapes, corners = folds(510)
    drawn = list(obstacles(shapes, 'a', [1, 1, 1, 1]))
    assert [number for _, number in drawn] == [1] * 500 + [10]
    assert {drawing.kind for drawing, _ in drawn} == {Marker.TRIANGLE_LIST}
    shown = np.vstack([drawing.points for drawing, _ in drawn])
    np.testing.assert_allclose(shown, corners.reshape(-1, 3), atol=1e-12)


def test_of_too_many_triangles_the_last_meshes_become_the_boxes_around_them():
    shapes, corners = folds(9)
    assert with_few_triangles(shapes, 18) == (shapes, 0)
    some, boxed = with_few_triangles(shapes, 11)
    assert boxed == 4
    assert some.kind.tolist() == [ShapeKind.MESH] * 5 + [ShapeKind.BOX] * 4
    boxes, meshes = obstacles(some, 'a', [1, 1, 1, 1]), corners[:5].reshape(-1, 3)
    (box, count), *others = boxes
    assert (count, len(others)) == (4, 5)
    np.testing.assert_allclose(np.vstack([one.points for one, _ in others]), meshes, atol=1e-12)
    around = box.points.reshape(4, 36, 3)
    for places, mesh in zip(around, corners[5:], strict=True):
        middle = 0.5 * (places[0] + places[FARTHEST])
        axes = places[list(EDGES)] - places[0]
        shares = (mesh - middle) @ (axes / (axes**2).sum(axis=1, keepdims=True)).T
        np.testing.assert_allclose(np.abs(shares).max(axis=0), 0.5, atol=1e-12)


# Where, among the corners of a box's triangles, is that with all upper coordinates, and those with
# one.
FARTHEST, *EDGES = (list(outlines.TRIANGLES).index(corner) for corner in (7, 1, 2, 4))


@pytest.mark.parametrize('ndim', [2, 3])
def test_the_levels_of_a_tree(ndim):
    lo = RNG.uniform(0, 50, (200, ndim))
    tree = DynamicBVH.from_boxes(lo, lo + 1)
    low, high, depths = tree.levels(0, 99, 10_000)
    assert len(low) == 399  # every node of a binary tree with 200 leaves
    assert depths.max() == tree.height
    assert np.array_equal(np.vstack((low[0], high[0])), tree.bounds)
    for depth in range(1, tree.height + 1):
        here, above = depths == depth, depths == depth - 1
        inside = (low[here, None] >= low[above]).all(axis=2) & (
            high[here, None] <= high[above]
        ).all(axis=2)
        assert inside.any(axis=1).all()
    some = tree.levels(2, 3, 10_000)
    assert np.array_equal(some[0], low[(depths >= 2) & (depths <= 3)])
    assert len(tree.levels(0, 99, 7)[0]) == 7
    assert len(DynamicBVH(ndim=ndim).levels(0, 99, 7)[0]) == 0


def edges_of(ends):
    """The boxes that lines outline, as (lo, hi)."""
    corners = ends.reshape(-1, 24, 3)
    return corners.min(axis=1), corners.max(axis=1)


def test_edges_are_those_of_the_box():
    lo = RNG.uniform(0, 5, (4, 3))
    hi = lo + np.array((1, 2, 3))
    ends = outlines.edges(lo, hi).reshape(-1, 3)
    assert np.allclose(np.vstack(edges_of(ends)), np.vstack((lo, hi)))
    lengths = np.linalg.norm(ends[::2] - ends[1::2], axis=1).reshape(4, 12)
    assert np.allclose(np.sort(lengths, axis=1), [1] * 4 + [2] * 4 + [3] * 4)
    flat = outlines.edges(lo[:, :2], hi[:, :2]).reshape(-1, 3)
    assert np.allclose(np.linalg.norm(flat[::2] - flat[1::2], axis=1), [1, 1, 2, 2] * 4)


@pytest.fixture(scope='module')
def filled(world):
    boxes = [marker(i, (i, 0, 0), (0.5, 0.5, 0.5)) for i in range(20)]
    world.show(*boxes, marker(99, (5, 5, 0), (1, 2, 3)))
    return world


class Look:
    """What RViz shows of a topic."""

    def __init__(self, world, topic):
        self.arrays = world.heard(MarkerArray, topic, LATCHED)

    def markers(self):
        if not self.arrays:
            return []
        clear, *others = self.arrays[-1].markers
        assert clear.action == Marker.DELETEALL
        return others


def test_the_tree(filled):
    tree = Look(filled, 'tree')
    filled.until(lambda: tree.markers())
    (lines,) = tree.markers()
    lo, hi = edges_of(xyz(lines.points))
    assert (lo[0].tolist(), hi[0].tolist()) == ([-0.25, -0.25, -1.5], [19.25, 6, 1.5])
    assert len(lines.colors) == len(lines.points)
    assert 20 < len(lo) <= 41


def test_the_last_queries(filled):
    queries, topic = Look(filled, 'queries'), f'{filled.name}/queries'
    filled.until(lambda: filled.node.count_publishers(topic) == 1)

    def ask():
        filled.plan('raycast', (0, 9, 0), (30, 9, 0))
        filled.plan('raycast', (-5, 0, 0), (30, 0, 0))
        filled.plan('overlap', (4, 4, 0), (6, 6, 1))
        return any(len(marker.points) >= 2 * 14 for marker in queries.markers())

    filled.until(ask)
    rays, hits = queries.markers()
    lines = xyz(rays.points).reshape(-1, 6).tolist()
    free, blocked = (
        rays.colors[2 * lines.index(line)] for line in ([0, 9, 0, 30, 9, 0], [-5, 0, 0, 30, 0, 0])
    )
    assert free.g > free.r
    assert blocked.r > blocked.g
    assert [-0.25, 0, 0] in xyz(hits.points).tolist()


def test_the_scene(filled):
    scene = Look(filled, 'scene')
    filled.until(lambda: len(scene.markers()) == 2)
    cubes, other = scene.markers()
    assert (cubes.type, cubes.ns, cubes.header.frame_id) == (Marker.CUBE_LIST, 'markers', 'map')
    assert np.array_equal(xyz(cubes.points), [(i, 0, 0) for i in range(20)])
    assert coordinates(cubes.scale) == (0.5, 0.5, 0.5)
    assert xyz(other.points).max(axis=0).tolist() == [5.5, 6, 1.5]
    filled.markers(marker(99, action=Marker.DELETE))
    filled.until(lambda: len(scene.markers()) == 1)
    assert filled.trigger('clear').success
    filled.until(lambda: scene.markers() == [])


def test_a_limit_is_said(start_node):
    world = start_node({'draw.limit': 5, 'draw.last_depth': 9})
    world.show(*(marker(i, (2 * i, 0, 0)) for i in range(9)))
    for topic, text in (('scene', '5 of 9 obstacles are drawn'), ('tree', 'the first 5 boxes')):
        shown = Look(world, topic)
        world.until(shown.markers)
        assert shown.markers()[-1].text.startswith(text)
