# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A view of a node in its own process shows what the node holds, and lets the node answer."""

import os
import time

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

import rclpy
from geometry_msgs.msg import PoseStamped
from scipy.spatial.transform import Rotation
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.client import BvhClient
from bvh_ros.ros import running
from bvh_ros.ros.parts.drawing import Drawing, marker_array
from bvh_ros.ros.parts.drawing import obstacles as drawn_obstacles
from bvh_ros.ros.running import running_node, wait_until_ready
from bvh_ros.scene import Mesh, ShapeKind, Shapes
from bvh_ros.view import live as live_view
from bvh_ros.view.live import Live, obstacles
from bvh_ros.view.worlds import Namespaces, Wanted

SPACE = f'/view{os.getpid()}'
TIMEOUT = 600.0  # seconds, on a loaded machine
PARAMETERS = {
    'sources': ['early', 'moving'],
    'early': {'type': 'MarkerArray', 'topic': '~/early'},
    'moving': {'type': 'MarkerArray', 'topic': 'moving'},
    'transforms': ['dock'],
    'dock': {'xyz': [1.0, 2.0, 3.0]},
    'virtual_scan': {'pose_topic': '~/pose', 'range_max': 30.0},
}


def marker(space, number, at, kind=Marker.CUBE, turn=0.0):
    found = Marker(ns=space, id=number, type=kind)
    found.header.frame_id = 'map'
    pose, scale = found.pose, found.scale
    pose.position.x, pose.position.y, pose.position.z = map(float, at)
    pose.orientation.z, pose.orientation.w = np.sin(turn / 2), np.cos(turn / 2)
    scale.x = scale.y = scale.z = 1.0
    return found


class Publisher:
    """Everybody else."""

    def __init__(self, node):
        self.early, self.moving = (
            node.create_publisher(MarkerArray, f'{SPACE}/{topic}', 10)
            for topic in ('bvh/early', 'moving')
        )
        self.pose = node.create_publisher(PoseStamped, f'{SPACE}/bvh/pose', 10)

    def heard_by(self, publisher, count):
        deadline = time.monotonic() + TIMEOUT
        while publisher.get_subscription_count() < count:
            assert time.monotonic() < deadline
            time.sleep(0.01)


@pytest.fixture(scope='module', autouse=True)
def patience():
    """Of the view and of what starts a node: a loaded machine is no defect of theirs."""
    with pytest.MonkeyPatch.context() as patch:
        for module, name in (
            (running, 'START_TIMEOUT'),
            (live_view, 'PATIENCE'),
            (live_view, 'ANSWER_WITHIN'),
        ):
            patch.setattr(module, name, TIMEOUT)
        yield


@pytest.fixture(scope='module')
def live(ros_context):
    """The view, and who publishes; the source `early` spoke before anybody looked."""
    node = rclpy.create_node('others', namespace=SPACE)
    client, others = BvhClient(node, timeout=TIMEOUT), Publisher(node)
    with running_node(SPACE, PARAMETERS) as process:
        wait_until_ready(client, process)
        others.heard_by(others.early, 1)
        things = [marker('wall', k, (k, -5, 0.5), turn=0.1 * k) for k in range(3)] + [
            marker('tree', 0, (0, 5, 0.5), Marker.CYLINDER)
        ]
        others.early.publish(MarkerArray(markers=things))
        while len(client.overlap((-99, -99, -99), (99, 99, 99))) < 4:
            time.sleep(0.01)
        world = Live(f'{SPACE}/bvh')
        try:
            yield world, others
        finally:
            world.close()
    node.destroy_node()


def until(world, condition):
    deadline = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < deadline
        world.advance(time.monotonic() + 0.05)


def test_what_was_told_before_is_shown_as_the_node_draws_it(live):
    world, _ = live
    until(world, world.groups)
    (group,) = world.groups()
    assert group.source == 'early'
    assert sorted(group.shapes.kind.tolist()) == [ShapeKind.BOX] * 3 + [ShapeKind.CYLINDER]
    boxes = group.shapes.take(group.shapes.kind == ShapeKind.BOX)
    np.testing.assert_allclose(boxes.position, [(k, -5, 0.5) for k in range(3)], atol=1e-12)
    np.testing.assert_allclose(boxes.size, 1.0, atol=1e-12)
    turned = [2.0 * np.arctan2(z, w) for _, _, z, w in boxes.orientation]
    np.testing.assert_allclose(np.mod(turned, np.pi / 2), [0.0, 0.1, 0.2], atol=1e-12)


