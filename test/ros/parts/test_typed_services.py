# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The services of bvh_msgs: each row is what a scene of the same obstacles answers, and a row that
is not answered never looks free.
"""

import itertools
from array import array

import numpy as np
import pytest
from ros.messages import cloud

srv = pytest.importorskip('bvh_msgs.srv', reason='bvh_msgs is not built: pip install ./bvh_msgs')
if not hasattr(srv, 'Raycast'):
    pytest.skip('bvh_msgs is not built: pip install ./bvh_msgs', allow_module_level=True)

from ros.parts.mixed_world import FACING, PARAMETERS, PLACE, fill, same_scene  # noqa: E402
from turns import unit_quaternions  # noqa: E402

from bvh_ros.scene import NO_NODE  # noqa: E402

pytestmark = pytest.mark.slow

ROWS = 300
RNG = np.random.default_rng(23)
UNANSWERED = srv.Raycast.Response.UNANSWERED
OK, INCOMPLETE_WORLD, BAD_REQUEST, COMPILING, TOO_MANY_HITS = range(5)


@pytest.fixture(scope='module')
def world(start_node):
    world = start_node(PARAMETERS)
    fill(world)
    return world


@pytest.fixture(scope='module')
def scene():
    """The same world; its view shows every other one."""
    return same_scene()


def ask(world, kind, name, **fields):
    """The response to a request, once its kernels are there."""
    request = getattr(srv, kind).Request()
    for field, value in fields.items():
        if field == 'frame_id':
            request.header.frame_id = value
        elif field == 'stamp':
            request.header.stamp = value
        elif isinstance(value, np.ndarray):
            code = {'f': 'd', 'u': 'I' if value.itemsize == 4 else 'B'}[value.dtype.kind]
            setattr(request, field, array(code, value.tobytes()))
        else:
            setattr(request, field, value)
    responses = []

    def answered():
        responses.append(world.call(name, request, getattr(srv, kind)))
        return responses[-1].status != COMPILING

    world.until_compiled(answered)
    return responses[-1]


def rows_of(response):
    """The obstacles of each row."""
    offsets = response.offsets
    assert offsets[0] == 0
    assert offsets[-1] == len(response.obstacles)
    return [list(response.obstacles[a:b]) for a, b in itertools.pairwise(offsets)]


def points_of(response, field):
    return np.array(getattr(response, field)).reshape(-1, 3)


def in_lidar(points):
    """The same points in the frame of the lidar."""
    return FACING.inv().apply(points - PLACE)


def names_of(scene, rows):
    """Names in the order of handles; the node's handles are not those of this scene."""
    return [[scene.name_of(handle) for handle in row] for row in rows]


def names_in(response):
    names, offsets = list(response.names), response.offsets
    return [names[a:b] for a, b in itertools.pairwise(offsets)]


STARTS, GOALS = RNG.uniform(-7, 7, (ROWS, 3)), RNG.uniform(-7, 7, (ROWS, 3))


@pytest.mark.parametrize('radius', [None, 0.3])
@pytest.mark.parametrize('view', ['', 'even/'])
def test_segments_meet_what_they_meet_in_a_scene(world, scene, radius, view):
    radii = {} if radius is None else {'radii': np.array([radius])}
    starts, goals = {'starts': STARTS}, {'goals': GOALS}
    response = ask(world, 'Raycast', f'{view}query/raycast', **starts, **goals, **radii)
    assert response.status == OK, response.message
    assert list(response.statuses) == [OK] * ROWS
    mask = 2 if view else 0xFFFFFFFF
    hits = scene.raycast_many(STARTS, GOALS - STARTS, 1.0, mask, radius=radius)
    met = hits.handles != NO_NODE
    assert 0 < met.sum() < ROWS
    expected = [[scene.name_of(handle)] if handle != NO_NODE else [] for handle in hits.handles]
    assert names_in(response) == expected
    np.testing.assert_array_equal(response.t, hits.t[met])
    np.testing.assert_array_equal(points_of(response, 'points'), hits.points[met])
    np.testing.assert_array_equal(points_of(response, 'normals'), hits.normals[met])


