# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Questions about other times, of obstacles whose source predicts."""

import math
import time

import numpy as np
import pytest
from ros.clouds import table
from ros.messages import SECOND, cloud, get_plan, marker, stamp
from ros.patience import PATIENCE, once_compiled
from ros.simulation import REMAP, Simulation
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from bvh_ros.client import FREE, UNANSWERED, BvhError
from bvh_ros.scene import NodeScene, Shapes

pytestmark = pytest.mark.slow

SOURCES = {
    'sources': ['tracks', 'people'],
    'tracks': {'type': 'PointCloud2', 'topic': 'tracks', 'predict': 'given', 'voxel': 1.0},
    'people': {'type': 'MarkerArray', 'topic': 'people', 'predict': 'constant_velocity'},
    'max_prediction': 2.0,
    'footprint': [0.5],
    'views': ['left'],
    'left': {'include': ['tracks#1']},
    'transforms': ['turned'],
    'turned': {'xyz': [0.0, 0.0, 5.0], 'xyzw': [0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)]},
}


@pytest.fixture(scope='module')
def moving(start_node):
    world = start_node(SOURCES)
    # The rest of the kernels, and what is nearest, which is compiled when somebody asks.
    world.until_compiled(lambda: not errors(world, 'raycast_all', (0, 0, 0), (1, 0, 0)))
    return world


@pytest.fixture
def clean(moving):
    moving.trigger('clear')
    return moving


def ask(world, name, start, goal, at=0, until=0, **given):
    """Poses of a reply to a request with these stamps, ns."""
    request = get_plan(start, goal, **given)
    request.start.header.stamp, request.goal.header.stamp = stamp(at), stamp(until)
    return world.call(name, request).plan.poses


def errors(world, *given, **more):
    """The error that a request is answered by, or an empty text."""
    poses = world.plan(*given, **more).poses if not more else ask(world, *given, **more)
    text = poses[0].header.frame_id if poses else ''
    return text if text.startswith('error: ') else ''


def when(pose):
    return pose.header.stamp.sec * SECOND + pose.header.stamp.nanosec


def tell(world, rows, at, frame='', speeds=('vx', 'vy', 'vz'), ids=True):
    """Publish boxes (id, x, y, z, vx, vy, vz), and wait until the node has them."""
    names = (*(['id'] if ids else []), 'x', 'y', 'z', *speeds)
    told = cloud(dict(zip(names, np.array(rows, float).T, strict=True)))
    told.header.stamp, told.header.frame_id = stamp(at), frame
    publish(world, 'tracks', told)


def publish(world, source, message):
    """Publish, and wait until the node has it."""
    count = heard(world, source)
    world.publish(source, message)
    world.until(lambda: heard(world, source) > count)


def heard(world, source):
    return int(world.status(f'source {source}').values['messages'])


def test_given_velocities_at_a_time_and_while_it_passes(clean):
    now = time.time_ns()
    tell(clean, [[1, 10, 0, 0, -5, 0, 0], [2, 0, 10, 0, 0, 0, 0]], now)
    way = (0, 0, 0), (20, 0, 0)
    (as_told,) = ask(clean, 'raycast', *way)
    assert as_told.header.frame_id == 'tracks#1'
    assert as_told.pose.position.x == 9.5
    assert when(as_told) == now
    (frozen,) = ask(clean, 'raycast', *way, at=now + SECOND)
    assert frozen.pose.position.x == pytest.approx(4.5)
    assert when(frozen) == now
    # 10 m/s from the origin meets it, coming with 5 m/s, after 9.5 / 15 s.
    for name in ('raycast', 'raycast_all', 'left/raycast'):
        (met,) = ask(clean, name, *way, at=now, until=now + 2 * SECOND)
        assert met.pose.position.x == pytest.approx(95 / 15)
        assert (when(met) - now) / SECOND == pytest.approx(9.5 / 15, abs=1e-6)
        (met,) = ask(clean, name, *way, at=now, until=now + 2 * SECOND, tolerance=0.25)
        assert (when(met) - now) / SECOND == pytest.approx(9.25 / 15, abs=1e-6)
    # It is gone when we come; and it comes to where it was not.
    assert ask(clean, 'raycast', (10, 0, 0), (10, 5, 0), at=now + SECOND, until=now + SECOND) == []
    assert ask(clean, 'raycast', (10, 0, 0), (10, 5, 0))
    box = (4, -1, -1), (6, 1, 1)
    assert ask(clean, 'overlap', *box) == []
    (there,) = ask(clean, 'overlap', *box, at=now + SECOND)
    assert (there.header.frame_id, when(there)) == ('tracks#1', now)
    (there,) = ask(clean, 'overlap', *box, at=now + SECOND, until=now + SECOND)
    point = (0, 0, 0), (0, 0, 0)
    clean.until_compiled(lambda: not errors(clean, 'nearest', *point, at=now + 1))
    near = ask(clean, 'nearest', *point, at=now + SECOND)
    assert [pose.header.frame_id for pose in near] == ['tracks#1', 'tracks#2']
    assert near[0].pose.position.x == pytest.approx(4.5)


