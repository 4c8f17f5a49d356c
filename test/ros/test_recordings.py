# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded traffic, planning scenes, a building and a map, through the node."""

import csv
import itertools
import os
from collections import defaultdict

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile

pytestmark = pytest.mark.slow

DELETE, DELETE_ALL, CYLINDER = 2, 3, 3
FIELDS = ('x', 'y', 'z', 'sx', 'sy', 'sz')
SPARSE = 1 if os.environ.get('BVH_ROS_LONG_TESTS') else 5  # of ten thousand free voxels
CLEAR = 1e-6  # m: closer than this to touching, two libraries may differ in rounding


def rows_of(path):
    with path.open(newline='') as file:
        return list(csv.DictReader(file))


def numbers(row, *names):
    return tuple(float(row[name]) for name in names)


def axes_of(q):
    """Rows: the directions of a box's own axes."""
    x, y, z, w = np.asarray(q) / np.linalg.norm(q)
    return np.array(
        (
            (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)),
            (2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)),
            (2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)),
        )
    )


class Vehicle:
    """One row of a track file, and the ray against it by brute force, in its own frame."""

    def __init__(self, row):
        self.number = int(row['id'])
        self.name = f'car/{self.number}'
        self.at = np.array(numbers(row, 'cx', 'cy', 'cz'))
        self.size = np.array(numbers(row, 'sx', 'sy', 'sz'))
        self.turn = numbers(row, 'qx', 'qy', 'qz', 'qw')
        self.axes = axes_of(self.turn)

    def entry(self, start, goal):
        """Where on the segment (0 to 1) this vehicle is met, or None."""
        origin, way = self.axes @ (start - self.at), self.axes @ (goal - start)
        low, high = 0.0, 1.0
        for o, w, half in zip(origin, way, self.size / 2, strict=True):
            if abs(w) < 1e-15:
                if abs(o) > half:
                    return None
                continue
            first, last = sorted(((-half - o) / w, (half - o) / w))
            low, high = max(low, first), min(high, last)
        return low if low <= high else None


def test_us101_replay(world, messages, shared_data):
    """At every frame the tree holds exactly that frame's vehicles, and rays see what they see."""
    frames = defaultdict(list)
    for row in rows_of(shared_data / 'commonroad_ngsim' / 'USA_US101-4_1_T-1.csv'):
        frames[int(row['frame'])].append(Vehicle(row))
    known = set()
    for frame, vehicles in frames.items():
        present = {vehicle.number for vehicle in vehicles}
        gone = [messages.marker(n, ns='car', action=DELETE) for n in known - present]
        stamp = 1000 + frame
        world.markers(
            *gone,
            *(
                messages.marker(v.number, v.at, v.size, turn=v.turn, ns='car', stamp=stamp)
                for v in vehicles
            ),
        )
        known = present
        world.until(lambda s=stamp: world.plan('raycast', *FAR).header.stamp.sec == s)
        assert world.everything() == {vehicle.name for vehicle in vehicles}
        me = vehicles[frame % len(vehicles)]
        for other in vehicles:
            check_ray(world, vehicles, me.at, other.at)
    assert len(frames) == 101


FAR = ((0, 0, -9000), (1, 0, -9000))


def check_ray(world, vehicles, start, goal):
    entries = {v.name: v.entry(start, goal) for v in vehicles}
    expected = sorted((t, name) for name, t in entries.items() if t is not None)
    poses = world.plan('raycast_all', start, goal).poses
    assert [pose.header.frame_id for pose in poses] == [name for _, name in expected]
    for pose, (t, _) in zip(poses, expected, strict=True):
        at = pose.pose.position
        assert np.allclose((at.x, at.y, at.z), start + t * (goal - start), atol=1e-9)
    first = world.names('raycast', start, goal)
    assert first == [name for _, name in expected[:1]]


def scenes(shared_data):
    found = defaultdict(list)
    for row in rows_of(shared_data / 'manipulation_scenes' / 'scenes.csv'):
        found[row['scene']].append(row)
    return found


def test_manipulation_scenes(world, messages, shared_data):
    """Every object of every scene as a question: the answer is python-fcl's on all pairs."""
    fcl = pytest.importorskip('fcl', reason='python-fcl is not installed')
    questions = 0
    for stamp, objects in enumerate(scenes(shared_data).values(), 2000):
        world.markers(
            messages.marker(0, ns='', action=DELETE_ALL),
            *(
                messages.marker(
                    i,
                    numbers(row, 'cx', 'cy', 'cz'),
                    numbers(row, 'sx', 'sy', 'sz'),
                    turn=numbers(row, 'qx', 'qy', 'qz', 'qw'),
                    ns='scene',
                    stamp=stamp,
                    **({'type': CYLINDER} if row['shape'] == 'cylinder' else {}),
                )
                for i, row in enumerate(objects)
            ),
        )
        world.until(lambda s=stamp: world.plan('raycast', *FAR).header.stamp.sec == s)
        for row in objects:
            centre, size = numbers(row, 'cx', 'cy', 'cz'), numbers(row, 'sx', 'sy', 'sz')
            turn = numbers(row, 'qx', 'qy', 'qz', 'qw')
            for grown in (1.0, 1.5):
                corner = np.array(size) * grown / 2 @ axes_of(turn)
                found = world.names('overlap', centre - corner, centre + corner, turn=turn)
                box = fcl_object(fcl, 'box', centre, np.array(size) * grown, turn)
                check_against_fcl(fcl, box, objects, found)
                questions += 1
    assert questions == 2 * 131