def test_all_hits_come_nearest_first_and_no_more_than_the_limit(world, scene):
    asked = {'starts': STARTS, 'goals': GOALS, 'all_hits': True}
    response = ask(world, 'Raycast', 'query/raycast', **asked)
    expected = [scene.raycast_all(*row) for row in zip(STARTS, GOALS, strict=True)]
    assert names_in(response) == [[hit.name for hit in hits] for hits in expected]
    np.testing.assert_array_equal(response.t, [hit.t for hits in expected for hit in hits])
    total = len(response.obstacles)
    assert ask(world, 'Raycast', 'query/raycast', limit=total, **asked).status == OK
    response = ask(world, 'Raycast', 'query/raycast', limit=total - 1, **asked)
    assert response.status == TOO_MANY_HITS
    assert 'limit' in response.message
    assert rows_of(response) == [[UNANSWERED]] * ROWS
    assert np.isnan(response.t).all()


def test_another_frame_is_that_of_the_answers(world, scene):
    starts, goals = in_lidar(STARTS), in_lidar(GOALS)
    response = ask(world, 'Raycast', 'query/raycast', starts=starts, goals=goals, frame_id='lidar')
    hits = scene.raycast_many(STARTS, GOALS - STARTS, 1.0)
    met = hits.handles != NO_NODE
    assert names_in(response) == names_of(
        scene, [[h] if h != NO_NODE else [] for h in hits.handles]
    )
    np.testing.assert_allclose(
        points_of(response, 'points'), in_lidar(hits.points[met]), atol=1e-9
    )
    turned = FACING.inv().apply(hits.normals[met])
    np.testing.assert_allclose(points_of(response, 'normals'), turned, atol=1e-9)


def test_boxes_touch_what_they_touch_in_a_scene(world, scene):
    sizes, turns = RNG.uniform(0.0, 2.0, (ROWS, 3)), unit_quaternions(RNG.normal(size=(ROWS, 4)))
    asked = {
        'centers': STARTS,
        'sizes': sizes,
        'orientations': turns,
        'tolerances': np.array([0.2]),
    }
    response = ask(world, 'Overlap', 'query/overlap', **asked)
    assert response.status == OK, response.message
    offsets, handles = scene.overlap_many(STARTS, sizes, turns, 0.2, want='all')
    rows = np.split(handles, offsets[1:-1])
    assert names_in(response) == names_of(scene, rows)
    one = ask(world, 'Overlap', 'query/overlap', centers=STARTS, sizes=np.full(3, 0.5))
    offsets, handles = scene.overlap_many(STARTS, np.full(3, 0.5), want='all')
    assert names_in(one) == names_of(scene, np.split(handles, offsets[1:-1]))
    few = ask(world, 'Overlap', 'query/overlap', limit=1, **asked)
    assert few.status == TOO_MANY_HITS
    assert rows_of(few) == [[UNANSWERED]] * ROWS


@pytest.mark.parametrize('signed', [False, True])
def test_points_are_as_far_as_in_a_scene(world, scene, signed):
    asked = {'points': STARTS, 'limit': 3, 'max_distances': np.array([2.0])}
    response = ask(world, 'Nearest', 'query/nearest', signed_distances=signed, **asked)
    assert response.status == OK, response.message
    handles, distances, points = scene.nearest_many(STARTS, 3, 2.0, signed=signed)
    found = handles != NO_NODE
    rows = [row[there] for row, there in zip(handles, found, strict=True)]
    assert names_in(response) == names_of(scene, rows)
    np.testing.assert_array_equal(response.distances, distances[found])
    np.testing.assert_array_equal(points_of(response, 'closest'), points[found])
    ends = np.repeat(STARTS, 3, axis=0).reshape(ROWS, 3, 3)[found]
    reached = points[found] + points_of(response, 'normals') * distances[found][:, None]
    np.testing.assert_allclose(reached, ends, atol=1e-9)


