# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Three hundred boxes, 450 questions over ROS 2: each answer equals brute force."""

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

BOXES, CALLS = 300, 150
RNG = np.random.default_rng(7)
CENTRE = RNG.uniform(-10, 10, (BOXES, 3))
SIZE = RNG.uniform(0.2, 2.0, (BOXES, 3))
LOW, HIGH = CENTRE - SIZE / 2, CENTRE + SIZE / 2
CLEAR = 1e-7  # m: random questions closer to a border than this would be a coincidence


@pytest.fixture(scope='module')
def filled(world, messages):
    world.markers(*(messages.marker(i, CENTRE[i], SIZE[i], stamp=1 + i % 2) for i in range(BOXES)))
    world.until(lambda: len(world.everything()) == BOXES)
    return world


def enter_and_leave(start, way):
    """Where on the segment the ray enters and leaves each box; a miss leaves before it enters."""
    with np.errstate(divide='ignore'):
        one, other = (LOW - start) / way, (HIGH - start) / way
    enter = np.minimum(one, other).max(axis=1)
    leave = np.maximum(one, other).min(axis=1)
    return enter, leave


def numbers(poses):
    return [int(pose.header.frame_id.split('/')[1]) for pose in poses]


def place(pose):
    at = pose.pose.position
    return np.array((at.x, at.y, at.z))


def outward(pose):
    """The normal in a reply: +x turned by its orientation."""
    q = pose.pose.orientation
    return np.array(
        (1 - 2 * (q.y * q.y + q.z * q.z), 2 * (q.x * q.y + q.z * q.w), 2 * (q.x * q.z - q.y * q.w))
    )


def segments():
    return RNG.uniform(-12, 12, (CALLS, 2, 3))


def expected_hits(start, goal):
    enter, leave = enter_and_leave(start, goal - start)
    hit = np.flatnonzero((enter <= leave) & (leave >= 0) & (enter <= 1))
    t = np.maximum(enter[hit], 0.0)
    order = np.lexsort((hit, t))
    return hit[order], t[order]


def check_poses(poses, hits, ts, start, way):
    assert numbers(poses) == hits.tolist()
    for pose, box, t in zip(poses, hits, ts, strict=True):
        point = place(pose)
        assert np.allclose(point, start + t * way, atol=1e-9)
        assert pose.header.stamp.sec == 1 + box % 2
        if t > 0:
            normal = outward(pose)
            axis = int(np.abs(normal).argmax())
            assert np.allclose(np.abs(normal), np.eye(3)[axis], atol=1e-12)
            assert normal[axis] * way[axis] < 0
            face = (LOW if normal[axis] < 0 else HIGH)[box, axis]
            assert point[axis] == face


def test_raycast(filled):
    for start, goal in segments():
        plan = filled.plan('raycast', start, goal)
        hits, ts = expected_hits(start, goal)
        check_poses(plan.poses, hits[:1], ts[:1], start, goal - start)
        assert plan.header.frame_id == 'map'
        assert plan.header.stamp.sec == 2


def test_raycast_all(filled):
    for start, goal in segments():
        hits, ts = expected_hits(start, goal)
        check_poses(filled.plan('raycast_all', start, goal).poses, hits, ts, start, goal - start)


def distances_along(start, way, t):
    """Distance of each box from its own point start + t * way; t has one entry a box."""
    points = start + t[:, None] * way
    return np.linalg.norm(np.maximum(np.maximum(LOW - points, points - HIGH), 0), axis=1)


def nearest_approach(start, way):
    """Least distance of each box from the segment: convex along it, so by ternary search."""
    low, high = np.zeros(BOXES), np.ones(BOXES)
    for _ in range(120):
        a, b = low + (high - low) / 3, high - (high - low) / 3
        left = distances_along(start, way, a) < distances_along(start, way, b)
        low, high = np.where(left, low, a), np.where(left, b, high)
    return distances_along(start, way, (low + high) / 2)


def test_swept_ball(filled):
    for start, goal in segments():
        radius = float(np.float32(RNG.uniform(0.05, 1.0)))
        poses = filled.plan('raycast_all', start, goal, tolerance=radius).poses
        least = nearest_approach(start, goal - start)
        hits = set(numbers(poses))
        assert set(np.flatnonzero(least < radius - CLEAR)) <= hits
        assert hits <= set(np.flatnonzero(least <= radius + CLEAR))
        first = filled.plan('raycast', start, goal, tolerance=radius).poses
        assert numbers(first) == numbers(poses)[:1]
        for pose in poses:
            box, point = numbers([pose])[0], place(pose)
            assert (point >= LOW[box] - 1e-9).all()
            assert (point <= HIGH[box] + 1e-9).all()


def check_overlaps(poses, expected, centre):
    """Compare names, points and order with the boxes whose index is expected."""
    closest = np.clip(centre, LOW[expected], HIGH[expected])
    distance = np.linalg.norm(closest - centre, axis=1)
    order = np.lexsort((expected, distance))
    assert numbers(poses) == expected[order].tolist()
    for pose, point in zip(poses, closest[order], strict=True):
        assert np.allclose(place(pose), point, atol=1e-9)


def test_overlap_aligned_and_grown(filled):
    for centre in RNG.uniform(-10, 10, (CALLS // 3, 3)):
        half, grown = RNG.uniform(0, 2, 3), float(np.float32(RNG.uniform(0, 1)))
        gap = np.maximum(np.maximum(LOW - (centre + half), (centre - half) - HIGH), 0)
        expected = np.flatnonzero(np.linalg.norm(gap, axis=1) <= grown)
        poses = filled.plan('overlap', centre - half, centre + half, tolerance=grown).poses
        check_overlaps(poses, expected, centre)


def test_overlap_ball(filled):
    for centre in RNG.uniform(-10, 10, (CALLS // 3, 3)):
        radius = float(np.float32(RNG.uniform(0, 4)))
        gap = np.maximum(np.maximum(LOW - centre, centre - HIGH), 0)
        expected = np.flatnonzero(np.linalg.norm(gap, axis=1) <= radius)
        poses = filled.plan('overlap', centre, centre, tolerance=radius).poses
        check_overlaps(poses, expected, centre)


def separated(axes, centre, half):
    """Which boxes a box along these axes (rows) does not touch: fifteen separating axes."""
    apart = np.zeros(BOXES, dtype=bool)
    crossings = np.cross(np.eye(3)[:, None], axes[None]).reshape(9, 3)
    for axis in (*np.eye(3), *axes, *crossings):
        reach = np.abs(axes @ axis) @ half + np.abs(axis) @ (SIZE / 2).T
        apart |= np.abs((CENTRE - centre) @ axis) > reach
    return apart


def test_overlap_turned(filled):
    for centre in RNG.uniform(-10, 10, (CALLS // 3, 3)):
        half, q = RNG.uniform(0.1, 2, 3), RNG.normal(size=4)
        x, y, z, w = q / np.linalg.norm(q)
        axes = np.array(
            (
                (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)),
                (2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)),
                (2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)),
            )
        )
        corner = half @ axes
        poses = filled.plan('overlap', centre - corner, centre + corner, turn=(x, y, z, w)).poses
        check_overlaps(poses, np.flatnonzero(~separated(axes, centre, half)), centre)
