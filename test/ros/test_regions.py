# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Four nodes of a region each, asked as one: the answers of one node, or an error."""

import signal
import time

import numpy as np
import pytest
from ros.messages import SECOND, cloud, marker, stamp
from ros.patience import COMPILING, PATIENCE, once_compiled
from sensor_msgs.msg import PointCloud2
from turns import unit_quaternions
from visualization_msgs.msg import MarkerArray

from bvh_ros.client import FREE, UNANSWERED, BvhError, BvhTimeoutError

pytestmark = pytest.mark.slow

TOPIC, BOXES, CALLS, ROWS = '/regions/boxes', 120, 60, 400
INF = float('inf')
QUARTERS = [
    [-INF, -INF, -INF, 0.0, 0.0, INF],
    [0.0, -INF, -INF, INF, 0.0, INF],
    [-INF, 0.0, -INF, 0.0, INF, INF],
    [0.0, 0.0, -15.0, 30.0, 30.0, 25.0],  # what lies beyond is nobody's
]


@pytest.fixture(scope='module')
def nodes(start_node):
    """One that knows all, and four that share it."""
    given = {'sources': ['boxes'], 'boxes.type': 'MarkerArray', 'boxes.topic': TOPIC}
    given |= {'footprint': [0.8, 0.5, 0.4], 'nearest_limit': 4}
    whole = start_node(given)
    parts = [start_node({**given, 'region': region}) for region in QUARTERS]
    publisher = whole.node.create_publisher(MarkerArray, TOPIC, 10)
    whole.until(lambda: publisher.get_subscription_count() == 5)
    rng = np.random.default_rng(2)
    places, sizes = rng.uniform(-10, 10, (BOXES, 3)), rng.uniform(0.2, 3.0, (BOXES, 3))
    # A ring of cubes: equally far from the middle, in four regions.
    places[-4:], sizes[-4:] = [[3, 3, 20], [-3, 3, 20], [3, -3, 20], [-3, -3, 20]], 2.0
    publisher.publish(
        MarkerArray(
            # Of numbers as long as each other: the order of names is that of handles.
            markers=[marker(100 + i, places[i], sizes[i], stamp=1) for i in range(BOXES)]
        )
    )
    whole.until(lambda: len(whole.everything()) == BOXES)
    lo, hi = places - sizes / 2, places + sizes / 2
    for part, region in zip(parts, QUARTERS, strict=True):
        here = ((lo <= region[3:]) & (hi >= region[:3])).all(axis=1)
        wanted = {f'a/{100 + i}' for i in np.flatnonzero(here)}
        assert 10 < len(wanted) < BOXES
        part.until(lambda part=part, wanted=wanted: part.everything() == wanted)
    yield whole, parts
    whole.node.destroy_publisher(publisher)


def test_four_nodes_answer_as_one(nodes, client_of):
    whole, parts = nodes
    one = client_of(whole)
    all_four = client_of([part.name for part in parts])
    all_four.wait_until_ready()
    rng, hits = np.random.default_rng(9), 0
    for _ in range(CALLS):
        a, b = rng.uniform((-12, -12, -4), (12, 12, 4), (2, 3)).tolist()
        radius = float(rng.choice([0.0, 0.3]))
        assert all_four.raycast(a, b, radius) == one.raycast(a, b, radius)
        assert all_four.raycast_all(a, b, radius) == one.raycast_all(a, b, radius)
        found = all_four.overlap(a, b)
        assert found == one.overlap(a, b)
        hits += len(found)
    turned = ((-3, -1, -1), (3, 1, 1), (0.0, 0.0, 0.6, 0.8))
    assert all_four.overlap(*turned) == one.overlap(*turned)
    assert hits > CALLS


def same_rows(told, wanted, here, there):
    """Row for row the same, obstacles by their names; how many rows meet one."""
    named = [
        np.array(['' if n == FREE else names[n] for n in numbers.tolist()])
        for names, numbers in ((here, told.obstacles), (there, wanted.obstacles))
    ]
    np.testing.assert_array_equal(*named)
    for name, column in wanted._asdict().items():
        if name == 'counts':  # of two nodes nobody can tell
            known = told.counts != UNANSWERED
            np.testing.assert_array_equal(told.counts[known], column[known])
            assert (column[~known] > 0).all()
            assert known.mean() > 0.7
        elif name != 'obstacles':
            np.testing.assert_array_equal(getattr(told, name), column)
    return np.count_nonzero(told.obstacles != FREE)


