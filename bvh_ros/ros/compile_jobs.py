# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a configuration calls, on throw-away scenes: whoever runs it has the kernels compiled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from bvh_ros import DynamicBVH
from bvh_ros.ros import shape_jobs
from bvh_ros.ros.cdr import path
from bvh_ros.ros.job_scenes import (
    ABOUT_Z,
    BOXES,
    EDGE,
    FAR,
    GOAL,
    MANY,
    MIDDLE,
    NUMBERS,
    RADIUS,
    START,
    empty,
    replace,
    scenes,
    with_boxes,
    with_shapes,
)
from bvh_ros.scene import Numbered, Scene, ShapeKind, Shapes
from bvh_ros.scene.names import Registry, as_families
from bvh_ros.tree.access import inherit_entry

FEW = 128  # rays that go through the snapshot one by one, where there is one

# What is compiled only when somebody asks.
NEAREST, BALLS, POINTS = 'nearest', 'batches of balls', 'batches of points'
BOXES_ASKED = 'batches of boxes'
NEAREST_THEN, PATHS_THEN = 'nearest at other times', 'paths at other times'


class Needs(NamedTuple):
    """What decides which kernels are called.

    Attributes
    ----------
    planar, margin
        As the node's scene has them.
    kinds : sequence of ShapeKind
        The shapes that its sources can bring, in order.
    batch : bool
        Whether rays come in batches.
    threads : int
        That share a batch.
    moving : bool
        Whether obstacles have velocities.
    """

    planar: bool
    margin: float
    kinds: Sequence[ShapeKind]
    batch: bool
    threads: int = 1
    moving: bool = False


class Job(NamedTuple):
    """Calls that share kernels, and few of them with other jobs.

    Attributes
    ----------
    name : str
        What is compiled, for people.
    key : str
        Jobs of equal keys compile the same.
    seconds : float
        About how long compiling takes, alone on one processor.
    run : callable
        Can be pickled.
    early : bool
        Whether the first answers wait for it: those for thin rays among axis-aligned boxes.
    """

    name: str
    key: str
    seconds: float
    run: Callable[[], object]
    early: bool = False


def jobs(needs: Needs) -> list[Job]:
    """Return all calls: those that the first answers wait for, then the longest."""
    calls: list[tuple[str, float, Callable[[Needs], None]]] = [
        ('obstacles', 9.0, _obstacles),
        ('thin rays', 6.0, _thin_rays),
        ('names', 1.5, _names),
        *([('batches of rays', 8.0, _batches)] if needs.batch else []),
        *shape_jobs.calls(needs),
        ('boxes', 3.0, _among_boxes),
        *([('threads', 1.0, _threads)] if needs.batch and needs.threads > 1 else []),
        *_moving(needs)[:1],
        ('checks', 1.5, _checks),
    ]
    return _named(calls, needs)


def later_jobs(needs: Needs) -> list[Job]:
    """Return what is compiled only when somebody asks."""
    calls: list[tuple[str, float, Callable[[Needs], None]]] = [
        (NEAREST, 8.0, _nearest),
        *([(BALLS, 12.0, _many_balls), (BOXES_ASKED, 20.0, _boxes_asked)] if needs.batch else []),
        *([(POINTS, 10.0, _points)] if needs.batch else []),
        *_moving(needs)[1:],
    ]
    return _named(calls, needs)


def path_jobs(needs: Needs) -> list[Job]:
    """Return what paths need: compiled at the start, where there is a footprint."""
    return _named([('paths', 20.0, _paths)], needs)


def _named(calls: Sequence[tuple[str, float, Callable[[Needs], None]]], needs: Needs) -> list[Job]:
    tells_apart = _tells_apart(needs)
    return [
        Job(name, f'{name} {tells_apart}', seconds, partial(call, needs), call in EARLY)
        for name, seconds, call in calls
    ]


def _moving(needs: Needs) -> list[tuple[str, float, Callable[[Needs], None]]]:
    """What is called at the start, and once somebody asks, where obstacles have velocities."""
    if not needs.moving:
        return []
    from bvh_ros.ros.moving_jobs import nearest_then, other_times, paths_then

    later = (NEAREST_THEN, 30.0, nearest_then), (PATHS_THEN, 30.0, paths_then)
    return [('other times', 70.0, other_times), *later]