NAN = np.array((1.0, np.nan, 0.0))
ONE = {'sizes': np.ones(3), 'kinds': np.zeros(1, np.uint8)}
BAD_ROWS = [
    ('Raycast', {'starts': NAN, 'goals': np.zeros(3)}, 'row 0: its origin is not finite'),
    ('Raycast', {'starts': np.zeros(3), 'goals': np.full(3, np.inf)}, 'direction is not finite'),
    ('Raycast', {'starts': np.zeros(3), 'goals': np.ones(3), 'radii': -np.ones(1)}, 'radius'),
    ('Overlap', {'centers': NAN, 'sizes': np.ones(3)}, 'centre is not finite'),
    ('Overlap', {'centers': np.ones(3), 'sizes': -np.ones(3)}, 'size'),
    ('Nearest', {'points': NAN}, 'point is not finite'),
    ('Nearest', {'points': np.ones(3), 'max_distances': np.array([np.nan])}, 'max_distance'),
    (
        'Clearance',
        {'positions': np.ones(3), 'sizes': np.ones(3), 'kinds': np.array([4], np.uint8)},
        'kind',
    ),
    (
        'Clearance',
        {'positions': np.ones(3), 'sizes': np.arange(1.0, 4.0), 'kinds': np.ones(1, np.uint8)},
        'diameters',
    ),
    ('Sweep', {'positions': np.ones(3), 'goal_positions': NAN, **ONE}, 'at its goal, its centre'),
    (
        'Sweep',
        {'positions': np.ones(3), 'goal_positions': np.ones(3), 'tolerances': -np.ones(1), **ONE},
        'its tolerance is not finite, or negative',
    ),
]


@pytest.mark.parametrize(('kind', 'fields', 'reason'), BAD_ROWS)
def test_a_bad_row_is_not_answered_and_the_others_are(world, kind, fields, reason):
    name = f'query/{kind.lower()}'
    alone = ask(world, kind, name, **fields)
    assert (alone.status, list(alone.statuses)) == (BAD_REQUEST, [BAD_REQUEST])
    assert reason in alone.message
    assert list(alone.obstacles) == [UNANSWERED]
    place = next(f for f in ('starts', 'centers', 'points', 'positions') if f in fields)
    both = {f: np.concatenate((np.full_like(v, 1), v)) for f, v in fields.items()}
    assert len(both[place]) == 6
    response = ask(world, kind, name, **both)
    assert list(response.statuses) == [OK, BAD_REQUEST]
    assert response.status == BAD_REQUEST
    assert reason.replace('row 0', 'row 1') in response.message
    assert response.obstacles[-1] == UNANSWERED
    if kind not in ('Clearance', 'Sweep'):
        assert rows_of(response)[1] == [UNANSWERED]
    assert UNANSWERED not in list(response.obstacles)[:-1]


BAD_REQUESTS = [
    ('Raycast', {'starts': np.zeros(4), 'goals': np.zeros(3)}, 'no multiple of 3'),
    ('Raycast', {'starts': np.zeros(6), 'goals': np.zeros(3)}, '2 starts and 1 goals'),
    ('Raycast', {'starts': np.zeros(9), 'goals': np.ones(9), 'radii': np.ones(2)}, 'radii has 2'),
    ('Raycast', {'starts': np.zeros(3), 'goals': np.ones(3), 'frame_id': 'moon'}, 'moon'),
    (
        'Raycast',
        {'starts': np.zeros(3), 'goals': np.ones(3), 'durations': np.ones(1)},
        'durations',
    ),
    ('Overlap', {'centers': np.zeros(3)}, 'sizes is empty'),
    ('Nearest', {'points': np.zeros(3), 'limit': 0}, 'limit is 0'),
    ('Clearance', {'positions': np.zeros(3), 'sizes': np.ones(3)}, 'kinds is empty'),
    ('Sweep', {'positions': np.zeros(3), **ONE}, '1 positions and 0 goal_positions'),
    (
        'Sweep',
        {'positions': np.zeros(3), 'goal_positions': np.ones(3), 'resolution': 0.0, **ONE},
        'resolution must be finite and above 0',
    ),
]


@pytest.mark.parametrize(('kind', 'fields', 'reason'), BAD_REQUESTS)
def test_a_request_that_contradicts_itself_has_no_free_row(world, kind, fields, reason):
    response = ask(world, kind, f'query/{kind.lower()}', **fields)
    assert response.status == BAD_REQUEST
    assert reason in response.message
    assert len(response.statuses) >= 1
    assert set(response.statuses) == {BAD_REQUEST}
    assert set(response.obstacles) == {UNANSWERED}


def test_many_rows_are_answered_in_pieces_and_equal_one_each(world, scene):
    count = 20_000
    starts, goals = RNG.uniform(-7, 7, (count, 3)), RNG.uniform(-7, 7, (count, 3))
    response = ask(
        *(world, 'Raycast', 'query/raycast'), starts=starts, goals=goals, with_names=False
    )
    assert list(response.names) == []
    hits = scene.raycast_many(starts, goals - starts, 1.0)
    np.testing.assert_array_equal(response.t, hits.t[hits.handles != NO_NODE])
    np.testing.assert_array_equal(np.diff(response.offsets), hits.handles != NO_NODE)


