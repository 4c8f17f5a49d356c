# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""MarkerArrays to steps on the scene."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from bvh_ros.ros.conversions import markers
from bvh_ros.ros.conversions.markers import Delete, DeleteAll, ReplaceList, Update
from bvh_ros.ros.frames import FrameError, Transform
from bvh_ros.scene import ShapeKind

ARROW, CUBE, SPHERE, CYLINDER, CUBE_LIST, SPHERE_LIST, MESH = 0, 1, 2, 3, 6, 7, 10
NOW = 1_000_000_000_000


def vector(x=0.0, y=0.0, z=0.0, **more):
    return SimpleNamespace(x=x, y=y, z=z, **more)


def marker(number=0, ns='a', shape=CUBE, action=0, **given):
    """A marker with the fields that are read."""
    stamp, lifetime = given.get('stamp', 0), given.get('lifetime', 0)
    turn = given.get('turn', (0, 0, 0, 1))
    return SimpleNamespace(
        header=SimpleNamespace(
            frame_id=given.get('frame', ''),
            stamp=SimpleNamespace(sec=stamp // 10**9, nanosec=stamp % 10**9),
        ),
        ns=ns,
        id=number,
        type=shape,
        action=action,
        pose=SimpleNamespace(
            position=vector(*given.get('at', (0, 0, 0))), orientation=vector(*turn[:3], w=turn[3])
        ),
        scale=vector(*given.get('scale', (1, 1, 1))),
        lifetime=SimpleNamespace(sec=lifetime // 10**9, nanosec=lifetime % 10**9),
        points=[vector(*point) for point in given.get('points', ())],
    )


def into_map(frame_id, stamp):
    """Know two frames: map, and one that is half a turn about z and 10 m along x away."""
    del stamp
    if frame_id in ('', 'map'):
        return None
    if frame_id == 'turned':
        return Transform(np.array((10.0, 0.0, 0.0)), np.array((0.0, 0.0, 1.0, 0.0)))
    raise FrameError(f"no transform from '{frame_id}'")


def steps(*array, prefix=''):
    reading = markers.steps(array, now=NOW, into_node=into_map, prefix=prefix)
    return reading.steps, reading.refusals


def test_thousands_become_one_step():
    array = [
        marker(i, shape=(CUBE, SPHERE, CYLINDER)[i % 3], at=(i, 2 * i, 3 * i), scale=(4, 5, 6))
        for i in range(3000)
    ]
    (update,), refusals = steps(*array)
    assert not refusals
    assert isinstance(update, Update)
    assert update.names[:2] == ['a/0', 'a/1']
    assert update.shapes.kind[:3].tolist() == [ShapeKind.BOX, ShapeKind.SPHERE, ShapeKind.CYLINDER]
    assert update.shapes.position[-1].tolist() == [2999, 5998, 8997]
    assert (update.shapes.size == (4, 5, 6)).all()
    assert update.stamp == NOW
    assert not update.expires.any()


def test_order_is_kept():
    found, refusals = steps(
        marker(action=3),
        marker(1),
        marker(2),
        marker(1, action=2),
        marker(2, action=2),
        marker(1, at=(5, 0, 0)),
        marker(1, at=(6, 0, 0)),
        marker(ns='', action=3),
    )
    assert not refusals
    assert [type(step) for step in found] == [DeleteAll, Update, Delete, Update, Update, DeleteAll]
    assert found[0].namespace == 'a'
    assert found[1].names == ['a/1', 'a/2']
    assert found[2].names == ['a/1', 'a/2']
    assert found[4].shapes.position[0, 0] == 6
    assert found[5].namespace is None


def test_stamps_and_lifetimes():
    found, refusals = steps(
        marker(1, stamp=5_000_000_001),
        marker(2, stamp=5_000_000_001, lifetime=1_500_000_000),
        marker(3),
        marker(4, lifetime=-1),
    )
    assert [step.stamp for step in found] == [5_000_000_001, NOW]
    assert found[0].expires.tolist() == [0, NOW + 1_500_000_000]
    assert refusals[0].row == 3
    assert 'negative lifetime' in refusals[0].reason


def test_other_frames_are_transformed_or_refused():
    found, refusals = steps(
        marker(1, frame='map', at=(1, 2, 3)),
        marker(2, frame='turned', at=(1, 2, 3)),
        marker(3, frame='nowhere'),
        marker(4, frame='nowhere', shape=CUBE_LIST),
    )
    assert np.allclose(found[0].shapes.position, [[1, 2, 3]])
    assert np.allclose(found[1].shapes.position, [[9, -2, 3]])
    assert np.allclose(found[1].shapes.orientation, [[0, 0, 1, 0]])
    assert [refusal.name for refusal in refusals] == ['a/3', 'a/4']
    assert all('nowhere' in refusal.reason for refusal in refusals)


def test_lists_have_elements_in_the_markers_frame():
    quarter = (0, 0, math.sqrt(0.5), math.sqrt(0.5))
    points = [(1, 0, 0), (0, 1, 0)]
    (step,), refusals = steps(
        marker(7, 'n', CUBE_LIST, at=(10, 0, 0), turn=quarter, scale=(1, 2, 3), points=points)
    )
    assert not refusals
    assert isinstance(step, ReplaceList)
    assert step.name == 'n/7'
    assert np.allclose(step.shapes.position, [[10, 1, 0], [9, 0, 0]])
    assert np.allclose(step.shapes.orientation, [quarter, quarter])
    assert (step.shapes.size == (1, 2, 3)).all()
    (empty,), _ = steps(marker(7, 'n', SPHERE_LIST))
    assert len(empty.shapes.kind) == 0


@pytest.mark.parametrize(
    ('bad', 'reason'),
    [
        (marker(shape=ARROW), 'ARROW'),
        (marker(shape=MESH), 'MESH_RESOURCE'),
        (marker(shape=99), 'unknown'),
        (marker(shape=-1), 'unknown'),
        (marker(action=1), 'unknown marker action 1'),
        (marker(action=-2), 'unknown marker action -2'),
        (marker(shape=CUBE_LIST, scale=(1, math.nan, 1)), 'not finite'),
        (marker(shape=SPHERE_LIST, at=(math.inf, 0, 0)), 'not finite'),
        (marker(shape=CUBE_LIST, turn=(0, 0, math.nan, 1)), 'not finite'),
    ],
)
def test_a_marker_that_cannot_be_used_does_not_harm_the_others(bad, reason):
    bad.id = 5
    found, refusals = steps(marker(1), bad, marker(2))
    names = [name for step in found for name in step.names]
    assert names == ['a/1', 'a/2']
    assert [(refusal.row, refusal.name) for refusal in refusals] == [(1, 'a/5')]
    assert reason in refusals[0].reason


def test_prefix_begins_every_name():
    found, _ = steps(
        marker(1),
        marker(2, action=2),
        marker(3, shape=CUBE_LIST),
        marker(action=3),
        prefix='left.',
    )
    assert found[0].names == ['left.a/1']
    assert found[1].names == ['left.a/2']
    assert found[2].name == 'left.a/3'
    assert found[3].namespace == 'left.a'
