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

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointField
from visualization_msgs.msg import MarkerArray

LATCHED = QoSProfile(depth=50, durability=DurabilityPolicy.TRANSIENT_LOCAL)
QOS = {'markers': 10, 'points': 10, 'tracks': 10, 'floor': LATCHED}
MEGABYTE = 1_000_000
NAN, INF = math.nan, math.inf
KEPT = {'good/1', 'points#0', 'points#1', 'tracks#7', 'floor#0'}


@pytest.fixture(scope='module')
def filled(start_node, messages):
    """A node with sources of all types, each of which has spoken."""
    world = start_node(
        {
            'sources': list(QOS),
            **{
                name: {'type': kind, 'topic': name}
                for name, kind in zip(
                    QOS,
                    ('MarkerArray', 'PointCloud2', 'PointCloud2', 'OccupancyGrid'),
                    strict=True,
                )
            },
        }
    )
    world.publish('markers', MarkerArray(markers=[messages.marker(1, (10, 0, 0), ns='good')]))
    world.publish('points', messages.cloud({'x': [20, 30], 'y': [0, 0], 'z': [0, 0]}))
    world.publish('tracks', messages.cloud({'x': [40], 'y': [0], 'z': [0], 'id': [7]}))
    grid = OccupancyGrid()
    grid.info.width = grid.info.height = 1
    grid.info.resolution, grid.info.origin.position.x = 1.0, 50.0
    grid.data = [100]
    world.publish('floor', grid, qos=LATCHED)
    world.until(lambda: world.everything() == KEPT)
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
    'unknown frame': {'frame': 'mars'},
    'unknown action': {'action': 1_000_000},
    'negative lifetime': {'lifetime': -1.0},
    'reserved name': {'ns': 'error: a'},
    '1 MB reserved name': {'ns': 'error: ' + 'n' * MEGABYTE},
    'NaN in a list': {'type': 6, 'points': [(0, NAN, 0)]},
}


def test_bad_markers(filled, messages):
    before, _ = refused(filled, 'markers')
    for change in BAD_MARKERS.values():
        given = {'ns': 'bad', **change}
        at, size = given.pop('at', (70, 0, 0)), given.pop('size', (1, 1, 1))
        bad = messages.marker(5, at, size, **given)
        same = messages.marker(1, (10, 0, 0), ns='good')
        new = messages.marker(2, (0, 15, 0), ns='good')
        filled.publish('markers', MarkerArray(markers=[same, bad, new]))
        filled.until(lambda: filled.everything() == KEPT | {'good/2'})
        filled.publish('markers', MarkerArray(markers=[messages.marker(2, ns='good', action=2)]))
        filled.until(lambda: filled.everything() == KEPT)
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
def test_strange_but_legal_markers(filled, messages, what):
    change, name = LEGAL_MARKERS[what]
    given = dict(change)
    number, size = given.pop('number', 5), given.pop('size', (1, 1, 1))
    filled.publish(
        'markers', MarkerArray(markers=[messages.marker(number, (0, 70, 0), size, **given)])
    )
    filled.until(lambda: filled.names('raycast', (0, 70, 9), (0, 70, -9)) == [name])
    gone = messages.marker(number, ns=given.get('ns', 'a'), action=2)
    filled.publish('markers', MarkerArray(markers=[gone]))
    filled.until(lambda: filled.everything() == KEPT)


def altered(**values):
    """A change of some attributes of a message."""

    def change(message):
        for name, value in values.items():
            setattr(message, name, value)

    return change


def field(name, offset, datatype=PointField.FLOAT64, count=1):
    return PointField(name=name, offset=offset, datatype=datatype, count=count)