def test_an_incomplete_world_has_no_free_row(start_node):
    lidar = {'type': 'PointCloud2', 'topic': 'lidar', 'required': True}
    node = start_node({'sources': ['lidar'], 'lidar': lidar})
    fields = {'starts': np.zeros(6), 'goals': np.ones(6)}
    response = ask(node, 'Raycast', 'query/raycast', **fields)
    assert response.status == INCOMPLETE_WORLD
    assert 'lidar' in response.message
    assert rows_of(response) == [[UNANSWERED]] * 2


SECOND = 1_000_000_000


def test_rows_leave_and_arrive_at_times(start_node):
    tracks = {'type': 'PointCloud2', 'topic': 'tracks', 'predict': 'given', 'voxel': 1.0}
    node = start_node({'sources': ['tracks'], 'tracks': tracks, 'max_prediction': 2.0})
    crate = cloud({'x': [10.0], 'y': [0.0], 'z': [0.0], 'vx': [-5.0], 'vy': [0.0], 'vz': [0.0]})
    now = node.node.get_clock().now()
    crate.header.stamp = now.to_msg()
    node.publish('tracks', crate)
    starts, goals = np.zeros((3, 3)), np.tile((20.0, 0.0, 0.0), (3, 1))
    asked = {'starts': starts, 'goals': goals, 'stamp': now.to_msg()}
    node.until_compiled(lambda: ask(node, 'Raycast', 'query/raycast', **asked).status == OK)
    node.until(lambda: list(ask(node, 'Raycast', 'query/raycast', **asked).statuses) == [OK] * 3)
    as_told = ask(node, 'Raycast', 'query/raycast', starts=starts, goals=goals)
    np.testing.assert_allclose(points_of(as_told, 'points')[:, 0], 9.5)
    times = {'departures': np.array((0.0, 1.0, 9.0)), 'durations': np.array((2.0, 0.0, 0.0))}
    for all_hits in (False, True):
        response = ask(node, 'Raycast', 'query/raycast', all_hits=all_hits, **asked, **times)
        # 10 m/s from the origin meets the box, which comes with 5 m/s, after 9.5 / 15 s.
        np.testing.assert_allclose(response.t[:2], (9.5 / 15 / 2, 4.5 / 20))
        assert list(response.statuses) == [OK, OK, BAD_REQUEST]  # nobody knows that time
        assert response.obstacles[2] == UNANSWERED
        assert 'max_prediction' in response.message
    for kind, fields in (
        ('Overlap', {'centers': np.array((4.0, 0.0, 0.0)), 'sizes': np.full(3, 2.0)}),
        ('Nearest', {'points': np.array((4.0, 0.0, 0.0))}),
        (
            'Clearance',
            {
                'positions': np.array((4.0, 0.0, 0.0)),
                'sizes': np.full(3, 2.0),
                'kinds': np.zeros(1, np.uint8),
            },
        ),
    ):
        name = f'query/{kind.lower()}'
        later = ask(node, kind, name, departures=np.ones(1), stamp=now.to_msg(), **fields)
        assert later.status == OK, later.message
        assert list(later.names) == ['tracks#0']
        told = ask(node, kind, name, **fields)
        if kind == 'Overlap':
            assert list(told.obstacles) == []
        else:
            assert told.distances[0] == pytest.approx(5.5 if kind == 'Nearest' else 4.5)
            assert later.distances[0] == pytest.approx(0.5 if kind == 'Nearest' else 0.0)


@pytest.mark.parametrize('kind', ['Raycast', 'Overlap', 'Nearest', 'Clearance', 'Sweep'])
@pytest.mark.parametrize('frame_id', ['', 'lidar'])
def test_a_request_without_rows_is_answered(world, kind, frame_id):
    response = ask(world, kind, f'query/{kind.lower()}', frame_id=frame_id)
    assert (response.status, response.message) == (OK, '')
    assert not len(response.statuses)
    assert not len(response.obstacles)
    assert list(getattr(response, 'offsets', [0])) == [0]
