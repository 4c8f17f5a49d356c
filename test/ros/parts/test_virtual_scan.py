# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A scanner in a world of boxes against brute force, over ROS 2."""

import itertools
import math

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from ros.boxes import Boxes
from ros.clouds import table
from ros.messages import marker, write
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import LaserScan, PointCloud2

from bvh_ros.ros.conversions.query_clouds import FREE, UNANSWERED
from bvh_ros.ros.parameters import SCAN_OPTIONS, scan_settings
from bvh_ros.ros.parts import virtual_scan

BOXES = Boxes(60, seed=3)
RNG = np.random.default_rng(3)
DEFAULTS = {option.name: option.default for option in SCAN_OPTIONS}
SCAN = {'virtual_scan.pose_topic': 'scanner', 'virtual_scan.range_max': 8.0}


def settings(**given):
    return scan_settings({**DEFAULTS, **given})


def first_distances(place, directions, range_max):
    return BOXES.first_hits(place[None], directions, range_max)[1]


def pose(place, turn=(0, 0, 0, 1), frame='map'):
    stamped = PoseStamped()
    stamped.header.frame_id = frame
    write(stamped.pose.position, place)
    write(stamped.pose.orientation, turn)
    return stamped


class Scanner:
    """Moves the scanner and hears what it measures."""

    def __init__(self, world, kind):
        self.world, self.stamps = world, itertools.count(1)
        self.scans = world.heard(kind, 'virtual_scan')

    def at(self, *given, **more):
        """Return the scan of a pose, published until one comes: the first may be before the node
        has found us.
        """
        stamped = pose(*given, **more)
        stamped.header.stamp.sec = stamp = next(self.stamps)
        self.world.until(lambda: self.of(stamp) or self.world.publish('scanner', stamped))
        return self.of(stamp)[0]

    def of(self, stamp):
        return [scan for scan in self.scans if scan.header.stamp.sec == stamp]


def test_a_laser_scan_equals_brute_force(start_node):
    increment = 0.01
    more = {'virtual_scan.angle_increment': increment, 'virtual_scan.range_min': 0.5}
    world = start_node({**SCAN, **more, 'markers.required': True})
    scanner = Scanner(world, LaserScan)
    missing = scanner.at((0, 0, 0))
    assert np.isnan(missing.ranges).all()
    BOXES.fill(world)
    for _ in range(5):
        place, turn = RNG.uniform(-5, 5, 3), Rotation.random(random_state=RNG.integers(99))
        scan = scanner.at(place, turn.as_quat())
        assert scan.header.frame_id == 'laser'
        assert len(scan.ranges) == 629
        angles = scan.angle_min + np.arange(629) * scan.angle_increment
        assert angles[-1] == pytest.approx(scan.angle_max, abs=1e-6)
        local = np.column_stack((np.cos(angles), np.sin(angles), np.zeros(629)))
        distances = first_distances(place, turn.apply(local), scan.range_max)
        expected = np.where(distances < 0.5, -np.inf, distances)
        assert np.allclose(scan.ranges, expected, rtol=1e-6)
        assert np.isfinite(scan.ranges).any()
    assert np.isnan(scanner.at((0, math.nan, 0)).ranges).all()
    assert np.isnan(scanner.at((0, 0, 0), frame='mars').ranges).all()


def test_a_cloud_of_rings_sees_what_its_view_shows(start_node):
    rings = {'type': 'PointCloud2', 'channels': 4, 'elevation_min': -0.4, 'elevation_max': 0.5}
    more = {'angle_min': -1.0, 'angle_max': 1.0, 'angle_increment': 0.02, 'rate': 50.0}
    own = {f'virtual_scan.{name}': value for name, value in {**rings, **more}.items()}
    views = {'views': ['lidar'], 'lidar.exclude': ['robot/*'], 'virtual_scan.view': 'lidar'}
    world = start_node({**SCAN, **own, **views})
    BOXES.fill(world)
    world.markers(marker(1, (1, 1, 1), (3, 3, 3), ns='robot'))
    place, turn = np.array((1.0, 1.0, 1.0)), Rotation.from_euler('zyx', (0.5, 0.1, -0.2))
    scanner = Scanner(world, PointCloud2)
    world.publish('scanner', pose(place, turn.as_quat()))
    world.until(lambda: len(scanner.scans) > 3)  # of one pose, at the rate
    cloud = scanner.scans[-1]
    assert (cloud.height, cloud.width, cloud.header.frame_id) == (4, 101, 'laser')
    rows = table(cloud)
    angles, rises = -1.0 + 0.02 * np.arange(101), np.linspace(-0.4, 0.5, 4)
    local = np.array(
        [
            (math.cos(rise) * math.cos(a), math.cos(rise) * math.sin(a), math.sin(rise))
            for rise in rises
            for a in angles
        ]
    )
    expected = first_distances(place, turn.apply(local), 8.0)
    assert np.allclose(rows['t'], expected, rtol=1e-4)
    hit = np.isfinite(expected)
    assert 0.1 < hit.mean() < 1.0
    points = np.column_stack([rows[name] for name in 'xyz'])
    assert np.allclose(points[hit], expected[hit, None] * local[hit], atol=1e-3)
    assert np.isnan(points[~hit]).all()
    assert (rows['obstacle'][~hit] == FREE).all()
    assert (rows['obstacle'][hit] <= 60).all()


@pytest.mark.parametrize(
    ('obstacle', 't', 'expected'),
    [
        (FREE, math.inf, math.inf),
        (UNANSWERED, math.nan, math.nan),
        (7, 0.0, -math.inf),
        (7, 0.49, -math.inf),
        (7, 0.5, 0.5),
        (7, 3.0, 3.0),
    ],
)
def test_ranges_as_rep_117_wants_them(obstacle, t, expected):
    measured = virtual_scan.ranges(np.array([obstacle], np.uint32), np.array([t]), 0.5)
    assert np.array_equal(measured, [expected], equal_nan=True)


@pytest.mark.parametrize(
    ('first', 'last', 'step', 'count'),
    [(-math.pi, math.pi, math.pi / 180, 361), (0, 1, 0.1, 11), (0, 0, 1, 1), (0, 1, 0.3, 4)],
)
def test_the_directions_of_a_ring(first, last, step, count):
    pattern = virtual_scan.pattern(settings(angle_min=first, angle_max=last, angle_increment=step))
    assert len(pattern.angles) == count
    assert np.allclose(pattern.angles, first + step * np.arange(count), atol=1e-5)
    assert np.allclose(np.linalg.norm(pattern.directions, axis=1), 1.0, rtol=1e-15)
    assert not pattern.directions[:, 2].any()
