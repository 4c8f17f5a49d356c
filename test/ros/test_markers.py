# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""MarkerArrays to steps on the scene."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from bvh_ros.ros.conversions import markers
from bvh_ros.ros.conversions.marker_table import table
from bvh_ros.ros.conversions.markers import Delete, DeleteAll, ReplaceList, Update
from bvh_ros.ros.frames import FrameError, Transform
from bvh_ros.scene import Scene, ShapeKind

ARROW, CUBE, SPHERE, CYLINDER, CUBE_LIST, SPHERE_LIST, MESH, TRIANGLES = 0, 1, 2, 3, 6, 7, 10, 11
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
    reading = markers.steps(table(array), now=NOW, into_node=into_map, prefix=prefix)
    return reading.steps, reading.refusals


def names_of(step):
    return list(step.names.texts())


def test_thousands_become_one_step():
    array = [
        marker(i, shape=(CUBE, SPHERE, CYLINDER)[i % 3], at=(i, 2 * i, 3 * i), scale=(4, 5, 6))
        for i in range(3000)
    ]
    (update,), refusals = steps(*array)
    assert not refusals
    assert isinstance(update, Update)
    assert names_of(update)[:2] == ['a/0', 'a/1']
    assert update.shapes.kind[:3].tolist() == [ShapeKind.BOX, ShapeKind.SPHERE, ShapeKind.CYLINDER]
    assert update.shapes.position[-1].tolist() == [2999, 5998, 8997]
    assert (update.shapes.size == (4, 5, 6)).all()
    assert (update.stamp == NOW).all()
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
    assert [type(step) for step in found] == [DeleteAll, Update, Delete, Update, DeleteAll]
    assert found[0].namespace == 'a'
    assert names_of(found[1]) == ['a/1', 'a/2']
    assert names_of(found[2]) == ['a/1', 'a/2']
    assert names_of(found[3]) == ['a/1', 'a/1']
    assert found[3].shapes.position[:, 0].tolist() == [5, 6]  # the scene takes the last
    assert found[4].namespace is None


def test_stamps_and_lifetimes():
    found, refusals = steps(
        marker(1, stamp=5_000_000_001),
        marker(2, stamp=5_000_000_001, lifetime=1_500_000_000),
        marker(3),
        marker(4, lifetime=-1),
    )
    (update,) = found
    assert update.stamp.tolist() == [5_000_000_001, 5_000_000_001, NOW]
    assert update.expires.tolist() == [0, NOW + 1_500_000_000, 0]
    assert refusals[0].row == 3
    assert 'negative lifetime' in refusals[0].reason


def test_other_frames_are_transformed_or_refused():
    found, refusals = steps(
        marker(1, frame='map', at=(1, 2, 3)),
        marker(2, frame='turned', at=(1, 2, 3)),
        marker(3, frame='nowhere'),
        marker(5, at=(4, 5, 6), stamp=8),
        marker(6, frame='turned', stamp=9),
        marker(4, frame='nowhere', shape=CUBE_LIST),
    )
    (update,) = found
    assert names_of(update) == ['a/1', 'a/2', 'a/5', 'a/6']
    assert np.allclose(update.shapes.position, [[1, 2, 3], [9, -2, 3], [4, 5, 6], [10, 0, 0]])
    assert np.allclose(update.shapes.orientation[[1, 3]], [[0, 0, 1, 0], [0, 0, 1, 0]])
    assert update.stamp.tolist() == [NOW, NOW, 8, 9]
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


CORNERS = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
TETRAHEDRON = [CORNERS[i] for face in ((0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)) for i in face]


def test_triangles_become_a_mesh_in_the_frame_of_the_marker():
    """Scale multiplies the points; the frame is half a turn about z and 10 m away."""
    array = (
        marker(1),
        marker(
            2,
            'n',
            TRIANGLES,
            points=TETRAHEDRON,
            scale=(1, 2, 3),
            at=(1, 0, 5),
            frame='turned',
            stamp=7,
        ),
    )
    (_, step), refusals = steps(*array)
    assert refusals == []
    assert names_of(step) == ['n/2']
    assert step.shapes.kind.tolist() == [ShapeKind.MESH]
    assert step.shapes.size.tolist() == [[1, 2, 3]]
    assert step.shapes.mesh[0].centre.tolist() == [0.5, 1, 1.5]
    assert step.stamp.tolist() == [7]
    scene = Scene()
    assert scene.update('test', step.names, step.shapes, stamp=1) == []
    hit = scene.raycast((8.9, -0.2, 9), (8.9, -0.2, 0))
    # At (0.1, 0.2) in the marker's frame the face x + y / 2 + z / 3 = 1 is 2.4 m high.
    assert np.allclose(hit.point, (8.9, -0.2, 7.4))


@pytest.mark.parametrize(
    ('bad', 'reason'),
    [
        (marker(shape=ARROW), 'ARROW'),
        (marker(shape=MESH), 'MESH_RESOURCE'),
        (marker(shape=TRIANGLES), '0 points are not triangles'),
        (marker(shape=TRIANGLES, points=TETRAHEDRON[:-1]), '11 points are not triangles'),
        (marker(shape=TRIANGLES, points=TETRAHEDRON[:-3]), 'not closed'),
        (marker(shape=TRIANGLES, points=[*TETRAHEDRON[:-1], (0, math.nan, 0)]), 'not finite'),
        (marker(shape=TRIANGLES, points=TETRAHEDRON, scale=(1, 1, 0)), 'flat'),
        (marker(shape=TRIANGLES, points=TETRAHEDRON, frame='nowhere'), 'no transform'),
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
    names = [name for step in found for name in names_of(step)]
    assert names == ['a/1', 'a/2']
    assert [(refusal.row, refusal.name) for refusal in refusals] == [(1, 'a/5')]
    assert reason in refusals[0].reason


def test_names_of_many_namespaces_and_negative_ids():
    array = [marker(k - 3, ns=ns) for k in range(6) for ns in ('a', '', 'b/c', 'a')]
    (update,), refusals = steps(*array)
    assert not refusals
    assert names_of(update) == [f'{m.ns}/{m.id}' for m in array]


def test_prefix_begins_every_name():
    found, _ = steps(
        marker(1),
        marker(2, action=2),
        marker(3, shape=CUBE_LIST),
        marker(action=3),
        prefix='left.',
    )
    assert names_of(found[0]) == ['left.a/1']
    assert names_of(found[1]) == ['left.a/2']
    assert found[2].name == 'left.a/3'
    assert found[3].namespace == 'left.a'
