# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded input: a building of 72,153 cubes, a floor plan, laser scans and traffic, each against
exact brute force.
"""

from pathlib import Path

import numpy as np
import pytest
from tree.reference import Floats, Ids, exact_hits, is_within_2_ulp, overlapping_rows, seen

from bvh_ros import DynamicBVH


def read_cubes(path: Path) -> tuple[Floats, Floats]:
    rows = np.loadtxt(path, delimiter=',', skiprows=1)
    centre, half = rows[:, :-1], rows[:, -1:] / 2
    return centre - half, centre + half


def near_the_ray(lo: Floats, hi: Floats, origin: Floats, direction: Floats) -> Ids:
    """Rows of the boxes that the ray may meet: those that the plain slab test finds when they are
    grown by 1 mm.
    """
    with np.errstate(all='ignore'):
        a, b = (lo - 1e-3 - origin) / direction, (hi + 1e-3 - origin) / direction
    entry, leave = np.fmin(a, b).max(axis=1), np.fmax(a, b).min(axis=1)
    return np.flatnonzero(entry <= leave + 1e-3)


def check_rays(
    tree: DynamicBVH, handles: Ids, lo: Floats, hi: Floats, origins: Floats, ways: Floats
) -> int:
    """All hits of every ray, in order; returns how many there were."""
    offsets, ids, ts = tree.raycast_all_many(origins, ways)
    first = tree.raycast_many(origins, ways)
    for ray, (origin, way) in enumerate(zip(origins, ways, strict=True)):
        rows = near_the_ray(lo, hi, origin, way)
        hits = seen(exact_hits(lo[rows], hi[rows], origin[None], way[None])[0], handles[rows])
        part = slice(offsets[ray], offsets[ray + 1])
        assert ids[part].tolist() == [handles[rows[hit.row]] for hit in hits]
        assert all(
            is_within_2_ulp(t, hit.t) for t, hit in zip(ts[part].tolist(), hits, strict=True)
        )
        assert first.ids[ray] == (ids[part][0] if hits else -1)
    return len(ids)


@pytest.fixture(scope='module')
def building(shared_data: Path) -> tuple[DynamicBVH, Floats, Floats]:
    lo, hi = read_cubes(shared_data / 'octomap_fr079' / 'occupied_voxels.csv')
    tree = DynamicBVH.from_boxes(lo, hi)
    tree.validate()
    assert len(tree) == 72153
    assert tree.height <= 4 * np.log2(len(tree)) + 4
    return tree, lo, hi


Building = tuple[DynamicBVH, Floats, Floats]


def test_the_free_space_of_the_building_is_free(building: Building, shared_data: Path) -> None:
    tree, lo, hi = building
    low, high = read_cubes(shared_data / 'octomap_fr079' / 'free_voxels_sample.csv')
    assert len(low) == 10000
    offsets, ids = tree.overlap_many(low + 0.001, high - 0.001, threads=2)
    assert (len(ids), offsets[-1]) == (0, 0)
    # And the occupied cubes, shrunk, overlap themselves alone.
    rows = np.arange(0, len(lo), 7)
    offsets, ids = tree.overlap_many(lo[rows] + 0.001, hi[rows] - 0.001)
    assert ids.tolist() == tree.ids()[rows].tolist()


def test_real_beams_in_the_building(building: Building, shared_data: Path) -> None:
    """The directions of a real scan, from a place that is free, and along the grid, through faces
    and edges of cubes.
    """
    tree, lo, hi = building
    beams = np.loadtxt(shared_data / 'freiburg_scan3d' / 'scan.csv', delimiter=',', skiprows=1)[
        ::1200, 1:
    ]
    free = read_cubes(shared_data / 'octomap_fr079' / 'free_voxels_sample.csv')[0][
        :: 10000 // len(beams)
    ]
    assert check_rays(tree, tree.ids(), lo, hi, free[: len(beams)], beams) > 100
    axes = np.tile(np.concatenate([np.eye(3), -np.eye(3), [[1, 1, 0], [0, -1, 1]]]), (4, 1))
    assert check_rays(tree, tree.ids(), lo, hi, lo[:: len(lo) // 32][:32], axes) > 100


def test_a_floor_plan_and_a_laser(shared_data: Path) -> None:
    """A planar tree of map cells, the beams of a real scanner from free places."""
    lo, hi = read_cubes(shared_data / 'willow_garage_map' / 'occupied_cells.csv')
    tree = DynamicBVH.from_boxes(lo, hi)
    assert (len(tree), tree.ndim) == (3486, 2)
    first, *_ = (shared_data / 'hokuyo_handheld' / 'scans.csv').read_text().splitlines()
    fields = dict(field.split('=') for field in first.split() if '=' in field)
    angles = float(fields['angle_min']) + float(fields['angle_increment']) * np.arange(0, 681, 5)
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    places = np.random.default_rng(1).uniform(lo.min(axis=0), hi.max(axis=0), (200, 2))
    free = places[[not len(tree.overlap(place - 0.2, place + 0.2)) for place in places]][:3]
    assert len(free) == 3
    for place in free:
        assert check_rays(tree, tree.ids(), lo, hi, np.tile(place, (len(ways), 1)), ways) > 100
    pairs = tree.overlap_pairs()
    for row in range(0, 3486, 200):
        others = tree.ids()[overlapping_rows(lo, hi, lo[row], hi[row])]
        own = tree.ids()[row]
        found = np.concatenate([pairs[pairs[:, 0] == own, 1], pairs[pairs[:, 1] == own, 0], [own]])
        assert sorted(found.tolist()) == others.tolist()


@pytest.mark.parametrize('name', ['USA_US101-4_1_T-1', 'USA_Peach-4_8_T-1'])
@pytest.mark.parametrize('margin', [0.0, 0.5])
def test_traffic(name: str, margin: float, shared_data: Path) -> None:
    """Vehicles appear, move and leave; at every frame the tree holds those of the frame, and rays
    between them are exact.
    """
    path = shared_data / 'commonroad_ngsim' / f'{name}.csv'
    rows = np.genfromtxt(path, delimiter=',', skip_header=1, usecols=range(13))
    tree = DynamicBVH(margin=margin)
    handle_of: dict[int, int] = {}
    hits = 0
    for frame in np.unique(rows[:, 0]):
        of_frame = rows[rows[:, 0] == frame]
        names = of_frame[:, 2].astype(int).tolist()
        yaw = 2 * np.arctan2(of_frame[:, 11], of_frame[:, 12])
        x, y = of_frame[:, 6] / 2, of_frame[:, 7] / 2
        half = np.stack(
            [
                abs(x * np.cos(yaw)) + abs(y * np.sin(yaw)),
                abs(x * np.sin(yaw)) + abs(y * np.cos(yaw)),
                of_frame[:, 8] / 2,
            ],
            axis=1,
        )
        lo, hi = of_frame[:, 3:6] - half, of_frame[:, 3:6] + half
        gone = [vehicle for vehicle in handle_of if vehicle not in names]
        tree.remove_many([handle_of.pop(vehicle) for vehicle in gone])
        known = [row for row, vehicle in enumerate(names) if vehicle in handle_of]
        tree.move_many([handle_of[names[row]] for row in known], lo[known], hi[known])
        for row, vehicle in enumerate(names):
            if vehicle not in handle_of:
                handle_of[vehicle] = tree.insert(lo[row], hi[row])
        tree.validate()
        handles = np.array([handle_of[vehicle] for vehicle in names])
        assert tree.ids().tolist() == sorted(handles.tolist())
        assert np.array_equal(tree.boxes(handles)[0], lo)
        a, b = np.divmod(np.arange(len(names) ** 2), len(names))
        centre = lo * 0.5 + hi * 0.5
        some = np.flatnonzero(a != b)[:: 1 + len(a) // 40]
        hits += check_rays(
            tree, handles, lo, hi, centre[a[some]], centre[b[some]] - centre[a[some]]
        )
    assert hits > 1000