def fcl_object(fcl, shape, centre, size, turn):
    x, y, z, w = np.asarray(turn) / np.linalg.norm(turn)
    if shape == 'cylinder':
        geometry = fcl.Cylinder(size[0] / 2, size[2])
    else:
        geometry = fcl.Box(*size)
    return fcl.CollisionObject(geometry, fcl.Transform((w, x, y, z), np.array(centre)))


def check_against_fcl(fcl, box, objects, found):
    for i, row in enumerate(objects):
        size = np.array(numbers(row, 'sx', 'sy', 'sz'))
        place = (numbers(row, 'cx', 'cy', 'cz'), numbers(row, 'qx', 'qy', 'qz', 'qw'))
        smaller, larger = (
            fcl.collide(
                box,
                fcl_object(fcl, row['shape'], place[0], size + delta, place[1]),
                fcl.CollisionRequest(),
                fcl.CollisionResult(),
            )
            for delta in (-2 * CLEAR, 2 * CLEAR)
        )
        if bool(smaller) == bool(larger):
            assert (f'scene/{i}' in found) == bool(smaller), (row, smaller)


def test_freiburg_building(start_node, messages, shared_data):
    """72,153 boxes in one message; cubes known to be free, shrunk by 1 mm, overlap nothing."""
    folder = shared_data / 'octomap_fr079'
    occupied = np.loadtxt(folder / 'occupied_voxels.csv', delimiter=',', skiprows=1)
    free = np.loadtxt(folder / 'free_voxels_sample.csv', delimiter=',', skiprows=1)
    world = start_node(
        {'sources': ['building'], 'building': {'type': 'PointCloud2', 'topic': 'b'}}
    )
    columns = dict(zip(FIELDS, occupied[:, (0, 1, 2, 3, 3, 3)].T, strict=True))
    world.publish('b', messages.cloud(columns))
    world.until(lambda: world.hits('raycast', *through(occupied[0])))
    assert f'{len(occupied)} obstacles' in world.trigger('validate').message
    for x, y, z, size in free[::SPARSE]:
        half = size / 2 - 0.001
        low, high = (x - half, y - half, z - half), (x + half, y + half, z + half)
        assert world.names('overlap', low, high) == []
    for x, y, z, size in occupied[::500]:
        half = size / 2 - 0.001
        low, high = (x - half, y - half, z - half), (x + half, y + half, z + half)
        assert len(world.names('overlap', low, high)) == 1


def through(voxel):
    x, y, z, size = voxel
    return (x, y, z), (x, y, z + size / 4)


def pixels_of(path):
    """Read a binary PGM."""
    magic, size, largest, data = path.read_bytes().split(b'\n', 3)
    while size.startswith(b'#'):
        size, largest, data = largest, *data.split(b'\n', 1)
    assert (magic, largest) == (b'P5', b'255')
    width, height = map(int, size.split())
    return np.frombuffer(data, dtype=np.uint8, count=width * height).reshape(height, width)


def test_willow_garage_map(start_node, shared_data):
    folder = shared_data / 'willow_garage_map'
    pixels = pixels_of(folder / 'map.pgm')[::-1]  # an image begins at the top, a map at the bottom
    grid = OccupancyGrid()
    grid.info.height, grid.info.width = pixels.shape
    grid.info.resolution = 0.1
    darkness = (255.0 - pixels) / 255.0
    values = np.where(darkness > 0.65, 100, np.where(darkness < 0.196, 0, -1)).astype(np.int8)
    grid.data = values.ravel().tolist()
    world = start_node(
        {
            'sources': ['floor'],
            'floor': {'type': 'OccupancyGrid', 'topic': 'map', 'required': True},
        }
    )
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    world.publish('map', grid, qos=latched)
    cells = np.loadtxt(folder / 'occupied_cells.csv', delimiter=',', skiprows=1)
    assert len(cells) == (values == 100).sum()
    world.until(lambda: world.hits('raycast', *above(cells[0])))
    for cell in cells[::4]:
        (name,) = world.names('raycast', *above(cell))
        assert name.startswith('floor#')
    for row, column in itertools.islice(np.argwhere(values < 100), 0, None, 150):
        assert world.names('raycast', *above(((column + 0.5) * 0.1, (row + 0.5) * 0.1))) == []
    boxes = int(world.trigger('validate').message.split()[1])
    assert boxes < len(cells) / 2


def above(cell):
    return (cell[0], cell[1], 3.0), (cell[0], cell[1], 1.0)