def test_times_that_are_not_known(clean):
    way = (0, 0, 0), (20, 0, 0)
    now = time.time_ns()
    assert 'nothing has been told' in errors(clean, 'raycast', *way, at=now)
    assert ask(clean, 'raycast', *way) == []
    tell(clean, [[1, 10, 0, 0, -5, 0, 0]], now)
    for name in ('raycast', 'raycast_all', 'overlap', 'nearest', 'left/raycast'):
        for given, reason in (
            ({'at': now - 1_000_000}, '0.001 s before the newest'),
            ({'at': 1}, 'before the newest'),
            ({'at': now + 2 * SECOND + 1}, 'max_prediction'),
            ({'at': (1 << 31) * SECOND - 1}, 'max_prediction'),
            ({'until': now}, 'goal has a stamp, and start has none'),
            ({'at': now + 2, 'until': now + 1}, 'before start'),
        ):
            assert reason in errors(clean, name, *way, **given), (name, given)
    moving = {'at': now, 'until': now + 2 * SECOND + 1}
    assert 'max_prediction' in errors(clean, 'raycast', *way, **moving)
    assert 'one time' in errors(clean, 'overlap', *way, at=now, until=now + 1)
    assert 'one time' in errors(clean, 'nearest', *way, at=now, until=now + 1)
    assert not errors(clean, 'raycast', *way, at=now, until=now + 2 * SECOND)


def test_what_clouds_are_refused_and_frames(clean):
    now = time.time_ns()
    tell(clean, [[1, 10, 0, 0, -5, 0, 0], [2, 0, 0, 0, 1, 1, 1]], now)
    nan, inf = math.nan, math.inf
    tell(clean, [[1, 20, 0, 0, nan, 0, 0], [2, 1, 0, 0, 0, inf, 0]], now + 1)
    assert 'velocity is not finite' in clean.status('source tracks').values['last reason']
    assert ask(clean, 'raycast', (5, 0, 0), (30, 0, 0))[0].pose.position.x == 9.5
    tell(clean, [[1, 20, 0, 0]], now + 1, speeds=())
    assert 'no fields vx, vy, vz' in clean.status('source tracks').values['last reason']
    tell(clean, [[1, 20, 0, 0, 1]], now + 1, speeds=('vy',))
    assert 'not vx, vz' in clean.status('source tracks').values['last reason']
    tell(clean, [[1, 20, 0, 0, 0, 0, 0]], now + 3600 * SECOND)
    assert 'future' in clean.status('source tracks').values['last reason']
    # Nor is it believed that one is gone: without a size.
    columns = dict.fromkeys(('x', 'y', 'z', 'vx', 'vy', 'vz'), np.zeros(1))
    sizes = dict.fromkeys(('sx', 'sy', 'sz'), np.full(1, nan))
    gone = cloud({'id': np.ones(1), **columns, **sizes})
    gone.header.stamp = stamp(now + 3600 * SECOND)
    publish(clean, 'tracks', gone)
    assert ask(clean, 'raycast', (5, 0, 0), (30, 0, 0))[0].pose.position.x == 9.5
    gone.header.stamp = stamp(now)
    clean.publish('tracks', gone)
    clean.until(lambda: not ask(clean, 'raycast', (5, 0, 0), (30, 0, 0)))
    # +x of the other frame is +y of the node's.
    tell(clean, [[3, 1, 0, 0, 2, 0, 0]], now, frame='turned')
    (told,) = ask(clean, 'raycast', (0, -5, 5), (0, 9, 5))
    assert told.pose.position.y == pytest.approx(0.5)
    (then,) = ask(clean, 'raycast', (0, -5, 5), (0, 9, 5), at=now + SECOND)
    assert then.pose.position.y == pytest.approx(2.5)
    # As fast as doubles go, and told long ago: it stays where it is predicted last.
    tell(clean, [[4, 0, 0, 50, 1e300, 0, 0], [5, 0, 0, 60, 1, 0, 0]], SECOND)
    (slow,) = ask(clean, 'raycast', (-5, 0, 60), (9, 0, 60), at=now + SECOND)
    assert slow.pose.position.x == pytest.approx(1.5)
    assert ask(clean, 'raycast', (-5, 0, 50), (9, 0, 50), at=now + SECOND) == []
    # Rows without ids, and none at all.
    tell(clean, [[0, 0, 70, 1, 0, 0]], now, ids=False)
    assert clean.everything() == {'tracks#0'}


