# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What one call of a tree or a scene costs from Python, all in, beside one of a peer."""

from collections.abc import Callable
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np

from .. import DynamicBVH
from ..scene import Scene, Shapes
from .libraries.embree import Embree, triangles
from .libraries.fcl import Coal
from .page import Page
from .scenes import EDGE, Boxes, Floats, Rays, incoherent_rays, query_edge, spread, uniform_boxes
from .tables import Cell, Table
from .timing import Job, interleaved

BOXES, CALLS, REPEATS = 10_000, 500, 9
RADIUS = 0.2  # m, of the swept ball
TEN = 10
STEP = 0.01  # m that an obstacle goes


class Asked(NamedTuple):
    """What the calls are about."""

    boxes: Boxes
    rays: Rays
    goals: Floats
    """As far from where the rays begin as the scene is wide."""
    small: Boxes
    turns: Floats


def calls(page: Page, brief: bool) -> None:
    """Measure."""
    size, count, repeats = (300, 20, 3) if brief else (BOXES, CALLS, REPEATS)
    asked = make_asked(size, count)
    ours, theirs = tree_jobs(asked) | scene_jobs(asked), peer_jobs(asked)
    found = interleaved(ours | theirs, repeats, warm=not brief)
    times = {name: timing.nanoseconds / 1e3 for name, timing in found.items()}
    rows: list[list[Cell]] = []
    for name in ours:
        peer = next((peer for peer in theirs if peer.partition(': ')[2] == name), '')
        rows.append([name, times[name], peer.partition(': ')[0]])
        rows[-1] += [times[peer], times[name] / times[peer]] if peer else [None, None]
    page.add('### Calls')
    page.add(
        f'{size:,} boxes, one call after the other, us a call with all that it takes: input '
        'checked, in a scene names looked up, points and normals of the hits. coal is asked for '
        'the pairs of the same box, without names, points or normals, or moves the same box; '
        'Embree for the triangle alone. *move* is to a place nearby and back.'
    )
    header = ['call', 'us a call', 'peer', 'us a call there', 'ours / peer']
    page.table(Table('peers_calls', header, rows))


def make_asked(size: int, calls: int) -> Asked:
    """Boxes, and so many questions."""
    rng = np.random.default_rng(1)
    boxes, rays = uniform_boxes(size, rng), incoherent_rays(calls, rng)
    corner = spread(calls, rng)
    return Asked(
        boxes,
        rays,
        rays.origins + EDGE * rays.directions,
        Boxes(corner, corner + query_edge(boxes, 0.5)),
        rng.normal(size=(calls, 4)),
    )


def each(function: Callable[..., Any], *columns: Any) -> Job:
    """Call it with each row of the columns."""
    rows = list(zip(*columns, strict=True))

    def run() -> None:
        for row in rows:
            function(*row)

    return Job(run, len(rows))


def _one_by_one(*columns: Floats) -> list[list[Floats]]:
    """Each row as an array of one."""
    return [[row[None] for row in column] for column in columns]


def tree_jobs(asked: Asked) -> dict[str, Job]:
    """Calls of a tree, by name."""
    tree, changed = (DynamicBVH.from_boxes(*asked.boxes) for _ in range(2))
    rays, small = asked.rays, asked.small
    handles, away = changed.ids()[: len(rays.origins)].tolist(), cycle((STEP, 0.0))
    lo, hi = (side[: len(handles)] for side in asked.boxes)

    def move() -> None:
        shift = next(away)
        for handle, low, high in zip(handles, lo + shift, hi + shift, strict=True):
            changed.move(handle, low, high)

    def insert_and_remove() -> None:
        for handle in [changed.insert(low, high) for low, high in zip(lo, hi, strict=True)]:
            changed.remove(handle)

    origins, directions, low, high = _one_by_one(*rays, *small)
    return {
        'tree: raycast': each(tree.raycast, *rays),
        'tree: occluded': each(tree.occluded, *rays),
        'tree: overlap': each(tree.overlap, *small),
        'tree: nearest': each(tree.nearest, rays.origins),
        'tree: boxcast': each(tree.boxcast, *small, small.hi - small.lo),
        'tree: move': Job(move, len(handles)),
        'tree: insert and remove': Job(insert_and_remove, len(handles)),
        'tree: raycast_many of one': each(tree.raycast_many, origins, directions),
        'tree: occluded_many of one': each(tree.occluded_many, origins, directions),
        'tree: raycast_all_many of one': each(tree.raycast_all_many, origins, directions),
        'tree: overlap_many of one': each(tree.overlap_many, low, high),
        'tree: nearest_many of one': each(tree.nearest_many, origins),
    }


