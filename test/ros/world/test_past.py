# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Questions about the past of a node: what was known then."""

import time

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from ros.messages import SECOND, cloud, marker, stamp
from ros.patience import PATIENCE
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.client import UNANSWERED, BvhError
from bvh_ros.ros.world.known_times import KnownTimes, Span
from bvh_ros.ros.world.large_changes import LargeChanges
from bvh_ros.scene import NodeScene, Shapes

TICK = SECOND // 10
NOW = 1_790_000_000 * SECOND


def tell(times, scene, place, at, speed=None):
    """Tell where the only box is, at some tick."""
    box = Shapes.boxes([[place, 0, 0]], [1, 1, 1])
    speeds = None if speed is None else [[speed, 0, 0]]
    scene.replace('s', '', ['one'], box, stamp=NOW + at * TICK, velocities=speeds)
    list(times.note(None, NOW + 100 * TICK))


def place_at(times, ticks, now=100):
    """Where the box is known to be; None where that is an error."""
    at, now = NOW + round(ticks * TICK), NOW + now * TICK
    try:
        span = times.require(Span(at), now)
    except ValueError:
        return None
    hit = times.state(span.at, now).raycast([-99, 0, 0], [99, 0, 0], at=at)
    return round(float(hit.point[0]) + 0.5, 6)


def test_each_time_has_what_was_known_then():
    scene = NodeScene(max_prediction=1.0)
    times = KnownTimes(LargeChanges(scene), 1.0, 1.0)
    with pytest.raises(ValueError, match='nothing has been told'):
        times.require(Span(NOW), NOW)
    for tick in range(31):
        tell(times, scene, float(tick), tick, 10.0 if tick < 25 else 0.0)
    # 1 m a tick, seen until tick 25; from then on it stands where it is told to be.
    wanted = {19.9: None, 20: 20, 20.5: 20.5, 24.9: 24.9, 25: 25, 25.5: 25, 26: 26, 29.5: 29}
    wanted |= {30: 30, 40: 30, 40.1: None}
    assert {tick: place_at(times, tick) for tick in wanted} == wanted
    stamps = times.stamps()
    assert (np.diff(stamps) > 0).all()
    assert stamps[0] == NOW + 20 * TICK  # no more than is needed
    # Late data belong to what is known since the newest.
    tell(times, scene, 7.0, 28)
    assert (np.diff(times.stamps()) > 0).all()
    assert place_at(times, 29) == 29
    assert place_at(times, 30) == 7
    times.forget()
    assert place_at(times, 29) is None
    assert place_at(times, 30) == 7
    tell(times, scene, 8.0, 30)
    assert place_at(times, 30) == 8


def test_a_stamp_in_the_future_hides_nothing_that_is_told_later():
    scene = NodeScene(max_prediction=1.0)
    times = KnownTimes(LargeChanges(scene), 1.0, 5.0)
    other = Shapes.boxes([[0, 50, 0]], [1, 1, 1])
    for tick in range(20):
        if tick % 5 == 0:
            ahead = SECOND if tick else 3
            scene.update('map', ['map'], other, stamp=NOW + tick * TICK + ahead)
            list(times.note(None, NOW + tick * TICK))
        box = Shapes.boxes([[tick, 0, 0]], [1, 1, 1])
        scene.replace('s', '', ['one'], box, stamp=NOW + tick * TICK)
        list(times.note(None, NOW + tick * TICK + 1))
    for tick in range(19):
        assert place_at(times, tick + 0.5, now=19) == tick


def test_a_copy_is_the_same_and_goes_its_own_way():
    rng, scene = np.random.default_rng(3), NodeScene(max_obstacles=60)
    names = [f'b{i}' for i in range(50)]
    boxes = Shapes.boxes(rng.uniform(-9, 9, (50, 3)), rng.uniform(0.1, 2, (50, 3)))
    speeds = rng.normal(size=(50, 3))
    scene.update('s', names, boxes, stamp=NOW, velocities=speeds)
    scene.remove('s', names[::7])
    other, asked = scene.copy(), ([-9, -9, -9], [9, 9, 9])
    for at in (None, NOW + SECOND):
        for one, two in zip(
            scene.overlap(*asked, at=at), other.overlap(*asked, at=at), strict=True
        ):
            assert one[:3] == two[:3]
            assert one.stamp == two.stamp
    other.validate()
    scene.clear()
    assert len(other) == 42
    other.update('s', names, boxes, stamp=NOW)
    other.validate()
    assert (len(scene), len(other)) == (0, 50)


BOXES = {'x': [9], 'y': [0], 'z': [0], 'sx': [1], 'sy': [1], 'sz': [1]}
LIST = {'type': Marker.CUBE_LIST}
# What brings an obstacle to (9, 0, 0), and what removes it.
REMOVALS = {
    'delete': (marker(0, (9, 0, 0)), marker(0, action=Marker.DELETE)),
    'delete all': (marker(0, (9, 0, 0)), marker(0, action=3)),
    'an empty list': (marker(0, (9, 0, 0), points=[(0, 0, 0)], **LIST), marker(0, **LIST)),
    'an empty cloud': (cloud(BOXES), cloud({name: [] for name in BOXES})),
    'by id': (cloud(BOXES | {'id': [0]}), cloud(BOXES | {'id': [0], 'sx': [np.nan]})),
}