def markers(world, places, at):
    array = [marker(k, place, ns='p') for k, place in places.items()]
    for one in array:
        one.header.stamp = stamp(at)
    publish(world, 'people', MarkerArray(markers=array))


def test_velocities_of_successive_updates(clean):
    began = time.time_ns() - 2 * SECOND
    tick = SECOND // 10
    for k in range(6):
        now = began + k * tick
        markers(clean, {0: (0.3 * k, 0, 0), 1: (0, 5 if k < 5 else 900, 0)}, now)
    (met,) = ask(clean, 'raycast', (-9, 0, 0), (9, 0, 0), at=now + SECOND)
    assert met.pose.position.x == pytest.approx(1.5 + 3.0 - 0.5, abs=1e-6)
    (jumped,) = ask(clean, 'raycast', (0, 800, 0), (0, 999, 0), at=now + SECOND)
    assert jumped.pose.position.y == 899.5
    (met,) = ask(clean, 'raycast', (-9, 0, 0), (9, 0, 0))
    assert met.pose.position.x == 1.0


def test_rays_with_times_meet_as_brute_force_says(clean):
    rng, count, now = np.random.default_rng(5), 400, time.time_ns()
    places, speeds = rng.uniform(-9, 9, (40, 3)), rng.uniform(-4, 4, (40, 3))
    tell(clean, np.column_stack((np.arange(40), places, speeds)), now)
    origins, ways = rng.uniform(-9, 9, (count, 3)), rng.normal(size=(count, 3)) * 3
    since, durations = rng.uniform(0, 0.9, count), rng.uniform(0, 1.0, count)
    limits = rng.uniform(0.5, 4.0, count)
    durations[::3] = 0.0
    since[5], since[6], since[7], durations[8] = -0.1, np.nan, 1.5, -1.0
    durations[7], durations[9], limits[10] = 0.6, np.inf, np.inf
    durations[10], since[11], limits[12] = 0.5, 1e300, np.inf
    bad = [5, 6, 7, 8, 9, 10, 11]
    columns = dict(zip(('x', 'y', 'z'), origins.T, strict=True))
    columns |= dict(zip(('dx', 'dy', 'dz'), ways.T, strict=True))
    asked = cloud(columns | {'t_max': limits, 't0': since, 'duration': durations})
    asked.header.stamp = stamp(now)
    got = clean.heard(PointCloud2, 'ray_hits')
    clean.until(lambda: clean.node.count_publishers(f'{clean.name}/ray_hits'))

    def answered():
        clean.publish('bvh/rays', asked)
        clean.executor.spin_once(0.5)
        return got

    clean.until(answered)
    assert got[0].header == asked.header
    rows = table(got[0])
    assert np.flatnonzero(rows['obstacle'] == UNANSWERED).tolist() == bad
    assert np.isnan(rows['t'][bad]).all()
    for row in range(count):
        if row not in bad:
            pace = durations[row] / limits[row] if durations[row] else 0.0
            lo = places + speeds * since[row] - 0.5 - origins[row]
            way = ways[row] - speeds * pace
            one, other = lo / way, (lo + 1.0) / way
            enter = np.minimum(one, other).max(axis=1).clip(0.0)
            leave = np.minimum(np.maximum(one, other).min(axis=1), limits[row])
            wanted = np.where(enter <= leave, enter, np.inf).min()
            assert rows['t'][row] == pytest.approx(wanted, abs=1e-6), row
            assert (rows['obstacle'][row] == FREE) == np.isinf(wanted)
    assert np.count_nonzero(np.isfinite(rows['t'])) > 20


