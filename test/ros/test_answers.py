# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Questions over ROS 2: each answer is, bit for bit, that of a scene of the same boxes."""

import numpy as np
import pytest
from ros.boxes import Boxes
from ros.messages import SECOND, coordinates, marker
from scipy.spatial.transform import Rotation

from bvh_ros.scene import NodeScene, Shapes

COUNT, CALLS = 300, 75
BOXES = Boxes(COUNT, seed=7)
STAMPS = 1 + np.arange(COUNT) % 2  # s


@pytest.fixture(scope='module')
def scene(world):
    """What the node knows."""
    rows = zip(range(COUNT), BOXES.centre, BOXES.size, STAMPS, strict=True)
    world.show(*(marker(i, at, size, stamp=int(told)) for i, at, size, told in rows))
    scene, shapes = NodeScene(), Shapes.boxes(BOXES.centre, BOXES.size)
    scene.update('markers', BOXES.names, shapes, stamp=STAMPS * SECOND)
    return scene


def check(plan, hits):
    """The same obstacles in the same order, at the same points, with normals and stamps."""
    assert (plan.header.frame_id, plan.header.stamp.sec) == ('map', 2)
    assert [pose.header.frame_id for pose in plan.poses] == [hit.name for hit in hits]
    for pose, hit in zip(plan.poses, hits, strict=True):
        assert coordinates(pose) == tuple(hit.point)
        assert pose.header.stamp.sec * SECOND == hit.stamp
        ahead = Rotation.from_quat(coordinates(pose.pose.orientation)).apply((1, 0, 0))
        np.testing.assert_allclose(ahead, hit.normal if hit.normal.any() else (1, 0, 0), atol=1e-9)
    return len(hits)


@pytest.mark.parametrize('most', [0.0, 1.0])
def test_rays_and_balls(world, scene, most):
    rng, met = np.random.default_rng(8), 0
    for start, goal in rng.uniform(-12, 12, (CALLS, 2, 3)):
        radius = float(np.float32(rng.uniform(0, most)))  # as the request has it
        first = scene.raycast(start, goal, radius)
        check(world.plan('raycast', start, goal, tolerance=radius), [first] if first else [])
        hits = scene.raycast_all(start, goal, radius)
        met += check(world.plan('raycast_all', start, goal, tolerance=radius), hits)
    assert met > CALLS


@pytest.mark.parametrize('turned', [False, True])
@pytest.mark.parametrize(('size', 'most'), [(0.0, 4.0), (2.0, 0.0), (2.0, 1.0)])
def test_points_boxes_and_balls(world, scene, size, most, turned):
    rng, met = np.random.default_rng(9), 0
    for centre in rng.uniform(-10, 10, (CALLS // 3, 3)):
        half, tolerance = rng.uniform(0, size, 3), float(np.float32(rng.uniform(0, most)))
        turn = Rotation.random(random_state=rng).as_quat() if turned else np.array((0, 0, 0, 1.0))
        corner = Rotation.from_quat(turn).apply(half)
        ends, given = (centre - corner, centre + corner), {'turn': turn, 'tolerance': tolerance}
        hits = scene.overlap(*ends, turn, tolerance)
        met += check(world.plan('overlap', *ends, **given), hits)
    assert met > 10
