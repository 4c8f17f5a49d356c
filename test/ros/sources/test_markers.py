# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""MarkerArrays to changes of the scene."""

import math
from random import Random

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from ros import messages
from ros.messages import SECOND, stamp
from ros.sources.changes import change_of, source_of
from ros.sources.generators import ended
from visualization_msgs.msg import MarkerArray

from bvh_ros.ros.access import FrameError, Transform
from bvh_ros.scene import NodeScene, ShapeKind

ARROW, CUBE, SPHERE, CYLINDER, CUBE_LIST, SPHERE_LIST, MESH, TRIANGLES = 0, 1, 2, 3, 6, 7, 10, 11
DELETE, DELETE_ALL = 2, 3
NOW = 1_000_000_000_000


def marker(number=0, ns='a', shape=CUBE, action=0, *, lifetime=0, **given):
    """A marker whose times are ns."""
    told, place = stamp(given.pop('stamp', 0)), given.pop('at', (0, 0, 0))
    given = {'ns': ns, 'type': shape, 'action': action, 'frame': '', **given}
    made = messages.marker(number, place, given.pop('scale', (1, 1, 1)), **given)
    made.header.stamp = told
    made.lifetime.sec, made.lifetime.nanosec = divmod(lifetime, SECOND)
    return made


def into_map(frame_id, stamp):
    """Know two frames: map, and one that is half a turn about z and 10 m along x away."""
    del stamp
    if frame_id in ('', 'map'):
        return None
    if frame_id == 'turned':
        return Transform(np.array((10.0, 0.0, 0.0)), np.array((0.0, 0.0, 1.0, 0.0)))
    raise FrameError(f"no transform from '{frame_id}'")


def change(*array, prefix='', latest=None):
    return change_of(array, now=NOW, into_node=into_map, prefix=prefix, latest=latest)


def names_of(change):
    return list(change.names.texts())


def test_a_stamp_that_is_not_believed_adds_and_removes_nothing():
    late = {'stamp': NOW + 2}
    given = [
        marker(1),
        marker(2, **late),
        marker(3, action=DELETE),
        marker(4, action=DELETE, **late),
        marker(1, action=DELETE, **late),
        marker(0, ns='b', action=DELETE_ALL, **late),
        marker(0, ns='', action=DELETE_ALL, **late),
        marker(5, stamp=NOW + 1),
    ]
    found = change(*given, latest=NOW + 1)
    assert names_of(found) == ['a/1', 'a/5']
    assert list(found.removed.texts()) == ['a/3']
    assert (found.clears, found.namespaces) == (False, [])
    assert [refusal.row for refusal in found.refusals] == [1, 3, 4, 5, 6]
    assert {refusal.reason for refusal in found.refusals} == {'its stamp is too far in the future'}
    assert not change(*given[:3]).refusals


def test_thousands_become_one_change():
    array = [
        marker(i, shape=(CUBE, SPHERE, CYLINDER)[i % 3], at=(i, 2 * i, 3 * i), scale=(4, 5, 6))
        for i in range(3000)
    ]
    found = change(*array)
    assert not found.refusals
    assert names_of(found)[:2] == ['a/0', 'a/1']
    assert found.shapes.kind[:3].tolist() == [ShapeKind.BOX, ShapeKind.SPHERE, ShapeKind.CYLINDER]
    assert found.shapes.position[-1].tolist() == [2999, 5998, 8997]
    assert (found.shapes.size == (4, 5, 6)).all()
    assert (found.stamp == NOW).all()
    assert not found.expires.any()


def test_what_is_undone_is_not_done():
    found = change(
        marker(9, 'b'),
        marker(ns='b', action=3),
        marker(1),
        marker(2),
        marker(1, action=2),
        marker(2, action=2),
        marker(1, at=(5, 0, 0)),
        marker(1, at=(6, 0, 0)),
        marker(3, 'b', action=2),
    )
    assert not found.refusals
    assert not found.clears
    assert found.namespaces == ['b']
    assert list(found.removed.texts()) == ['a/1', 'a/2', 'b/3']
    assert names_of(found) == ['a/1', 'a/1']
    assert found.shapes.position[:, 0].tolist() == [5, 6]  # the scene takes the last
    found = change(marker(1), marker(ns='b', action=3), marker(ns='', action=3), marker(2))
    assert found.clears
    assert found.namespaces == []
    assert names_of(found) == ['a/2']