def _tells_apart(needs: Needs) -> tuple[int, ...]:
    """What other kernels are compiled by."""
    kinds = map(int, needs.kinds)
    return needs.planar, needs.margin > 0.0, *kinds, *([-1] if needs.moving else [])


def _nearest(needs: Needs) -> None:
    for scene in scenes(needs):
        scene.nearest(START, 2)


def _many_balls(needs: Needs) -> None:
    for scene in scenes(needs):
        scene.sweep_many([START], [GOAL], RADIUS)


def _boxes_asked(needs: Needs) -> None:
    for scene in scenes(needs):
        scene.overlap_many([START], EDGE, want='hits')
        scene.overlap_many([START], EDGE, [ABOUT_Z], RADIUS, want='hits')


def _points(needs: Needs) -> None:
    for scene in scenes(needs):
        scene.nearest_many([START])
        scene.nearest_many([START] * 1000)  # are asked in the order of neighbours


def _paths(needs: Needs) -> None:
    path.read(path.EMPTY)
    for scene in scenes(needs):
        scene.clearance_many(Shapes.boxes([START], EDGE, [ABOUT_Z]), signed=True)


def _obstacles(needs: Needs) -> None:
    """Every way in which obstacles come, move and go, and what is told of them all the time. The
    tree first: it takes longest, and `_thin_rays` and `_names` compile meanwhile what else a new
    box takes.
    """
    boxes = MIDDLE[:, : 2 if needs.planar else 3]
    DynamicBVH(boxes.shape[1]).insert_many(boxes, boxes)
    scene, margin = with_boxes(needs), needs.margin
    places = [*(MIDDLE + 50.0), MIDDLE[1] - 9.0]
    for number, place in zip([*range(BOXES), 1], places, strict=True):
        scene.update('markers', [f'one/{number}'], Shapes.boxes(place, EDGE), stamp=1)
    replace(scene, 1.001 * margin + 0.001)  # just out of the fat boxes: they are refitted
    replace(scene, 3.0 * margin + 7.0)
    scene.remove('markers', ['one/0', 'one/1'])
    if needs.moving:
        place = Shapes.boxes(MIDDLE[0], EDGE)
        scene.update('markers', ['moving'], place, stamp=1, velocities=[EDGE])
    scene.rebuild()
    scene.stats()
    with_shapes(needs)


def _thin_rays(needs: Needs) -> None:
    scene = empty(needs)
    scene.raycast(START, GOAL)
    replace(scene, 0.0, NUMBERS[:0])


def _names(needs: Needs) -> None:
    """What is told of a tree, and of names, without a box in it."""
    inherit_entry(2 if needs.planar else 3)
    registry, names = Registry(), as_families(Numbered('box#', NUMBERS))
    registry.add(names, NUMBERS)
    registry.find(names)
    registry.discard(NUMBERS)
    scene = empty(needs)
    scene.stats()
    scene.clear()


def _among_boxes(needs: Needs) -> None:
    """All hits of thin rays, and overlaps of boxes, without a narrow phase."""
    for scene in (empty(needs), with_boxes(needs)):
        scene.raycast_all(START, GOAL)
        scene.overlap(START, FAR)


def _checks(needs: Needs) -> None:
    with_boxes(needs).validate()


def _batches(needs: Needs) -> None:
    """Of each size that is answered in a way of its own; first what compiles without boxes."""
    from bvh_ros.scene.cast.boxes import few_entry
    from bvh_ros.tree.access import blurred_entry, cast_entry, collapse_entry, planning_entry

    for entry in blurred_entry, planning_entry, collapse_entry, cast_entry, few_entry:
        entry(2 if needs.planar else 3)
    scene = Scene(planar=needs.planar, margin=needs.margin)
    line = np.arange(MANY * 3.0).reshape(MANY, 3)
    scene.raycast_many(line[:1], line[:1])
    scene.replace(
        'cloud', '', Numbered('box#', np.arange(MANY)), Shapes.boxes(line, EDGE), stamp=1
    )
    for count in (1, MANY, FEW):  # the snapshot is there once many were asked
        scene.raycast_many(line[:count], line[:count])


def _threads(needs: Needs) -> None:
    """Count the rays of a batch that several threads have answered, each some of them."""
    from bvh_ros.tree.access import few_entry

    line = MIDDLE[:, : 2 if needs.planar else 3]
    few_entry(line.shape[1])
    DynamicBVH(line.shape[1]).raycast_many(line, line, threads=2)


EARLY = _obstacles, _thin_rays, _names
