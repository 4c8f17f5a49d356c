# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The soak finds every kind of wrong answer, and finds none in a short run over ROS 2."""

import os
import subprocess
import sys

import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from ros import soak
from ros.messages import coordinates
from ros.patience import COMPILING
from ros.soak import BOXES, SIZE, Found, fault, frame_at, scene_at
from visualization_msgs.msg import Marker, MarkerArray

MINUTES = 1.0 if os.environ.get('BVH_ROS_LONG_TESTS') else 0.25  # by hand: half an hour
FRAME = 777


def test_a_published_frame_is_that_of_the_scene():
    message = deserialize_message(soak.Frames().message(FRAME), MarkerArray)
    frame, scene = frame_at(FRAME), scene_at(FRAME)
    assert sorted(marker.id for marker in message.markers) == list(range(BOXES))
    assert 0.8 * BOXES < len(scene) == frame.present.sum() < BOXES
    for marker in message.markers:
        box, pose = marker.id, marker.pose
        assert marker.action == (Marker.ADD if frame.present[box] else Marker.DELETE)
        told = marker.ns, marker.type, marker.header.stamp.sec
        assert told == ('soak', Marker.CUBE, FRAME + 1)
        assert coordinates(pose.position) == tuple(frame.centre[box])
        assert coordinates(pose.orientation) == tuple(frame.turn[box])
        assert coordinates(marker.scale) == tuple(SIZE[box])


def missing(answer):
    return answer[1:]


def too_much(answer):
    return [*answer, Found('soak/x', answer[-1].point)]


def twice(answer):
    return [*answer, answer[-1]]


def backwards(answer):
    return answer[::-1]


def a_point_off(answer):
    x, y, z = answer[0].point
    return [Found(answer[0].name, (x, y + 1e-12, z)), *answer[1:]]


@pytest.mark.parametrize('spoil', [missing, too_much, twice, backwards, a_point_off])
def test_right_answers_pass_and_wrong_ones_do_not(spoil):
    scene, rng, several = scene_at(FRAME), np.random.default_rng(3), 0
    for start, goal in rng.uniform(0, 40, (150, 2, 3)):
        hits = scene.raycast_all(start, goal)
        answer = [Found(hit.name, tuple(hit.point.tolist())) for hit in hits]
        assert fault(answer, hits, start, first=False) == ''
        assert fault(answer[:1], hits, start, first=True) == ''
        if len(hits) > 1:
            several += 1
            assert fault(spoil(answer), hits, start, first=False)
            assert fault(answer, scene_at(FRAME + 5).raycast_all(start, goal), start, first=False)
            for wrong in ([], answer[:2], *([answer[-1:]] if hits[-1].t > hits[0].t else [])):
                assert fault(wrong, hits, start, first=True)
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
