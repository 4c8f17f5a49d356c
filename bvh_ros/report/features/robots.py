# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What to leave out of the configuration, for four kinds of robots."""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...scene import ShapeKind, Shapes
from ..error import recordings
from ..page import Page
from ..progress import Progress
from ..scenes import Floats
from ..tables import Cell, Table
from . import robot_worlds
from .running import Job, World, medians, run_in_turns

RAYS = 300


class Robot(NamedTuple):
    """A robot, its world and its configuration."""

    name: str
    file: str
    """The recording, in the folder of the data."""
    read: Callable[[Path], Shapes]
    alike: Callable[[], Shapes]
    """A made-up world of that kind, for where there is no recording."""
    advice: str
    planar: bool
    margin: float
    box_sources: bool
    """Whether the true shapes are left out too."""


def warehouse(path: Path) -> Shapes:
    """Cells of a floor plan, two metres high."""
    cells = np.loadtxt(path, delimiter=',', skiprows=1)
    place = np.column_stack([cells[:, :2], np.ones(len(cells))])
    return Shapes.boxes(place, np.column_stack([cells[:, 2], cells[:, 2], np.full(len(cells), 2)]))


def shelf(path: Path) -> Shapes:
    """The planning scene with the most objects."""
    return max(recordings.shapes_by_scene(path).values(), key=lambda shapes: len(shapes.kind))


def road(path: Path) -> Shapes:
    """The vehicles where each was seen first."""
    found = list(recordings.tracks(path).values())
    return Shapes.boxes(
        np.array([track.positions[0] for track in found]),
        np.array([track.size for track in found]),
        np.array([track.turns[0] for track in found]),
    )


def voxels(path: Path) -> Shapes:
    """Occupied voxels of a building."""
    boxes = recordings.cubes(path)
    return Shapes.boxes((boxes.lo + boxes.hi) / 2, boxes.hi - boxes.lo)


ROBOTS = (
    Robot(
        'warehouse robot', 'willow_garage_map/occupied_cells.csv', warehouse, robot_worlds.aisles,
        'planar: true, batch: false; an OccupancyGrid brings its walls', True, 0.0, False,
    ),
    Robot(
        'arm at a shelf', 'manipulation_scenes/scenes.csv', shelf, robot_worlds.cans,
        'batch: false, views: none; cans as boxes only where that is close enough', False, 0.0,
        True,
    ),
    Robot(
        'car', 'commonroad_ngsim/USA_US101-4_1_T-1.csv', road, robot_worlds.lanes,
        'planar: true, batch: false, margin: 0.5', True, 0.5, False,
    ),
    Robot(
        'drone', 'octomap_fr079/occupied_voxels.csv', voxels, robot_worlds.rooms,
        'a PointCloud2 of boxes, no markers; batch: true only for a virtual lidar', False, 0.0,
        False,
    ),
)  # fmt: skip


def chosen(brief: bool) -> tuple[Robot, ...]:
    """Rows of the table: in brief only the smallest world."""
    return ROBOTS[1:2] if brief else ROBOTS


def repeats(brief: bool) -> int:
    """Of each robot, in each configuration."""
    return 1 if brief else 2


def steps(brief: bool) -> int:
    """How often the progress bar will move."""
    return 2 * len(chosen(brief)) * repeats(brief)


def run(page: Page, progress: Progress, brief: bool) -> None:
    """Measure."""
    progress.say('features: robots')
    page.add('### What to leave out')
    rows: list[list[Cell]] = []
    with tempfile.TemporaryDirectory() as folder:
        for robot in chosen(brief):
            recording = page.data / robot.file
            recorded = recording.is_file()
            shapes = robot.read(recording) if recorded else robot.alike()
            world = World(shapes, *_segments(shapes))
            job = Job(world.save(Path(folder), robot.name))
            lean = job._replace(planar=robot.planar, margin=robot.margin)
            if robot.box_sources:
                as_boxes = world._replace(shapes=_boxes_of(shapes))
                lean = lean._replace(file=as_boxes.save(Path(folder), f'{robot.name} as boxes'))
            took = run_in_turns({'whole': job, 'lean': lean}, repeats(brief), progress.step)
            whole, left = medians(took['whole']), medians(took['lean'])
            row: list[Cell] = [robot.name, 'recorded' if recorded else 'made up']
            row += [len(shapes.kind), robot.advice]
            for key, unit in (('update', 1e6), ('raycast', 1e6), ('start', 1.0), ('memory', 1.0)):
                row += [whole[key] * unit, left[key] * unit]
            rows.append(row)
    page.add(
        'Each robot in a recorded world, or where there is no recording (see --data) in one made '
        'up like it. In pairs of columns: everything in 3D with the shapes as they are, then '
        'configured as the row says. Kernels of what is not configured are not '
        'compiled, and its topics not subscribed.'
    )
    header = ['robot', 'world', 'obstacles', 'configure']
    for name in ('us an obstacle, update', 'us, raycast', 's, start', 'MB, memory'):
        header += [name, 'so configured']
    page.table(Table('features_robots', header, rows))


def _segments(shapes: Shapes) -> tuple[Floats, Floats]:
    """From anywhere in the world to anywhere."""
    rng = np.random.default_rng(2)
    low, high = shapes.position.min(axis=0), shapes.position.max(axis=0)
    starts, goals = rng.uniform(low, high, (2, RAYS, 3))
    return starts, goals


def _boxes_of(shapes: Shapes) -> Shapes:
    """The same as boxes that do not turn, as large as the largest that they can take up."""
    reach = np.linalg.norm(shapes.size, axis=1)[:, None]
    turned = shapes.orientation[:, :3].any(axis=1, keepdims=True)
    size = np.where(turned, np.broadcast_to(reach, shapes.size.shape), shapes.size)
    kind = np.full_like(shapes.kind, ShapeKind.BOX)
    return Shapes(kind, shapes.position, np.zeros_like(shapes.orientation), size)
