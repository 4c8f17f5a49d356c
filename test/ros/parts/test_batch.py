# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Clouds of rays over ROS 2: each row equals brute force, and what is no answer says so."""

import itertools
import math
import time
from array import array

import numpy as np
import pytest
from nav_msgs.srv import GetPlan
from ros.boxes import Boxes
from ros.clouds import cloud, table
from ros.messages import marker
from scipy.spatial.transform import Rotation

FREE, UNANSWERED = 0xFFFFFFFF, 0xFFFFFFFE
RAYS = 2000
RNG = np.random.default_rng(11)
BOXES = Boxes(300, seed=11)
NO_QUESTION = 1_000_000  # the stamp of what only looks whether somebody answers
XYZ, WAY, NORMAL = ('x', 'y', 'z'), ('dx', 'dy', 'dz'), ('nx', 'ny', 'nz')


class Asker:
    """Publishes rays and waits for the hits that have the same stamp."""

    def __init__(self, world, name='bvh'):
        from sensor_msgs.msg import PointCloud2

        self.world, self.stamps, self.replies = world, itertools.count(1), {}
        self.heard = False
        topic = f'{world.namespace}/{name}'
        self.publisher = world.node.create_publisher(PointCloud2, f'{topic}/rays', 10)
        self.subscription = world.node.create_subscription(
            PointCloud2, f'{topic}/ray_hits', self.take, 10
        )
        world.until(lambda: self.publisher.get_subscription_count() > 0)
        # The node may find this subscription later than it is found here: until then its replies
        # go to nobody.
        probe, again = cloud(rays(np.empty((0, 3)), np.empty((0, 3)))), 0.0
        probe.header.stamp.sec = NO_QUESTION

        def heard():
            nonlocal again
            if time.monotonic() > again:
                self.publisher.publish(probe)
                again = time.monotonic() + 0.5
            return self.heard

        world.until(heard)

    def take(self, reply):
        if reply.header.stamp.sec == NO_QUESTION:
            self.heard, self.first = True, reply
        else:
            self.replies[reply.header.stamp.sec] = reply

    def ask(self, cloud, frame=''):
        cloud.header.stamp.sec = stamp = next(self.stamps)
        cloud.header.frame_id = frame
        self.publisher.publish(cloud)
        self.world.until(lambda: stamp in self.replies)
        reply = self.replies.pop(stamp)
        assert reply.header == cloud.header
        return reply


def rays(origins, directions, **more):
    columns = (*np.transpose(origins), *np.transpose(directions))
    return {**dict(zip((*XYZ, *WAY), columns, strict=True)), **more}


def stacked(rows, names):
    return np.column_stack([rows[name] for name in names]).astype(np.float64)


@pytest.fixture(scope='module')
def asker(world):
    BOXES.fill(world)
    asker = Asker(world)
    assert asker.first.width == 0  # no rays, no hits
    return asker


def random_rays(count=RAYS):
    directions = RNG.normal(size=(count, 3))
    return RNG.uniform(-12, 12, (count, 3)), directions


def check(reply, origins, directions, t_max=math.inf, tolerance=1e-9):
    """Compare a reply with brute force; node handles are 1 + the number of the box."""
    rows = table(reply)
    assert rows.dtype.names == (*XYZ, 't', *NORMAL, 'obstacle')
    box, t = BOXES.first_hits(origins, directions, t_max)
    assert np.array_equal(rows['obstacle'].astype(np.int64), np.where(box < 0, FREE, box + 1))
    hit = box >= 0
    assert 0.2 < hit.mean() < 0.9  # a comparison worth its name
    assert np.allclose(rows['t'][hit], t[hit], rtol=tolerance, atol=0)
    assert np.isposinf(rows['t'][~hit]).all()
    points, normals = stacked(rows, XYZ), stacked(rows, NORMAL)
    expected = origins[hit] + t[hit, None] * directions[hit]
    assert np.allclose(points[hit], expected, rtol=0, atol=tolerance * 100)
    assert np.isnan(points[~hit]).all()
    assert not normals[~hit].any()
    entered = hit & (t > 0)
    assert (np.abs(normals[entered]).sum(axis=1) == 1).all()
    assert ((normals * directions).sum(axis=1)[entered] < 0).all()
    assert not normals[hit & (t == 0)].any()
    faces = np.where(normals[entered] < 0, BOXES.lo[box[entered]], BOXES.hi[box[entered]])
    on_face = np.where(normals[entered] != 0, points[entered] - faces, 0.0)
    assert np.abs(on_face).max() <= (0.0 if tolerance < 1e-8 else 1e-6)


def test_every_row_equals_brute_force(asker):
    origins, directions = random_rays()
    reply = asker.ask(cloud(rays(origins, directions)))
    assert {field.datatype for field in reply.fields[:-1]} == {8}
    check(reply, origins, directions)


