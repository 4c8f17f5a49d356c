# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages that cannot be used: nothing crashes, nothing good is lost, each refusal is explained.

Every case is published to one running node that holds good obstacles from each source, with more
good ones in the same message where a message has parts. Then the good ones answer, and the
diagnostics of the source have counted every refusal and tell why the last one was.
"""

import math

import numpy as np
import pytest
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from ros.messages import cloud, grid, marker
from visualization_msgs.msg import MarkerArray

LATCHED = QoSProfile(depth=50, durability=DurabilityPolicy.TRANSIENT_LOCAL)
QOS = {'markers': 10, 'points': 10, 'tracks': 10, 'floor': LATCHED}
MEGABYTE = 1_000_000
NAN, INF = math.nan, math.inf
KEPT = {'good/1', 'points#0', 'points#1', 'tracks#7', 'floor#0'}


@pytest.fixture(scope='module')
def filled(start_node):
    """A node with sources of all types, each of which has spoken."""
    kinds = 'MarkerArray', 'PointCloud2', 'PointCloud2', 'OccupancyGrid'
    sources = {n: {'type': kind, 'topic': n} for n, kind in zip(QOS, kinds, strict=True)}
    world = start_node({'sources': list(QOS), **sources})
    world.publish('markers', MarkerArray(markers=[marker(1, (10, 0, 0), ns='good')]))
    world.publish('points', cloud({'x': [20, 30], 'y': [0, 0], 'z': [0, 0]}))
    world.publish('tracks', cloud({'x': [40], 'y': [0], 'z': [0], 'id': [7]}))
    floor = grid([[100]])
    floor.info.origin.position.x = 50.0
    world.publish('floor', floor, qos=LATCHED)
    world.holds(*KEPT)
    return world


def unharmed(world):
    """The good obstacles answer."""
    assert world.process.poll() is None
    assert world.everything() == KEPT
    hits = world.names('raycast_all', (0, 0, 0), (60, 0, 0))
    assert hits == ['good/1', 'points#0', 'points#1', 'tracks#7', 'floor#0']
    assert 'Traceback' not in world.said()


def refused(world, source):
    """How many refusals the diagnostics count, and the last reason."""
    values = world.status(f'source {source}').values
    return int(values['refused']), values['last reason']


def check(world, source, before, count, reason):
    """So many more were refused, the last for this reason, and nothing else happened."""
    world.until(lambda: refused(world, source)[0] >= before + count)
    unharmed(world)
    total, last = refused(world, source)
    assert total == before + count
    assert reason in last


# How a marker differs from a good one; the last one's reason is looked at.
BAD_MARKERS = {
    **{
        f'type {number}': {'type': number}
        for number in (0, 4, 5, 8, 9, 10, 12, 13, 99, -1, 2**31 - 1, -(2**31))
    },
    'NaN place': {'at': (NAN, 0, 0)},
    'infinite place': {'at': (0, -INF, 0)},
    'NaN size': {'size': (1, 1, NAN)},
    'infinite size': {'size': (INF, 1, 1)},
    'negative size': {'size': (1, -1e-300, 1)},
    'NaN orientation': {'turn': (0, NAN, 0, 1)},
    'infinite orientation': {'turn': (0, 0, INF, 1)},
    'quaternion not normalised': {'turn': (0, 0, 1, 1)},
    'huge quaternion': {'turn': (0, 0, 0, 1e200)},
    'too large': {'at': (1.7e308, 0, 0), 'size': (1e308, 1, 1)},
    'not round': {'type': 2, 'size': (1, 2, 1)},
    'nor is this': {'type': 3, 'size': (1, 2, 1)},
    'unknown frame': {'frame': 'mars'},
    'unknown action': {'action': 1_000_000},
    'negative lifetime': {'lifetime': -1.0},
    'reserved name': {'ns': 'error: a'},
    '1 MB reserved name': {'ns': 'error: ' + 'n' * MEGABYTE},
    'NaN in a list': {'type': 6, 'points': [(0, NAN, 0)]},
}


def test_bad_markers(filled):
    before, _ = refused(filled, 'markers')
    for change in BAD_MARKERS.values():
        given = {'ns': 'bad', **change}
        at, size = given.pop('at', (70, 0, 0)), given.pop('size', (1, 1, 1))
        bad = marker(5, at, size, **given)
        same = marker(1, (10, 0, 0), ns='good')
        new = marker(2, (0, 15, 0), ns='good')
        filled.publish('markers', MarkerArray(markers=[same, bad, new]))
        filled.holds(*KEPT, 'good/2')
        filled.publish('markers', MarkerArray(markers=[marker(2, ns='good', action=2)]))
        filled.holds(*KEPT)
    check(filled, 'markers', before, len(BAD_MARKERS), 'finite')


LEGAL_MARKERS = {
    'zero size': ({'size': (0, 0, 0)}, 'a/5'),
    'zero quaternion': ({'turn': (0, 0, 0, 0)}, 'a/5'),
    'quaternion nearly normalised': ({'turn': (0, 0, 0.7, 0.71)}, 'a/5'),
    'largest id': ({'number': 2**31 - 1}, 'a/2147483647'),
    'smallest id': ({'number': -(2**31)}, 'a/-2147483648'),
    'empty namespace': ({'ns': ''}, '/5'),
    '1 MB namespace': ({'ns': 'n' * MEGABYTE}, 'n' * MEGABYTE + '/5'),
    'not ASCII': ({'ns': 'Gabelstapler übergroß 叉车'}, 'Gabelstapler übergroß 叉车/5'),
}


@pytest.mark.parametrize('what', LEGAL_MARKERS)
def test_strange_but_legal_markers(filled, what):
    change, name = LEGAL_MARKERS[what]
    given = dict(change)
    number, size = given.pop('number', 5), given.pop('size', (1, 1, 1))
    filled.publish('markers', MarkerArray(markers=[marker(number, (0, 70, 0), size, **given)]))
    filled.until(lambda: filled.names('raycast', (0, 70, 9), (0, 70, -9)) == [name])
    gone = marker(number, ns=given.get('ns', 'a'), action=2)
    filled.publish('markers', MarkerArray(markers=[gone]))
    filled.holds(*KEPT)


def altered(**values):
    """A change of some attributes of a message."""

    def change(message):
        for name, value in values.items():
            setattr(message, name, value)

    return change


# How a cloud differs from a good one; `test_point_cloud2.py` has all that can contradict itself.
BAD_CLOUDS = {
    'width lies': altered(width=3),
    'a size beyond memory': altered(width=2**32 - 1, height=2**32 - 1),
    'no fields': altered(fields=[]),
    'unknown frame': lambda m: altered(frame_id='mars')(m.header),
}


def test_bad_clouds(filled):
    before, _ = refused(filled, 'points')
    for change in BAD_CLOUDS.values():
        points = cloud({'x': [80, 90], 'y': [0, 0], 'z': [0, 0]})
        change(points)
        filled.publish('points', points)
        unharmed(filled)
    check(filled, 'points', before, len(BAD_CLOUDS), 'mars')


def test_bad_rows_of_a_cloud_do_not_spoil_the_others(filled):
    before, _ = refused(filled, 'tracks')
    sizes = {'sx': [1, -1, 1, INF], 'sy': [1, 1, 1, 1], 'sz': [1, 1, 1, 1]}
    columns = {'x': [41, 42, INF, 44], 'y': [50] * 4, 'z': [0] * 4, **sizes, 'id': [8, 9, 10, 11]}
    filled.publish('tracks', cloud(columns))
    filled.holds(*KEPT, 'tracks#8')
    filled.publish('tracks', cloud({**columns, 'sx': [NAN] * 4}))  # deletes them
    filled.holds(*KEPT)
    columns = {'x': [0, 0], 'y': [0, 0], 'z': [0, 0], 'id': [0.5, 2.0**60]}
    filled.publish('tracks', cloud(columns))
    check(filled, 'tracks', before, 5, 'not a whole number')


# As `test_occupancy_grid.py` has them, but for the first and the last.
BAD_GRIDS = {
    'a size beyond memory': lambda m: altered(width=2**32 - 1, height=2**32 - 1)(m.info),
    'no data': altered(data=[]),
    'NaN origin': lambda m: altered(y=NAN)(m.info.origin.position),
    'unknown frame': lambda m: altered(frame_id='mars')(m.header),
}


def test_bad_grids(filled):
    before, _ = refused(filled, 'floor')
    for change in BAD_GRIDS.values():
        floor = grid([[100, 100]])
        change(floor)
        filled.publish('floor', floor, qos=LATCHED)
        unharmed(filled)
    check(filled, 'floor', before, len(BAD_GRIDS), 'mars')


@pytest.mark.slow
@pytest.mark.parametrize('source', ['markers', 'points', 'floor'])
def test_bytes_that_are_no_message(filled, source):
    """Random bytes and torn messages on the wire, as a broken or hostile publisher sends them."""
    rng = np.random.default_rng(1)
    whole = {
        'markers': MarkerArray(markers=[marker(1, (10, 0, 0), ns='good')] * 3),
        'points': cloud({'x': [20, 30], 'y': [0, 0], 'z': [0, 0]}),
        'floor': OccupancyGrid(data=[100] * 50),
    }[source]
    right = bytes(serialize_message(whole))
    before, _ = refused(filled, source)
    publisher = filled.publishers[source]
    broken = [rng.bytes(length) for length in (4, 5, 8, 12, 100, 10_000)]
    broken += [right[:cut] for cut in rng.integers(4, len(right) - 4, 20).tolist()]
    for data in broken:
        publisher.publish(data)
        unharmed(filled)
    check(filled, source, before, len(broken), '')
    filled.publish(source, whole)
    filled.until(lambda: int(filled.status(f'source {source}').values['messages']) > 0)
    unharmed(filled)