def moved_to(world, others, x):
    version = world.version()
    others.moving.publish(MarkerArray(markers=[marker('cart', 7, (x, 0, 0.5))]))
    until(world, lambda: world.version() != version and 'cart/7' in world.scene)
    until(world, lambda: world.scene.get('cart/7').position[0] == x)


def test_boxes_and_meshes_of_a_picture_are_told_apart():
    """As the node draws them: also a mesh of twelve triangles, and one without size."""
    rng = np.random.default_rng(6)
    turns = Rotation.random(5, random_state=1).as_quat()
    boxes = Shapes.boxes(rng.uniform(-9, 9, (5, 3)), rng.uniform(1, 2, (5, 3)), turns)
    given = [rng.uniform(-1, 1, (count, 3, 3)) for count in (2, 12)]
    meshes = [Mesh(triangles) for triangles in given]
    sheets = Shapes.of_meshes(meshes, rng.uniform(-9, 9, (2, 3)), turns[:2])
    drawn = [one for some in (boxes, sheets) for one, _ in drawn_obstacles(some, 'us', [1] * 4)]
    speck = Drawing(Marker.TRIANGLE_LIST, (1, 1, 1), namespace='us', points=np.full((3, 3), 2.0))
    shown = obstacles(marker_array([*drawn, speck], 'map', 0))['us']
    assert shown.kind.tolist() == [ShapeKind.BOX] * 5 + [ShapeKind.MESH] * 2 + [ShapeKind.BOX]
    np.testing.assert_allclose(shown.position[:5], boxes.position, atol=1e-12)
    np.testing.assert_allclose(shown.size[:5], boxes.size, atol=1e-12)
    for mesh, triangles, row in zip(shown.mesh[5:7], given, range(2), strict=True):
        turn, place = Rotation.from_quat(turns[row]), sheets.position[row]
        wanted = turn.apply(triangles.reshape(-1, 3)) + place
        np.testing.assert_allclose(mesh.vertices[mesh.corners].reshape(-1, 3), wanted, atol=1e-12)
    assert (shown.position[7].tolist(), shown.size[7].tolist()) == ([2.0] * 3, [0.0] * 3)


def test_what_moves_is_heard_at_once_and_the_node_answers(live):
    world, others = live
    others.heard_by(others.moving, 2)  # the node and the view
    for x in (3.0, 4.0):
        moved_to(world, others, x)
    until(world, lambda: world.raycast(np.array((3.2, 0, 0.5)), np.array((4.0, 0, 0.5))).hits)
    answer = world.pick(np.array((0.0, 0.0, 0.5)), np.array((1.0, 0.0, 0.0)), 50.0)
    assert [(hit.name, tuple(hit.point)) for hit in answer.hits] == [('cart/7', (3.5, 0.0, 0.5))]
    assert answer.microseconds > 0.0
    assert world.pick(np.zeros(3), np.array((0.0, 0.0, 1.0)), 50.0).hits == []
    names = [hit.name for hit in world.overlap(np.array((-1, -6, 0)), np.array((9, 1, 1))).hits]
    assert sorted(names) == ['cart/7', 'wall/0', 'wall/1', 'wall/2']
    assert world.scene.get('cart/7').source == 'moving'
    split = dict(Namespaces().split(world.scene, world.groups()))
    assert {name: len(shapes.kind) for name, shapes in split.items()} == {'cart': 1, 'early': 4}


def test_batches_of_rays_are_shown(live):
    world, _ = live
    world.want(Wanted(queries=True))
    until(world, lambda: world.node.count_publishers(f'{SPACE}/bvh/queries') == 1)
    asker = BvhClient(world.node, f'{SPACE}/bvh')
    origins = np.stack((np.arange(5.0), np.zeros(5), np.full(5, 0.5)), axis=1)
    ways = np.tile((0.0, -1.0, 0.0), (5, 1))

    def shown():
        hits = asker.raycast_many(origins, ways, 20.0)
        lines, spots = world.overlay().lines[-5:], world.overlay().spots[-4:]
        met = np.isfinite(hits.t)
        wanted = origins[met] + hits.t[met, None] * ways[met]
        return (
            met.sum() == 4  # three walls, and the cart
            and np.array_equal(lines[:, 0], origins)
            and np.allclose(lines[met, 1], wanted)
            and np.allclose(spots, wanted)
        )

    until(world, shown)
    world.want(Wanted())
    until(world, lambda: world.node.count_subscribers(f'{SPACE}/bvh/queries') == 0)