def gaps(points, places):
    """Of n points, each from all cubes of 1 m at (n, m) places."""
    return np.linalg.norm(np.maximum(np.abs(points[:, None] - places) - 0.5, 0.0), axis=2)


def test_points_boxes_and_paths_are_about_their_times(clean, client_of):
    client = client_of(clean)
    rng, count, now = np.random.default_rng(6), 60, time.time_ns()
    places, speeds = rng.uniform(-9, 9, (30, 3)), rng.uniform(-4, 4, (30, 3))
    tell(clean, np.column_stack((np.arange(30), places, speeds)), now)
    points = rng.uniform(-9, 9, (count, 3))
    at = now + rng.integers(0, 2 * SECOND, count)
    at[3], at[4] = now - 1, now + 3 * SECOND
    bad, good = [3, 4], np.delete(np.arange(count), [3, 4])
    since = ((at - now) / SECOND)[:, None, None]
    apart = gaps(points, places + speeds * since)

    near = once_compiled(lambda: client.nearest_many(points, at=at))
    assert np.flatnonzero(near.obstacles == UNANSWERED).tolist() == bad
    np.testing.assert_allclose(near.distances[good], apart.min(axis=1)[good], atol=1e-6)
    met = once_compiled(lambda: client.overlap_many(points, [0.0] * 3, tolerance=1.5, at=at))
    assert np.flatnonzero(met.obstacles == UNANSWERED).tolist() == bad
    assert met.counts[good].tolist() == (apart <= 1.5).sum(axis=1)[good].tolist()
    at[5:9] = 0  # now, as it was told
    apart[5:9] = gaps(points[5:9], places[None])
    told = once_compiled(lambda: client.check_path(points, at=at))
    assert np.flatnonzero(told.obstacles == UNANSWERED).tolist() == bad
    apart = apart.min(axis=1) - 0.5
    outside = good[apart[good] > 0.0]
    assert len(outside) > 20
    np.testing.assert_allclose(told.distances[outside], apart[outside], atol=1e-6)
    assert (told.distances[good][apart[good] <= 0.0] <= 0.0).all()
    still = client.check_path(points[good])  # without stamps: now
    np.testing.assert_allclose(still.distances[3:7], told.distances[5:9])
    for ask in (client.nearest_many, client.check_path):
        with pytest.raises(BvhError):
            ask(points[:2], at=now + 9 * SECOND)
        for wrong in (math.inf, [now], 'x'):
            with pytest.raises(ValueError, match='at must'):
                ask(points[:2], at=wrong)
    with pytest.raises(ValueError, match='a stamp can hold'):
        client.check_path(points[:2], at=-1)


def test_the_client_asks_about_times(clean, client_of):
    client = client_of(clean)
    client.wait_until_ready(PATIENCE)
    now = time.time_ns()
    tell(clean, [[1, 10, 0, 0, -5, 0, 0]], now)
    ends = (0, 0, 0), (20, 0, 0)
    assert client.raycast(*ends).point[0] == 9.5
    assert client.raycast(*ends, at=now + SECOND).point[0] == pytest.approx(4.5)
    hit = client.raycast(*ends, at=now, until=now + 2 * SECOND)
    assert (hit.stamp - now) / SECOND == pytest.approx(9.5 / 15, abs=1e-6)
    assert client.raycast_all(*ends, at=now, until=now + 2 * SECOND) == [hit]
    assert client.overlap((4, -1, -1), (6, 1, 1), at=now + SECOND)[0].name == 'tracks#1'
    near = once_compiled(lambda: client.nearest((0, 0, 0), at=now + SECOND))
    assert near[0].point[0] == pytest.approx(4.5)
    with pytest.raises(BvhError, match='max_prediction'):
        client.raycast(*ends, at=now + 3 * SECOND)
    with pytest.raises(BvhError, match='start has none'):
        client.raycast(*ends, until=now)
    for wrong in (-1, 0, (1 << 31) * SECOND, 0.0, math.nan):
        with pytest.raises(ValueError, match='at must be'):
            client.raycast(*ends, at=wrong)
    starts, ways = np.zeros((3, 3)), np.full((3, 3), [20.0, 0, 0])
    hits = client.raycast_many(starts, ways, 1.0, at=[now, now + SECOND, now + 9 * SECOND])
    assert hits.t[:2].tolist() == pytest.approx([9.5 / 20, 4.5 / 20])
    assert hits.obstacles[2] == UNANSWERED
    hits = client.raycast_many(
        starts, ways, 1.0, at=now, until=[now, now + 2 * SECOND, now + 9 * SECOND]
    )
    assert hits.t[:2].tolist() == pytest.approx([9.5 / 20, 9.5 / 30], abs=1e-6)
    assert hits.obstacles[2] == UNANSWERED
    for wrong in ({'until': now}, {'at': math.inf}, {'at': now, 'until': now - 1}, {'at': [now]}):
        with pytest.raises(ValueError, match=r'at|until'):
            client.raycast_many(starts, ways, 1.0, **wrong)
    with pytest.raises(ValueError, match='t_max'):
        client.raycast_many(starts, ways, at=now, until=now + SECOND)
    assert client.raycast_many_async(starts, ways, 1.0, at=now) is not None