def test_float32_rays_get_float32_hits(asker):
    origins, directions = (column.astype(np.float32) for column in random_rays())
    reply = asker.ask(cloud(rays(origins, directions), kind='f4'))
    assert {field.datatype for field in reply.fields[:-1]} == {7}
    check(reply, origins.astype(np.float64), directions.astype(np.float64), tolerance=2.0**-23)


@pytest.mark.parametrize('big', [False, True])
@pytest.mark.parametrize(('padding', 'row_padding', 'height'), [(0, 0, 1), (5, 11, 4)])
def test_every_layout(asker, big, padding, row_padding, height):
    origins, directions = random_rays()
    t_max = RNG.uniform(0, 30, RAYS).astype(np.float32)
    columns = {'intensity': np.zeros(RAYS), **rays(origins, directions, t_max=t_max)}
    layout = {'big': big, 'padding': padding, 'row_padding': row_padding, 'height': height}
    reply = asker.ask(cloud(columns, kinds={'t_max': 'f4', 'intensity': 'i4'}, **layout))
    assert (reply.height, reply.width) == (height, RAYS // height)
    check(reply, origins, directions, t_max)


def test_a_zero_direction_asks_for_a_point(asker):
    origins = np.vstack((BOXES.centre[:50], np.full((1, 3), 99.0)))
    rows = table(asker.ask(cloud(rays(origins, np.zeros((51, 3))))))
    inside = (origins[:, None] >= BOXES.lo) & (origins[:, None] <= BOXES.hi)
    holds = inside.all(axis=2)
    expected = np.where(holds.any(axis=1), holds.argmax(axis=1) + 1, FREE)
    assert np.array_equal(rows['obstacle'], expected)
    assert (rows['t'][:-1] == 0).all()


def test_a_mask_of_no_bits_sees_nothing(asker):
    origins, directions = random_rays(100)
    seen = np.arange(100) % 2 * 0xFFFFFFFF
    columns = rays(origins, directions, mask=seen)
    rows = table(asker.ask(cloud(columns, kinds={'mask': 'u4'})))
    box, _ = BOXES.first_hits(origins, directions)
    assert np.array_equal(rows['obstacle'], np.where((seen > 0) & (box >= 0), box + 1, FREE))


def test_bad_rows_say_so_and_the_others_are_answered(asker):
    origins, directions = random_rays()
    t_max = np.full(RAYS, np.inf)
    clean = table(asker.ask(cloud(rays(origins, directions))))
    bad = [3, 700, 701, 1500, RAYS - 1]
    origins[bad[0], 2], origins[bad[1], 0] = np.nan, np.inf
    directions[bad[2], 1], t_max[bad[3]], t_max[bad[4]] = -np.inf, np.nan, -1e-300
    rows = table(asker.ask(cloud(rays(origins, directions, t_max=t_max))))
    assert np.flatnonzero(rows['obstacle'] == UNANSWERED).tolist() == bad
    assert np.isnan(rows['t'][bad]).all()
    good = np.delete(np.arange(RAYS), bad)
    for name in rows.dtype.names:
        assert np.array_equal(rows[name][good], clean[name][good], equal_nan=True)
    asker.world.until(lambda: 'row 3: its origin is not finite' in asker.world.said())


def three():
    return cloud(rays(np.zeros((3, 3)), np.ones((3, 3)), t_max=np.ones(3)))


def lying(**given):
    cloud = three()
    for name, value in given.items():
        setattr(cloud, name, value)
    return cloud


def lacking(name):
    return lying(fields=[field for field in three().fields if field.name != name])


# What cannot be read at all; `test_point_cloud2.py` has more of it, and the fields of questions.
BAD_CLOUDS = {
    'no x': (lambda: lacking('x'), 3),
    'no dz': (lambda: lacking('dz'), 3),
    'no fields': (lambda: lying(fields=[]), 3),
    'integer direction': (
        lambda: cloud(rays(np.zeros((3, 3)), np.ones((3, 3))), kinds={'dx': 'i4'}),
        3,
    ),
    'a byte too few': (lambda: lying(data=array('B', bytes(167))), 3),
    'one row more than the data': (lambda: lying(height=2), 6),
    'width of four billion': (lambda: lying(width=2**32 - 1), 1),
    'both of four billion': (lambda: lying(width=2**32 - 1, height=2**32 - 1), 1),
    'rays without data': (lambda: lying(data=array('B')), 1),
    'data without rays': (lambda: lying(width=0), 1),
    'point_step of zero': (lambda: lying(point_step=0), 3),
}


@pytest.mark.parametrize('what', BAD_CLOUDS)
def test_a_cloud_that_cannot_be_read_never_looks_free(asker, what):
    make, count = BAD_CLOUDS[what]
    rows = table(asker.ask(make()))
    assert len(rows) == count
    assert (rows['obstacle'] == UNANSWERED).all()
    assert np.isnan(rows['t']).all()


def test_many_rays_are_answered_in_pieces_and_others_meanwhile(asker):
    world, count = asker.world, 600_000
    origins, directions = random_rays()
    pieces = np.arange(count) % RAYS
    columns = rays(origins[pieces], directions[pieces])
    bad = 30_000
    columns['dx'][bad] = np.nan
    few = cloud(rays(origins[:5], directions[:5]))
    # Both have found each other: on a busy machine that takes longer than the rays.
    reply_of = world.node.create_client(GetPlan, f'{world.name}/raycast')
    world.until(reply_of.service_is_ready)
    world.until_found()
    asker.publisher.publish(cloud(columns, kind='f4'))
    few.header.stamp.sec = 77
    asker.publisher.publish(few)
    time.sleep(0.1)
    future = reply_of.call_async(GetPlan.Request())
    world.until(future.done)
    assert not asker.replies
    world.until(lambda: {0, 77} <= asker.replies.keys())
    world.node.destroy_client(reply_of)
    assert [*asker.replies] == [0, 77]
    rows, alone = table(asker.replies.pop(0)), table(asker.replies.pop(77))
    assert (rows['obstacle'] == UNANSWERED).nonzero()[0].tolist() == [bad]
    good = np.delete(np.arange(count), bad)
    first = rows[:RAYS]
    for name in ('t', 'obstacle', *XYZ):
        np.testing.assert_array_equal(rows[name][good], first[name][pieces[good]])
    np.testing.assert_array_equal(alone['obstacle'], first['obstacle'][:5])
    reason = world.status('rays').values['last reason']
    assert reason == f'row {bad}: its direction is not finite'


def test_an_unknown_frame(asker):
    rows = table(asker.ask(three(), frame='mars'))
    assert rows['obstacle'].tolist() == [UNANSWERED] * 3
    assert table(asker.ask(three(), frame='map'))['obstacle'].tolist() != [UNANSWERED] * 3


@pytest.mark.slow
def test_an_incomplete_world(start_node):
    parameters = {'markers.required': True, 'planar': True}
    asker = Asker(start_node(parameters))
    assert table(asker.ask(three()))['obstacle'].tolist() == [UNANSWERED] * 3
    asker.world.markers(marker(7, (2, 0, 5)))
    down = cloud(rays([[0, 0, 1.5]] * 2, [[1, 0, 9], [0, 1, 0]]))
    asker.world.until(lambda: asker.world.names('raycast', (0, 0, 0), (9, 0, 0)) == ['a/7'])
    rows = table(asker.ask(down))  # from above, z says nothing
    assert rows['obstacle'].tolist() == [1, FREE]
    assert (rows['t'][0], rows['x'][0], rows['z'][0], rows['nx'][0]) == (1.5, 1.5, 1.5, -1)


def test_rays_and_hits_in_a_frame_of_their_own(start_node):
    place, turn = np.array((1.0, -2.0, 0.5)), Rotation.from_euler('xyz', (0.3, -0.8, 2.0))
    lidar = {'lidar.xyz': place.tolist(), 'lidar.xyzw': turn.as_quat().tolist()}
    world = start_node({'transforms': ['lidar'], **lidar})
    BOXES.fill(world)
    origins, directions = random_rays()
    local = turn.inv().apply(origins - place), turn.inv().apply(directions)
    reply = Asker(world).ask(cloud(rays(*local)), frame='lidar')
    rows, (box, t) = table(reply), BOXES.first_hits(origins, directions)
    assert np.array_equal(rows['obstacle'].astype(np.int64), np.where(box < 0, FREE, box + 1))
    hit = box >= 0
    assert np.allclose(rows['t'][hit], t[hit], rtol=1e-9)
    points = turn.apply(stacked(rows, XYZ)[hit]) + place
    assert np.allclose(points, origins[hit] + t[hit, None] * directions[hit], atol=1e-9)
    normals = turn.apply(stacked(rows, NORMAL)[hit & (t > 0)])
    assert np.allclose(np.sort(np.abs(normals), axis=1), (0, 0, 1), atol=1e-12)
    assert ((normals * directions[hit & (t > 0)]).sum(axis=1) < 0).all()


def test_what_was_refused_is_in_diagnostics(asker):
    asker.ask(lacking('x'))
    values = asker.world.status('rays').values
    assert 'but not x' in values['last reason']
    assert int(values['rays refused']) >= 3


def test_without_batches(start_node):
    world = start_node({'batch': False})
    topics = f'{world.namespace}/bvh/obstacles', f'{world.namespace}/bvh/rays'
    world.until(lambda: world.node.count_subscribers(topics[0]))
    world.status('world')  # up to a second later: by then the graph has told the rest
    assert world.node.count_subscribers(topics[1]) == 0