def test_batches_of_four_nodes_are_those_of_one(nodes, client_of):
    whole, parts = nodes
    one = client_of(whole)
    four = client_of([part.name for part in parts])
    four.wait_until_batches_are_ready()
    rng = np.random.default_rng(4)
    at, ways = rng.uniform((-12, -12, -4), (12, 12, 4), (2, ROWS, 3))
    ways = np.where(rng.random((ROWS, 1)) < 0.5, np.rint(ways / 6), ways - at)
    at[:40] = np.rint(at[:40])  # some on the faces of regions
    at[:9] = [0, 0, 20], [0, 0, 0], [0, 5, 0], [5, 0, 0], [0, 3, 20], *rng.uniform(-9, 9, (4, 3))
    sizes, turns = rng.uniform(0, 1.5, (ROWS, 3)), unit_quaternions(rng.normal(size=(ROWS, 4)))
    turns[::2] = 0, 0, 0, 1
    t_max, radius = rng.uniform(0, 1.5, ROWS), rng.choice([0.0, 0.3], ROWS)
    reach = rng.choice([0.5, 2.0, 4.0], ROWS)
    reach[0] = 9.0
    asks = [
        lambda client: client.raycast_many(at, ways, t_max),
        lambda client: client.raycast_many(at, ways, t_max, radius=radius),
        lambda client: client.nearest_many(at, reach),
        lambda client: client.overlap_many(at, sizes, turns, radius),
        lambda client: client.check_path(at[:150], turns[:150]),
    ]
    for ask in asks:
        wanted, told = (once_compiled(lambda: ask(client)) for client in (one, four))  # noqa: B023
        here, there = four.names(told.obstacles), one.names(wanted.obstacles)
        assert same_rows(told, wanted, here, there) > 50
    once_compiled(lambda: one.nearest((0, 0, 0), 4.0))
    for point in at[:60].tolist():
        assert four.nearest(point, 4.0) == one.nearest(point, 4.0)
    ring = [hit.name for hit in four.nearest((0, 0, 20), 4.0)]
    assert ring == [f'a/{216 + i}' for i in range(4)]
    assert len(four.raycast_many(at[:0], at[:0]).obstacles) == 0
    assert len(four.nearest_many(at[:0]).obstacles) == 0
    with pytest.raises(ValueError, match='shape'):
        four.raycast_many(at, at[1:])


@pytest.fixture(scope='module')
def moving(start_node):
    """One that knows all, two that share it, and when they were told: boxes that cross the border
    between the two.
    """
    topic, count = '/regions/tracks', 60
    given = {'sources': ['tracks'], 'max_prediction': 2.0, 'footprint': [0.8, 0.5, 0.4]}
    given['tracks'] = {'type': 'PointCloud2', 'topic': topic, 'predict': 'given'}
    halves = [-INF, -INF, -INF, 0.0, INF, INF], [0.0, -INF, -INF, INF, INF, INF]
    worlds = [start_node(given), *(start_node({**given, 'region': half}) for half in halves)]
    publisher = worlds[0].node.create_publisher(PointCloud2, topic, 10)
    worlds[0].until(lambda: publisher.get_subscription_count() == 3)
    rng = np.random.default_rng(5)
    columns = [rng.uniform(*span, (count, 3)) for span in ((-8, 8), (0.3, 1.5), (-4, 4))]
    names = ('x', 'y', 'z', 'sx', 'sy', 'sz', 'vx', 'vy', 'vz')
    message = cloud(
        {'id': np.arange(100, 100 + count), **dict(zip(names, np.hstack(columns).T, strict=True))}
    )
    told = time.time_ns()
    message.header.stamp = stamp(told)
    publisher.publish(message)
    for world in worlds:
        world.until(lambda world=world: world.status('source tracks').values['messages'] == '1')
        world.until(lambda world=world: world.hits('overlap', (-9, -9, -9), (9, 9, 9)))
    yield worlds, told
    worlds[0].node.destroy_publisher(publisher)