def scene_jobs(asked: Asked) -> dict[str, Job]:
    """Calls of a scene, by name."""
    starts = asked.rays.origins
    scene, (lo, hi) = Scene(), asked.boxes
    names = [f'box{row}' for row in range(len(lo))]
    middle, size = (lo + hi) / 2, hi - lo
    scene.update('report', names, Shapes.boxes(middle, size), stamp=0)

    def updates(many: int) -> Job:
        """Runs of rows that go a step, and back in the next turn."""
        runs = [slice(row, row + many) for row in range(min(len(starts), len(lo) - many))]
        parts = [
            [(names[run], Shapes.boxes(middle[run] + step, size[run])) for run in runs]
            for step in (STEP, 0.0)
        ]
        turns = cycle(parts)

        def run() -> None:
            for named, shapes in next(turns):
                scene.update('report', named, shapes, stamp=1)

        return Job(run, len(runs))

    def swept(start: Floats, goal: Floats) -> None:
        scene.raycast(start, goal, RADIUS)

    begins, ends, ways = _one_by_one(starts, asked.goals, asked.rays.directions)
    edges = _one_by_one(asked.small.hi - asked.small.lo)[0]
    shapes = [Shapes.boxes(place, edge) for place, edge in zip(begins, edges, strict=True)]
    return {
        'scene: raycast': each(scene.raycast, starts, asked.goals),
        'scene: swept ball': each(swept, starts, asked.goals),
        'scene: overlap': each(scene.overlap, *asked.small),
        'scene: turned overlap': each(scene.overlap, *asked.small, asked.turns),
        'scene: nearest': each(scene.nearest, starts),
        'scene: update of one': updates(1),
        'scene: update of ten': updates(TEN),
        'scene: raycast_many of one': each(scene.raycast_many, begins, ways),
        'scene: sweep_many of one': each(scene.sweep_many, begins, ends),
        'scene: overlap_many of one': each(scene.overlap_many, begins, edges),
        'scene: nearest_many of one': each(scene.nearest_many, begins),
        'scene: clearance_many of one': each(scene.clearance_many, shapes),
    }


def peer_jobs(asked: Asked) -> dict[str, Job]:
    """What installed peers have of the kind, by their name and that of our call."""
    found: dict[str, Job] = {}
    if Embree().installed():
        scene = Embree().scene(triangles(asked.boxes))
        rays = [part.astype(np.float32)[:, None] for part in asked.rays]
        found['Embree: tree: raycast'] = each(scene.run, *rays)
    library = Coal()
    if not library.installed():
        return found
    objects = library._objects(asked.boxes)
    manager, small = library._manager(objects), library._objects(asked.small)
    centers = (asked.boxes.lo + asked.boxes.hi) / 2
    states = cycle((STEP, 0.0))

    def overlap(item: Any) -> None:
        library._collide(manager, [item], len(objects))

    def update() -> None:
        shift = next(states)
        for item, center in zip(objects[: len(small)], centers, strict=False):
            library._put(item, center + shift)
            manager.update()

    for room, changed in (('tree', 'move'), ('scene', 'update of one')):
        found[f'coal: {room}: overlap'] = each(overlap, small)
        found[f'coal: {room}: {changed}'] = Job(update, len(small))
    return found