def test_stamps_and_lifetimes():
    update = change(
        marker(1, stamp=5_000_000_001),
        marker(2, stamp=5_000_000_001, lifetime=1_500_000_000),
        marker(3),
        marker(4, lifetime=-1),
    )
    refusals = update.refusals
    assert update.stamp.tolist() == [5_000_000_001, 5_000_000_001, NOW]
    assert update.expires.tolist() == [0, NOW + 1_500_000_000, 0]
    assert refusals[0].row == 3
    assert 'negative lifetime' in refusals[0].reason


def test_other_frames_are_transformed_or_refused():
    update = change(
        marker(1, frame='map', at=(1, 2, 3)),
        marker(2, frame='turned', at=(1, 2, 3)),
        marker(3, frame='nowhere'),
        marker(5, at=(4, 5, 6), stamp=8),
        marker(6, frame='turned', stamp=9),
        marker(4, frame='nowhere', shape=CUBE_LIST),
    )
    refusals = update.refusals
    assert names_of(update) == ['a/1', 'a/2', 'a/5', 'a/6']
    assert np.allclose(update.shapes.position, [[1, 2, 3], [9, -2, 3], [4, 5, 6], [10, 0, 0]])
    assert np.allclose(update.shapes.orientation[[1, 3]], [[0, 0, 1, 0], [0, 0, 1, 0]])
    assert update.stamp.tolist() == [NOW, NOW, 8, 9]
    assert [refusal.name for refusal in refusals] == ['a/3', 'a/4']
    assert all('nowhere' in refusal.reason for refusal in refusals)


def test_lists_have_elements_in_the_markers_frame():
    quarter = (0, 0, math.sqrt(0.5), math.sqrt(0.5))
    points = [(1, 0, 0), (0, 1, 0)]
    step = change(
        marker(7, 'n', CUBE_LIST, at=(10, 0, 0), turn=quarter, scale=(1, 2, 3), points=points)
    )
    assert not step.refusals
    assert step.lists == {'n/7': 2}
    assert names_of(step) == ['n/7#0', 'n/7#1']
    assert np.allclose(step.shapes.position, [[10, 1, 0], [9, 0, 0]])
    assert np.allclose(step.shapes.orientation, [quarter, quarter])
    assert (step.shapes.size == (1, 2, 3)).all()
    empty = change(marker(7, 'n', SPHERE_LIST))
    assert len(empty.shapes.kind) == 0
    assert empty.lists == {'n/7': 0}
    moved = change(
        marker(6, 'n'),
        marker(7, 'n', CUBE_LIST, frame='turned', at=(1, 2, 3), points=points),
        marker(8, 'n', SPHERE_LIST, points=points[:1]),
    )
    assert names_of(moved) == ['n/6', 'n/7#0', 'n/7#1', 'n/8#0']
    assert list(moved.singles.texts()) == ['n/6']
    assert np.allclose(moved.shapes.position[1:3], [[8, -2, 3], [9, -3, 3]])
    assert np.allclose(moved.shapes.orientation[1:3], [[0, 0, 1, 0]] * 2)