XYZ = [field('x', 0), field('y', 8), field('z', 16)]
BAD_CLOUDS = {
    'width lies': altered(width=3),
    'height lies': altered(height=2),
    'row_step lies': altered(row_step=10**9),
    'a size beyond memory': altered(width=2**32 - 1, height=2**32 - 1),
    'points without data': altered(data=[]),
    'one byte short': lambda m: m.data.pop(),
    'no fields': altered(fields=[]),
    'no z': altered(fields=XYZ[:2]),
    'x twice': altered(fields=[*XYZ, XYZ[0]]),
    'unknown datatype': altered(fields=[*XYZ[:2], field('z', 16, 200)]),
    'field outside its point': altered(fields=[*XYZ[:2], field('z', 17)]),
    'an array as x': altered(fields=[field('x', 0, count=2), *XYZ[1:]]),
    'half a size': altered(fields=[*XYZ, field('sx', 0)]),
    'half an orientation': altered(fields=[*XYZ, field('qw', 0)]),
    'unknown frame': lambda m: altered(frame_id='mars')(m.header),
}


def test_bad_clouds(filled, messages):
    before, _ = refused(filled, 'points')
    for change in BAD_CLOUDS.values():
        cloud = messages.cloud({'x': [80, 90], 'y': [0, 0], 'z': [0, 0]})
        change(cloud)
        filled.publish('points', cloud)
        unharmed(filled)
    check(filled, 'points', before, len(BAD_CLOUDS), 'mars')


def test_bad_rows_of_a_cloud_do_not_spoil_the_others(filled, messages):
    before, _ = refused(filled, 'tracks')
    sizes = {'sx': [1, -1, 1, INF], 'sy': [1, 1, 1, 1], 'sz': [1, 1, 1, 1]}
    columns = {'x': [41, 42, INF, 44], 'y': [50] * 4, 'z': [0] * 4, **sizes, 'id': [8, 9, 10, 11]}
    filled.publish('tracks', messages.cloud(columns))
    filled.until(lambda: filled.everything() == KEPT | {'tracks#8'})
    filled.publish('tracks', messages.cloud({**columns, 'sx': [NAN] * 4}))  # deletes them
    filled.until(lambda: filled.everything() == KEPT)
    columns = {'x': [0, 0], 'y': [0, 0], 'z': [0, 0], 'id': [0.5, 2.0**60]}
    filled.publish('tracks', messages.cloud(columns))
    check(filled, 'tracks', before, 5, 'not a whole number')


def origin(name, **values):
    def change(grid):
        altered(**values)(getattr(grid.info.origin, name))

    return change


BAD_GRIDS = {
    'a cell too few': altered(data=[100]),
    'a cell too many': altered(data=[100] * 3),
    'no data': altered(data=[]),
    'a size beyond memory': lambda m: altered(width=2**32 - 1, height=2**32 - 1)(m.info),
    'no resolution': lambda m: altered(resolution=0.0)(m.info),
    'NaN resolution': lambda m: altered(resolution=NAN)(m.info),
    'negative resolution': lambda m: altered(resolution=-1.0)(m.info),
    'NaN origin': origin('position', y=NAN),
    'infinite origin': origin('position', x=INF),
    'NaN turn': origin('orientation', z=NAN),
    'tilted': origin('orientation', x=1.0, w=1.0),
    'unknown frame': lambda m: altered(frame_id='mars')(m.header),
}


def test_bad_grids(filled):
    before, _ = refused(filled, 'floor')
    for change in BAD_GRIDS.values():
        grid = OccupancyGrid()
        grid.info.width, grid.info.height, grid.info.resolution = 2, 1, 1.0
        grid.data = [100, 100]
        change(grid)
        filled.publish('floor', grid, qos=LATCHED)
        unharmed(filled)
    check(filled, 'floor', before, len(BAD_GRIDS), 'mars')


@pytest.mark.slow
@pytest.mark.parametrize('source', ['markers', 'points', 'floor'])
def test_bytes_that_are_no_message(filled, messages, source):
    """Random bytes and torn messages on the wire, as a broken or hostile publisher sends them."""
    rng = np.random.default_rng(1)
    whole = {
        'markers': MarkerArray(markers=[messages.marker(1, (10, 0, 0), ns='good')] * 3),
        'points': messages.cloud({'x': [20, 30], 'y': [0, 0], 'z': [0, 0]}),
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
