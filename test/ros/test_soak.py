# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The soak finds every kind of wrong answer, and finds none in a short run over ROS 2."""

import os
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

from rclpy.serialization import deserialize_message
from ros import soak
from ros.patience import COMPILING
from ros.soak import BOXES, HALF, Found, scene_at
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.scene import Scene, ShapeKind, Shapes

MINUTES = 1.0 if os.environ.get('BVH_ROS_LONG_TESTS') else 0.25  # by hand: half an hour
FRAME = 777


def turns(scene):
    zero = np.zeros(BOXES)
    return np.column_stack((zero, zero, np.sin(scene.yaw / 2), np.cos(scene.yaw / 2)))


def test_a_published_frame_is_that_of_the_scene():
    message = deserialize_message(soak.Frames().message(FRAME), MarkerArray)
    scene, turn = scene_at(FRAME), turns(scene_at(FRAME))
    assert sorted(marker.id for marker in message.markers) == list(range(BOXES))
    for marker in message.markers:
        box, pose, scale = marker.id, marker.pose, marker.scale
        assert marker.action == (Marker.ADD if scene.present[box] else Marker.DELETE)
        assert (marker.ns, marker.type, marker.header.stamp.sec) == (
            'soak',
            Marker.CUBE,
            FRAME + 1,
        )
        at, q = pose.position, pose.orientation
        assert (at.x, at.y, at.z) == tuple(scene.centre[box])
        assert (q.x, q.y, q.z, q.w) == tuple(turn[box])
        assert (scale.x, scale.y, scale.z) == tuple(2 * HALF[box])


@pytest.fixture(scope='module')
def told():
    """The scene of a frame, as the package answers about it without ROS."""
    scene = scene_at(FRAME)
    rows = np.flatnonzero(scene.present)
    kind = np.full(len(rows), ShapeKind.BOX, np.uint8)
    shapes = Shapes(kind, scene.centre[rows], turns(scene)[rows], 2 * HALF[rows])
    told = Scene()
    assert told.update('soak', [str(row) for row in rows], shapes, stamp=1) == []
    return told


def found(hits):
    points = np.array([hit.point for hit in hits]).reshape(-1, 3)
    return Found([int(hit.name) for hit in hits], points)


def with_one_missing(answer):
    return Found(answer.boxes[1:], answer.points[1:])


def with_one_too_much(answer):
    away = int(np.flatnonzero(~scene_at(FRAME).present)[0])
    return Found([*answer.boxes, away], np.vstack((answer.points, scene_at(FRAME).centre[away])))


def with_one_twice(answer):
    return Found([*answer.boxes, answer.boxes[-1]], np.vstack((answer.points, answer.points[-1:])))


def backwards(answer):
    return Found(answer.boxes[::-1], answer.points[::-1])


def with_a_point_off(answer):
    return Found(answer.boxes, answer.points + np.array((0.0, 1e-5, 0.0)))


SPOILT = [with_one_missing, with_one_too_much, with_one_twice, backwards, with_a_point_off]


@pytest.mark.parametrize('kind', ['ray', pytest.param('box', marks=pytest.mark.slow), 'ball'])
def test_right_answers_pass_and_wrong_ones_do_not(told, kind):
    scene, rng = scene_at(FRAME), np.random.default_rng(3)
    several = 0
    for _ in range(150):
        start, goal = rng.uniform(0, 40, (2, 3))
        if kind == 'ray':
            answer = found(told.raycast_all(start, goal))
            given = {'start': start, 'goal': goal, 'first': False}
        elif kind == 'box':
            goal = start + 5.0
            answer = found(told.overlap(start, goal))
            given = {'centre': 0.5 * (start + goal), 'half': 0.5 * (goal - start)}
        else:
            answer = found(told.overlap(start, start, tolerance=4.0))
            given = {'centre': start, 'half': 4.0}
        fault = soak.ray_fault if kind == 'ray' else soak.overlap_fault
        assert fault(scene, answer, **given) == ''
        if len(answer.boxes) > 1:
            several += 1
            for spoil in SPOILT:
                assert fault(scene, spoil(answer), **given), spoil
            assert fault(scene_at(FRAME + 5), answer, **given)  # another frame's answer
    assert several > 20


def test_the_first_hit(told):
    scene, rng = scene_at(FRAME), np.random.default_rng(4)
    several = 0
    for _ in range(150):
        start, goal = rng.uniform(0, 40, (2, 3))
        given = {'start': start, 'goal': goal, 'first': True}
        hits = told.raycast_all(start, goal)
        assert soak.ray_fault(scene, found(hits[:1]), **given) == ''
        if len(hits) > 1:
            several += 1
            assert soak.ray_fault(scene, found(hits[1:2]), **given) == 'something else comes first'
            assert soak.ray_fault(scene, found([]), **given).startswith('free')
    assert several > 20


@pytest.mark.slow
def test_a_short_soak():
    command = [sys.executable, soak.__file__, str(MINUTES)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=COMPILING, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    figures = dict(line.rsplit(None, 1) for line in ended.stdout.splitlines())
    assert figures['wrong answers'] == '0'
    assert figures['messages refused'] == '0'
    assert int(figures['answers']) > 10
    assert int(figures['frames asked about']) > 3
