# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded input: a building, a laser scan, traffic and shelves, read from their CSV files."""

import csv
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...scene import ShapeKind, Shapes
from ..scenes import Boxes, Floats

Line = dict[str, str]


def cubes(path: Path) -> Boxes:
    """Rows of x, y, z, size."""
    rows = np.loadtxt(path, delimiter=',', skiprows=1)
    half = rows[:, 3:] / 2
    return Boxes(rows[:, :3] - half, rows[:, :3] + half)


def scan_directions(path: Path) -> Floats:
    """Unit vectors towards the returns of a scan from the origin."""
    ends = np.loadtxt(path, delimiter=',', skiprows=1)[:, 1:]
    unit: Floats = ends / np.linalg.norm(ends, axis=1)[:, None]
    return unit


def _numbers(rows: list[Line], columns: str) -> Floats:
    return np.array([[float(row[name]) for name in columns.split()] for row in rows])


def shapes_by_scene(path: Path) -> dict[str, Shapes]:
    """Boxes and cylinders of each planning scene."""
    scenes: dict[str, list[Line]] = defaultdict(list)
    with open(path, newline='', encoding='utf-8') as file:
        for row in csv.DictReader(file):
            scenes[row['scene']].append(row)
    return {
        name: Shapes(
            np.array([ShapeKind[row['shape'].upper()] for row in rows], np.uint8),
            _numbers(rows, 'cx cy cz'),
            _numbers(rows, 'qx qy qz qw'),
            _numbers(rows, 'sx sy sz'),
        )
        for name, rows in scenes.items()
    }


class Track(NamedTuple):
    """One vehicle, k frames in order of time."""

    times: Floats
    """(k,) s."""
    positions: Floats
    """(k, 3) m."""
    turns: Floats
    """(k, 4) quaternions x, y, z, w, neighbours on one side of the sphere."""
    size: Floats
    """(3,) m."""


def tracks(path: Path) -> dict[int, Track]:
    """Vehicles by number."""
    vehicles: dict[int, list[Line]] = defaultdict(list)
    with open(path, newline='', encoding='utf-8') as file:
        for row in csv.DictReader(file):
            vehicles[int(row['id'])].append(row)
    return {number: _track(rows) for number, rows in sorted(vehicles.items())}


def _track(rows: list[Line]) -> Track:
    turns = _numbers(rows, 'qx qy qz qw')
    for i in range(1, len(turns)):
        if turns[i] @ turns[i - 1] < 0:
            turns[i] *= -1
    size = _numbers(rows[:1], 'sx sy sz')[0]
    return Track(_numbers(rows, 't_s')[:, 0], _numbers(rows, 'cx cy cz'), turns, size)