def test_figures_and_frames(live):
    world, _ = live
    until(world, lambda: 'height of the tree' in world.figures())
    until(world, lambda: 'queries: answers a second' in world.figures())
    assert 'source moving: updates a second' in world.figures()
    (frame,) = world.frames()
    assert (frame.name, frame.position.tolist()) == ('dock', [1.0, 2.0, 3.0])
    assert world.frame_id == 'map'


def test_pictures_are_asked_for_only_while_somebody_looks(live):
    world, others = live
    topics = [f'{SPACE}/bvh/{topic}' for topic in ('tree', 'queries', 'virtual_scan')]

    def counts():
        return [world.node.count_subscribers(topic) for topic in topics]

    assert counts() == [0, 0, 0]
    world.want(Wanted(tree=True, queries=True, scan=True))
    world.advance(time.monotonic() + 0.1)
    until(world, lambda: counts() == [1, 1, 1])
    until(world, lambda: len(world.levels(0, 9)[2]))
    depths = world.levels(0, 9)[2].tolist()
    assert depths[0] == 0
    assert sorted(set(depths)) == list(range(max(depths) + 1))
    lo, hi, _ = world.levels(0, 0)
    assert len(lo) == 1
    assert (lo[0] <= (-0.5, -5.5, 0.0)).all()
    assert (hi[0] >= (0.5, 5.5, 1.0)).all()
    others.heard_by(others.pose, 2)

    def scanned():
        pose = PoseStamped()
        pose.header.frame_id, pose.pose.position.z = 'map', 0.5
        others.pose.publish(pose)
        return len(world.overlay().scan)

    until(world, scanned)
    sides = np.abs(world.overlay().scan - (0.0, 5.0, 0.5))[:, :2]
    near = np.linalg.norm(sides, axis=1) < 0.51
    assert near.any()  # the cylinder is seen
    world.raycast(np.array((0.0, 0.0, 0.5)), np.array((9.0, 0.0, 0.5)))
    until(world, lambda: (world.overlay().lines[-1:] == ((0, 0, 0.5), (9, 0, 0.5))).all())
    world.want(Wanted())
    world.advance(time.monotonic() + 0.1)
    until(world, lambda: counts() == [0, 0, 0])
    assert len(world.overlay().lines) == len(world.overlay().scan) == 0


def first_hit(world):
    """The name of what a ray along x meets, in a list."""
    return [hit.name for hit in world.raycast(np.zeros(3), np.array((9.0, 0.0, 0.0))).hits]


@pytest.mark.slow
def test_a_node_that_ends_and_comes_back(ros_context):
    """What was there stays to be seen, but is not asked; then the new one is shown."""
    space = f'{SPACE}b'
    node = rclpy.create_node('others', namespace=space)
    client = BvhClient(node)
    boxes = node.create_publisher(MarkerArray, f'{space}/bvh/obstacles', 10)
    with running_node(space, {}) as process:
        wait_until_ready(client, process)
        world = Live(f'{space}/bvh')
        until(world, lambda: boxes.get_subscription_count() == 2)
        boxes.publish(MarkerArray(markers=[marker('box', 1, (2, 0, 0))]))
        until(world, lambda: 'box/1' in world.scene)
        until(world, lambda: first_hit(world))  # the view may have heard it before the node
        assert first_hit(world) == ['box/1']
    try:
        until(world, lambda: 'the node' in world.figures())
        assert 'box/1' in world.scene
        with pytest.raises(RuntimeError, match='has ended'):
            world.raycast(np.zeros(3), np.array((9.0, 0.0, 0.0)))
        version = world.version()
        with running_node(space, {'frame_id': 'odom'}) as process:
            wait_until_ready(client, process)
            until(world, lambda: world.frame_id == 'odom')
            assert len(world.scene) == 0
            assert world.version() != version
            until(world, lambda: boxes.get_subscription_count() == 2)
            box = marker('box', 2, (2, 0, 0))
            box.header.frame_id = 'odom'
            boxes.publish(MarkerArray(markers=[box]))
            until(world, lambda: 'box/2' in world.scene)
            until(world, lambda: first_hit(world))
            assert first_hit(world) == ['box/2']
    finally:
        world.close()
        node.destroy_node()