def test_two_nodes_answer_as_one_about_other_times(moving, client_of):
    (whole, *parts), told = moving
    one = client_of(whole)
    both = client_of([part.name for part in parts])
    both.wait_until_batches_are_ready()
    rng, hits = np.random.default_rng(6), 0
    then = {'at': told + SECOND}
    for _ in range(CALLS // 2):
        a, b = rng.uniform(-9, 9, (2, 3)).tolist()
        radius = float(rng.choice([0.0, 0.3]))
        for times in ({}, then, {**then, 'until': told + 2 * SECOND}):
            asks = [
                lambda client, times=times: client.raycast(a, b, radius, **times),  # noqa: B023
                lambda client, times=times: client.raycast_all(a, b, radius, **times),  # noqa: B023
            ]
            if 'until' not in times:
                asks += [
                    lambda client, times=times: client.overlap(a, b, **times),  # noqa: B023
                    lambda client, times=times: client.nearest(a, 4.0, **times),  # noqa: B023
                ]
            for ask in asks:
                wanted = once_compiled(lambda: ask(one))  # noqa: B023
                assert once_compiled(lambda: ask(both)) == wanted  # noqa: B023
                hits += wanted not in (None, [])
    assert hits > CALLS
    at = told + rng.integers(0, SECOND, ROWS)
    places, ways = rng.uniform(-9, 9, (2, ROWS, 3))
    turns, radius = unit_quaternions(rng.normal(size=(ROWS, 4))), rng.choice([0.0, 0.3], ROWS)
    asks = [
        lambda client: client.raycast_many(places, ways, 1.0, at=at),
        lambda client: client.raycast_many(places, ways, 1.0, at=at, until=at + SECOND),
        lambda client: client.raycast_many(places, ways, 1.0, radius=radius, at=at, until=at + 9),
        lambda client: client.nearest_many(places, 4.0, at=at),
        lambda client: client.overlap_many(places, np.abs(ways) / 6, turns, radius, at=at),
        lambda client: client.check_path(places[:150], turns[:150], at=at[:150]),
    ]
    for ask in asks:
        wanted, found = (once_compiled(lambda: ask(client)) for client in (one, both))  # noqa: B023
        here, there = both.names(found.obstacles), one.names(wanted.obstacles)
        assert same_rows(found, wanted, here, there) > 25
    with pytest.raises(ValueError, match='until needs at'):
        both.raycast_many(places, ways, 1.0, until=at)
    with pytest.raises(ValueError, match='at must'):
        both.nearest_many(places, 4.0, at='x')
    with pytest.raises(BvhError, match='stamp'):
        both.raycast((0, 0, 0), (1, 0, 0), until=told)


def test_what_nobody_knows_is_not_free(nodes, client_of, monkeypatch):
    whole, parts = nodes
    names = [part.name for part in parts]
    client = client_of(names)
    for a, b in (((5, 5, 0), (5, 5, 29)), ((31, 5, 0), (32, 5, 0)), ((-5, 5, 26), (5, 5, 26))):
        with pytest.raises(BvhError, match='leaves the regions'):
            client.raycast(a, b)
    client.raycast((-5, 5, 24.9), (5, 5, 24.9))
    with pytest.raises(BvhError, match='leaves the regions'):
        client.raycast((-5, 5, 24.9), (5, 5, 24.9), 0.2)
    with pytest.raises(BvhError, match='leaves the regions'):
        client.overlap((1, 1, 1), (2, 2, 2), tolerance=24.0)
    with pytest.raises(BvhError, match='leaves the regions'):
        client.nearest((29, 29, 0), 1.5)
    rays = client.raycast_many([[9, 9, 0], [31, 5, 0], [9, 9, 24]], np.eye(3)[[2, 0, 2]], 22.0)
    assert rays.obstacles[1:].tolist() == [UNANSWERED] * 2
    assert np.isnan(rays.t[1:]).all()
    assert client.nearest_many([[29, 29, 0]] * 2, [0.5, 1.5]).obstacles.tolist() == [
        FREE,
        UNANSWERED,
    ]
    with pytest.raises(BvhError, match='no row'):
        client.raycast_many([[31, 5, 0]], [[1, 0, 0]])
    with pytest.raises(ValueError, match='a name'):
        client_of([])
    missing = client_of([*names, '/nowhere/bvh'], timeout=1.0)
    with pytest.raises(BvhTimeoutError):
        missing.raycast((0, 0, 0), (1, 1, 0))
    hasty = client_of(names)
    hasty.regions()
    # A row in each region, and one in two of them: those of the node that is killed are unknown.
    rays = (
        np.array([[-9, -9, 0], [9, -9, 0], [-9, 9, 0], [9, 9, 0], [-9, 1, 0]]),
        np.eye(3)[[2] * 4 + [0]],
    )
    boxes = rays[0] + 0.5, [1.0, 1.0, 1.0]
    alive = (
        hasty.raycast_many(*rays, 18.0),
        hasty.overlap_many(*boxes),
        hasty.nearest_many(rays[0], 1.0),
    )
    assert all((told.obstacles != UNANSWERED).all() for told in alive)
    parts[3].process.kill()
    parts[3].process.wait()
    # The first waits until it times out; the others remember that the node is silent.
    monkeypatch.setattr('bvh_ros.client.regions.SILENT', PATIENCE)
    first = hasty.raycast_many(*rays, 18.0, timeout=20.0)
    for _ in range(2):
        began = time.monotonic()
        told = (
            hasty.raycast_many(*rays, 18.0),
            hasty.overlap_many(*boxes),
            hasty.nearest_many(rays[0], 1.0),
        )
        assert time.monotonic() - began < PATIENCE
        for answer, before in zip((first, *told), (alive[0], *alive), strict=True):
            assert answer.obstacles[:3].tolist() == before.obstacles[:3].tolist()
            assert answer.obstacles[3] == UNANSWERED
            assert answer.obstacles[4] in (UNANSWERED, before.obstacles[4])
        assert np.isnan(told[0].t[3])
    with pytest.raises(BvhTimeoutError):  # no row at all can be answered
        hasty.raycast_many(rays[0][3:4], rays[1][3:4], 18.0, timeout=1.0)
    with pytest.raises(BvhTimeoutError):
        hasty.raycast((1, 1, 0), (2, 2, 0), timeout=2.0)
    with pytest.raises(BvhTimeoutError):
        hasty.overlap((-1, -1, -1), (1, 1, 1), timeout=2.0)
    assert hasty.raycast((-9, -9, 0), (-1, -1, 0)) == client_of(whole).raycast(
        (-9, -9, 0), (-1, -1, 0)
    )


def test_a_slow_node_is_an_error_and_holds_up_nobody_else(nodes, client_of):
    whole, parts = nodes
    client = client_of([part.name for part in parts[:3]])
    client.raycast((-9, -9, 0), (-1, -1, 0))
    parts[1].process.send_signal(signal.SIGSTOP)
    try:
        for ask in (client.raycast, lambda a, b, **how: client.raycast_many([a], [b], **how)):
            began = time.monotonic()
            with pytest.raises(BvhTimeoutError):
                ask((-9, -9, 0), (9, 0, 0), timeout=1.0)
            assert time.monotonic() - began < PATIENCE
        client.raycast((-9, -9, 0), (-1, -1, 0))
    finally:
        parts[1].process.send_signal(signal.SIGCONT)
    assert client.raycast((-9, -9, 0), (9, 0, 0)) == client_of(whole).raycast(
        (-9, -9, 0), (9, 0, 0)
    )


def refusal(ask):
    """Why it is not answered. Who asks a node that is gone, before another one is discovered, is
    answered by nobody.
    """
    deadline = time.monotonic() + COMPILING
    while True:
        try:
            ask()
        except BvhTimeoutError:
            assert time.monotonic() < deadline
        except BvhError as error:
            return str(error)
        else:
            raise AssertionError('this is answered')


def test_a_node_that_is_started_again_with_another_region(start_node, client_of):
    given = {'region': [-INF, -INF, -INF, 0.0, INF, INF]}
    left, right = start_node(given), start_node({'region': [0.0, -INF, -INF, INF, INF, INF]})
    client = client_of([left.name, right.name])
    a, b, rays = (-9, 0, 0), (9, 0, 0), ([[-9, 0, 0]], [[1, 0, 0]], 18.0)
    assert client.raycast(a, b) is None
    assert client.raycast_many(*rays).obstacles.tolist() == [FREE]
    right.end(signal.SIGKILL)
    again = start_node({'region': [2.0, -INF, -INF, INF, INF, INF]}, namespace=right.namespace)
    assert 'leaves the regions' in refusal(lambda: client.raycast(a, b, timeout=30.0))
    assert 'leaves the regions' in refusal(lambda: client.raycast_many(*rays, timeout=30.0))
    again.end(signal.SIGKILL)
    start_node({'region': [-1.0, -INF, -INF, INF, INF, INF]}, namespace=right.namespace)
    # That more is known is seen once the node is discovered; until then it is an error.
    assert once_compiled(lambda: client.raycast(a, b, timeout=30.0)) is None
    assert client.raycast_many(*rays).obstacles.tolist() == [FREE]
