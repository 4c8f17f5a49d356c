# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""GetPlan requests to queries, answers to replies."""

import math

import numpy as np
import pytest
from nav_msgs.msg import Path
from ros.messages import coordinates, get_plan

from bvh_ros.ros.conversions import plans
from bvh_ros.ros.world.frames import FrameError, Frames, Transform
from bvh_ros.scene import SceneHit


def known(target, source, stamp):
    assert target == 'map'
    if source == 'turned':
        return Transform(np.array((10.0, 0.0, 0.0)), np.array((0.0, 0.0, 1.0, 0.0)))
    raise FrameError(f"no transform from '{source}' at {stamp}")


FRAMES = Frames('map', known)


def request(start=(0, 0, 0), goal=(1, 0, 0), start_frame='', goal_frame=''):
    message = get_plan(start, goal)
    message.start.header.frame_id, message.goal.header.frame_id = start_frame, goal_frame
    return message


def read(message, *, oriented=False):
    return plans.query(message, FRAMES.into_node, oriented=oriented)


def test_frames_of_start_and_goal_may_differ():
    query = read(request((1, 2, 3), (1, 2, 3), start_frame='turned', goal_frame='map'))
    assert np.allclose(query.start, (9, -2, 3))
    assert query.goal == (1, 2, 3)


def test_the_box_turns_with_the_frame_of_start():
    message = request(start_frame='turned')
    turn = message.start.pose.orientation
    turn.x, turn.w = 1.0, 0.0  # half a turn about x, then half a turn about z: about y
    assert np.allclose(np.abs(read(message, oriented=True).orientation), (0, 1, 0, 0))


def test_orientation_matters_for_boxes_only():
    message = request()
    message.start.pose.orientation.x = math.nan
    read(message)
    with pytest.raises(ValueError, match='orientation'):
        read(message, oriented=True)


def test_reply():
    hits = [
        SceneHit('a/1', 1, 0.5, np.array((1.0, 2.0, 3.0)), np.array((-1.0, 0.0, 0.0)), 5 * 10**9),
        SceneHit('a/2', 2, 0.6, np.array((4.0, 5.0, 6.0)), np.zeros(3), 6 * 10**9 + 7),
    ]
    plan = Path()
    plans.Replies().fill(plan, hits, 'map', 9 * 10**9 + 1)
    assert plan.header.frame_id == 'map'
    assert (plan.header.stamp.sec, plan.header.stamp.nanosec) == (9, 1)
    first, second = plan.poses
    assert first.header.frame_id == 'a/1'
    assert coordinates(first) == (1, 2, 3)
    assert (first.pose.orientation.z, first.pose.orientation.w) == (1, 0)
    assert (second.header.stamp.sec, second.header.stamp.nanosec) == (6, 7)
    assert second.pose.orientation.w == 1


def test_replies_of_any_length_one_after_the_other():
    """Poses are used again: nothing of an earlier reply may show."""
    replies = plans.Replies()
    for count in (1, 40, 0, 3, 16, 17, 1):
        hits = [
            SceneHit(f'{count}/{i}', i, 0.0, np.full(3, 100.0 * count + i), np.zeros(3), i * 10**9)
            for i in range(count)
        ]
        plan = Path()
        replies.fill(plan, hits, 'map', 0)
        assert [pose.header.frame_id for pose in plan.poses] == [hit.name for hit in hits]
        assert [pose.header.stamp.sec for pose in plan.poses] == list(range(count))
        assert [pose.pose.position.z for pose in plan.poses] == [hit.point[2] for hit in hits]
        assert len({id(pose) for pose in plan.poses}) == count