def test_a_node_of_which_no_source_predicts_does_not_look_at_stamps(start_node, client_of):
    world = start_node({'markers': {'predict': 'none'}})
    world.show(marker(1, (5, 0, 0)))
    way = (0, 0, 0), (9, 0, 0)
    for given in ({'at': 1}, {'until': 1}, {'at': 5, 'until': 1}, {'at': time.time_ns()}):
        for name in ('raycast', 'raycast_all', 'overlap'):
            (pose,) = ask(world, name, *way, **given)
            assert pose.header.frame_id == 'a/1'
            assert when(pose) > SECOND
    client = client_of(world)
    client.wait_until_ready(PATIENCE)
    with pytest.raises(BvhError, match='cannot answer'):
        client.raycast_many(np.zeros((1, 3)), np.ones((1, 3)), at=time.time_ns())
    assert 'other times than now' in world.status('world').values['off']


def test_times_are_on_where_a_source_predicts(configure):
    server = configure({'markers.predict': 'constant_velocity', 'markers.max_speed': 3})
    assert server.world.times is not None
    assert configure({}).world.times is None


def test_a_clock_that_is_set_back(start_node):
    world = start_node({**SOURCES, 'use_sim_time': True, 'history': 2.0}, remap=REMAP)
    world.until_compiled(lambda: not errors(world, 'raycast_all', (0, 0, 0), (1, 0, 0)))
    clock = Simulation(world)
    way = (-99, 0, 0), (99, 0, 0)

    clock.at(100.0)
    tell(world, [[1, 0, 0, 0, 4, 0, 0]], 100 * SECOND)
    clock.at(101.0)
    tell(world, [[1, 4, 0, 0, 4, 0, 0]], 101 * SECOND)
    for at, place in ((100.5, 1.5), (101.0, 3.5), (102.0, 7.5)):
        (hit,) = ask(world, 'raycast', *way, at=round(at * SECOND))
        assert hit.pose.position.x == pytest.approx(place)
    tell(world, [[1, 9, 0, 0, 4, 0, 0]], 104 * SECOND)  # ahead of the clock
    assert ask(world, 'raycast', *way)[0].pose.position.x == 3.5
    clock.at(10.0)  # a simulation starts over: all stand until they are told again
    assert ask(world, 'raycast', *way)[0].pose.position.x == 3.5
    assert ask(world, 'raycast', *way, at=11 * SECOND)[0].pose.position.x == 3.5
    assert errors(world, 'raycast', *way, at=9 * SECOND)
    assert 'max_prediction' in errors(world, 'raycast', *way, at=101 * SECOND)
    tell(world, [[1, 0, 0, 0, 4, 0, 0]], 10 * SECOND)
    assert ask(world, 'raycast', *way, at=11 * SECOND)[0].pose.position.x == pytest.approx(3.5)
    clock.destroy()


def test_a_client_asks_old_data_to_the_nanosecond(clean, client_of):
    then = time.time_ns() - 25 * 365 * 86_400 * SECOND  # 25 years before the client's clock
    speed, rays = [1.3, 0.0, 0.0], ([[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]], 100.0)
    tell(clean, [[0, 5, 0, 0, *speed]], then)
    scene, client = NodeScene(), client_of(clean)
    shapes = Shapes.boxes([[5, 0, 0]], [1, 1, 1])
    scene.update('tracks', ['0'], shapes, stamp=then, velocities=[speed])
    for later in (0, 123_456_789, 876_543_211):
        hits, wanted = (
            ask(*rays, at=then + later) for ask in (client.raycast_many, scene.raycast_many)
        )
        assert hits.t.tolist() == wanted.t.tolist()
