# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded traffic and planning scenes; `test_replay.py` has a building and a map."""

import csv
from collections import defaultdict

import numpy as np
import pytest
from ros.messages import coordinates, marker
from scipy.spatial.transform import Rotation

pytestmark = pytest.mark.slow

DELETE, DELETE_ALL, CYLINDER = 2, 3, 3
CLEAR = 1e-6  # m: closer than this to touching, two libraries may differ in rounding


def rows_of(path):
    with path.open(newline='') as file:
        return list(csv.DictReader(file))


def numbers(row, *names):
    return tuple(float(row[name]) for name in names)


def axes_of(q):
    """Rows: the directions of a box's own axes."""
    return Rotation.from_quat(q).as_matrix().T


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


def test_us101_replay(world, shared_data):
    """At every frame the tree holds exactly that frame's vehicles, and rays see what they see."""
    frames = defaultdict(list)
    for row in rows_of(shared_data / 'commonroad_ngsim' / 'USA_US101-4_1_T-1.csv'):
        frames[int(row['frame'])].append(Vehicle(row))
    known = set()
    for frame, vehicles in frames.items():
        present = {vehicle.number for vehicle in vehicles}
        gone = [marker(n, ns='car', action=DELETE) for n in known - present]
        stamp = 1000 + frame
        world.markers(
            *gone,
            *(
                marker(v.number, v.at, v.size, turn=v.turn, ns='car', stamp=stamp)
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
        assert np.allclose(coordinates(pose), start + t * (goal - start), atol=1e-9)
    first = world.names('raycast', start, goal)
    assert first == [name for _, name in expected[:1]]


def scenes(shared_data):
    found = defaultdict(list)
    for row in rows_of(shared_data / 'manipulation_scenes' / 'scenes.csv'):
        found[row['scene']].append(row)
    return found


def test_manipulation_scenes(world, shared_data):
    """Every object of every scene as a question: the answer is python-fcl's on all pairs."""
    fcl = pytest.importorskip('fcl', reason='python-fcl is not installed')
    questions = 0
    for stamp, objects in enumerate(scenes(shared_data).values(), 2000):
        world.markers(
            marker(0, ns='', action=DELETE_ALL),
            *(
                marker(
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