@pytest.mark.parametrize('is_stamped', [True, False])
@pytest.mark.parametrize('kind', list(REMOVALS))
def test_what_is_removed_was_there_before(configure, kind: str, is_stamped: bool):
    """Also where another source spoke in between, so that the removal changes no newer data."""
    markers = {'type': 'MarkerArray', 'topic': '/markers'}
    each = {
        'Marker': markers,
        'PointCloud2': {'type': 'PointCloud2', 'topic': '/clouds'},
        'others': markers | {'topic': '/others'},
    }
    settings = {f'{name}.{key}': value for name, one in each.items() for key, value in one.items()}
    server = configure({'sources': [*each], 'history': 20.0, **settings})

    def hear(message, at, source=None, late=0.5):
        message.header.frame_id, message.header.stamp = 'map', stamp(round(at * SECOND))
        name = source or type(message).__name__
        told = MarkerArray(markers=[message]) if isinstance(message, Marker) else message
        (source,) = (one for one in server.world.sources if one.name == name)
        source.apply_now(serialize_message(told), round((at + late) * SECOND))

    def is_there(at):
        now, known = 110 * SECOND, server.world.times
        span = known.require(Span(round(at * SECOND)), now)
        return known.state(span.at, now).raycast((9, 0, 9), (9, 0, 0), at=span.at) is not None

    brings, removes = REMOVALS[kind]
    hear(brings, 100)
    hear(marker(1, (0, 9, 0)), 102, 'others')
    hear(removes, 104) if is_stamped else hear(removes, 0, late=104.0)
    assert server.world.scene.raycast((9, 0, 9), (9, 0, 0)) is None
    wanted = {100.0: True, 101.5: True, 102.0: True, 103.9: True, 104.0: False, 104.9: False}
    assert {at: is_there(at) for at in wanted} == wanted


def test_what_has_expired_was_there_before():
    scene = NodeScene()
    changes = LargeChanges(scene)
    times = KnownTimes(changes, 5.0, 5.0)
    box = Shapes.boxes([[0, 0, 0]], [1, 1, 1])
    scene.update('s', ['one'], box, stamp=NOW, expires=NOW + 10 * TICK)
    list(times.note(None, NOW + 1))
    assert scene.expire(NOW + 12 * TICK) == 1
    times.note_expiry(NOW + 12 * TICK)
    assert [place_at(times, tick) for tick in (0, 9)] == [0, 0]
    assert len(times.state(NOW + 12 * TICK, NOW + 100 * TICK)) == 0
    times.forget()


@pytest.mark.slow
def test_a_node_answers_about_its_past(start_node, client_of):
    tracks = {'type': 'PointCloud2', 'topic': 'tracks', 'voxel': 1.0}
    # It keeps the past, and predicts nothing.
    world = start_node({'sources': ['tracks'], 'tracks': tracks, 'history': 5.0})
    now = time.time_ns()
    client = client_of(world)
    client.wait_until_ready(PATIENCE)
    for tick in range(4):
        told = cloud({'x': [10.0 + tick], 'y': [0], 'z': [0]})
        told.header.stamp = stamp(now + (tick - 4) * SECOND)
        world.publish('tracks', told)
        world.until(
            lambda x=9.5 + tick: (hit := client.raycast((0, 0), (99, 0))) and hit.point[0] == x
        )
    way = (0, 0), (99, 0)
    for late, place in ((-4.0, 9.5), (-3.5, 9.5), (-3.0, 10.5), (-1.5, 11.5), (-0.5, 12.5)):
        at = now + round(late * SECOND)
        hit = client.raycast(*way, at=at)
        assert (hit.point[0], hit.stamp) == (place, now + int(np.floor(late)) * SECOND)
        assert client.raycast(*way, at=at, until=at).stamp == at
        assert client.overlap((9, -1), (place, 1), at=at)
        assert client.overlap((9, -1), (place - 0.01, 1), at=at) == []
    late = np.array([-4.5, -4.0, -3.5, -3.0, -1.5, -0.5, 9.0])
    origins, ways = np.zeros((7, 3)), np.tile([1.0, 0, 0], (7, 1))
    hits = client.raycast_many(origins, ways, at=now + (late * SECOND).astype(np.int64))
    assert np.flatnonzero(hits.obstacles == UNANSWERED).tolist() == [0, 6]
    assert hits.t[1:6].tolist() == [9.5, 9.5, 10.5, 11.5, 12.5]
    for at, why in ((now - 4 * SECOND - 1, 'not kept'), (now - 9 * SECOND, 'history')):
        with pytest.raises(BvhError, match=why):
            client.raycast(*way, at=at)
    world.trigger('clear')
    with pytest.raises(BvhError, match='nothing has been told'):
        client.raycast(*way, at=now - SECOND)


def test_a_time_that_is_not_known_is_named_to_the_nanosecond():
    scene = NodeScene(max_prediction=1.0)
    times = KnownTimes(LargeChanges(scene), 1.0, 1.5)
    tell(times, scene, 0.0, 0)
    with pytest.raises(ValueError, match=r'1\.000000001 s after .* max_prediction \(1 s\)'):
        times.require(Span(NOW, NOW + SECOND + 1), NOW)
    with pytest.raises(ValueError, match=r'1\.500000001 s before .* history \(1\.5 s\)'):
        times.require(Span(NOW - 3 * SECOND // 2 - 1), NOW)