def test_a_name_that_is_a_list_and_a_single_one_is_what_it_is_at_last():
    points = [(1, 0, 0), (0, 1, 0)]
    several = marker(1, shape=CUBE_LIST, points=points)
    fewer = marker(1, shape=SPHERE_LIST, points=points[:1])
    bad_list, bad_single = (
        marker(1, shape=CUBE_LIST, at=(math.nan, 0, 0)),
        marker(1, scale=(-1, 1, 1)),
    )
    for array, names in (
        ((marker(1), several), ['a/1#0', 'a/1#1']),
        ((several, marker(1)), ['a/1']),
        ((several, fewer), ['a/1#0']),
        ((several, marker(2), bad_list), ['a/1#0', 'a/1#1', 'a/2']),
        ((several, bad_single), ['a/1#0', 'a/1#1', 'a/1']),  # which the scene refuses
    ):
        assert names_of(change(*array)) == names


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
    step = change(*array)
    assert step.refusals == []
    assert names_of(step) == ['a/1', 'n/2']
    assert step.shapes.kind.tolist() == [ShapeKind.BOX, ShapeKind.MESH]
    assert step.shapes.size[1].tolist() == [1, 2, 3]
    assert step.stamp.tolist() == [NOW, 7]
    scene = NodeScene()
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
    found = change(marker(1), bad, marker(2))
    refusals = found.refusals
    assert names_of(found) == ['a/1', 'a/2']
    assert [(refusal.row, refusal.name) for refusal in refusals] == [(1, 'a/5')]
    assert reason in refusals[0].reason


def test_names_of_many_namespaces_and_negative_ids():
    array = [marker(k - 3, ns=ns) for k in range(6) for ns in ('a', '', 'b/c', 'a')]
    update = change(*array)
    assert not update.refusals
    assert names_of(update) == [f'{m.ns}/{m.id}' for m in array]


def test_prefix_begins_every_name():
    found = change(
        marker(ns='b', action=3),
        marker(1),
        marker(2, action=2),
        marker(3, shape=CUBE_LIST),
        prefix='left.',
    )
    assert names_of(found) == ['left.a/1']
    assert list(found.removed.texts()) == ['left.a/2']
    assert list(found.lists) == ['left.a/3']
    assert found.namespaces == ['left.b']


class ToldScene:
    """What markers leave, told one by one."""

    def __init__(self):
        self.known = {}

    def tell(self, one):
        name, at = f'{one.ns}/{one.id}', one.pose.position.x
        listed = one.type in (CUBE_LIST, SPHERE_LIST)
        if one.action == 3:
            for other in [n for n in self.known if one.ns in ('', n.rpartition('/')[0])]:
                del self.known[other]
        elif one.action == 2:
            self.known.pop(name, None)
        elif one.type == ARROW or one.header.frame_id == 'nowhere':
            return
        elif listed and not math.isnan(at):
            self.known[name] = {f'#{k}': point.x + at for k, point in enumerate(one.points)}
        elif not listed and one.scale.x > 0:
            self.known[name] = {'': at}

    def places(self):
        return {n + k: at for n, parts in self.known.items() for k, at in parts.items()}


def random_marker(random):
    shape = random.choice([CUBE, SPHERE, CUBE_LIST, SPHERE_LIST, ARROW])
    action = random.choice([0] * 8 + [2, 3])
    namespace = random.choice(['a', 'b', 'a/c', '', 'a'])
    if action == 3 and random.random() < 0.5:
        namespace = namespace or 'b'
    bad = random.random() < 0.15
    return marker(
        random.randrange(-1, 3),
        namespace,
        shape,
        action,
        at=(math.nan if bad and shape >= CUBE_LIST else random.randrange(99), 0, 0),
        scale=(-1 if bad and shape < CUBE_LIST else 1,) * 3,
        frame='nowhere' if random.random() < 0.05 else '',
        points=[(random.randrange(50), 0, 0) for _ in range(random.randrange(4))],
    )


def test_any_message_ends_as_if_it_were_read_marker_by_marker():
    random = Random(7)
    for _ in range(100):
        scene, told = NodeScene(), ToldScene()
        source = source_of(scene, into_map)
        for _ in range(6):
            array = [random_marker(random) for _ in range(random.randrange(12))]
            ended(source.apply([serialize_message(MarkerArray(markers=array))], NOW))
            for one in array:
                told.tell(one)
            found = {name: scene.get(name).position[0] for _, name in scene.names()}
            assert found == told.places()
        scene.validate()
