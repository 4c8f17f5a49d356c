# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report peers`: other libraries on the same work in the same run."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from itertools import cycle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .. import DynamicBVH
from ..scene import Scene, Shapes
from . import timing
from .libraries import LIBRARIES, Coal, Embree, Library, Work, make_work, triangles
from .page import Cell, Page, Table
from .scenes import EDGE, Boxes, Floats, Rays, incoherent_rays, query_edge, spread, uniform_boxes
from .timing import Job, Timing, interleaved

# ---- Batches of every size and kind of rays, with Embree on the same in the same run.


BATCH_BOXES = 1_000, 10_000, 100_000
BATCH_SIZES = 1, 4, 15, 16, 64, 255, 256, 1_024, 4_096, 20_000, 100_000
BATCH_RAYS, TURNS, BATCH_REPEATS = 200_000, 4_096, 9
LIDAR, PLANE = (64, 512), (1, 681)  # rows and beams a row of a scan
SCAN_PLACES = 0.2, 0.3, 0.4, 0.5  # m, on the cube's diagonal
ANYWHERE = 'from anywhere'
PEERS = 'bvh_ros', 'Embree', 'Embree, triangle alone'


class Batch(NamedTuple):
    """What is cast at once."""

    origins: Floats
    directions: Floats
    t_max: float = np.inf


def scan(rows: int, beams: int, place: float) -> Batch:
    """A scan from near the middle: `rows` from 0.4 rad below the horizon to as much above."""
    across = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    up = np.linspace(-0.4, 0.4, rows) if rows > 1 else np.zeros(1)
    up, across = np.repeat(up, beams), np.tile(across, rows)
    flat = np.cos(up)
    directions = np.stack([flat * np.cos(across), flat * np.sin(across), np.sin(up)], axis=1)
    return Batch(np.full(directions.shape, place), directions)


def every_batch(brief: bool) -> Iterator[tuple[str, list[Batch]]]:
    """By kind, in every size: batches of other rays that take turns."""
    origins, directions = incoherent_rays(200 if brief else BATCH_RAYS, np.random.default_rng(3))
    beyond = np.add(origins, (0.0, 0.0, 2.0 * EDGE))
    kinds = {
        ANYWHERE: Batch(origins, directions),
        'segments of 1 m': Batch(origins, directions, 1.0),
        'segments of 5 m': Batch(origins, directions, 5.0),
        'all miss': Batch(beyond, np.abs(directions)),
    }
    for count in (1, 20) if brief else BATCH_SIZES:
        starts = range(0, min(len(origins), TURNS * count) - count + 1, count)
        for kind, every in kinds.items():
            begin, way, reach = every
            yield kind, [Batch(begin[k : k + count], way[k : k + count], reach) for k in starts]
    for kind, shape in (('lidar scan', LIDAR), ('scan in a plane', PLANE)):
        yield kind, [scan(*((2, 10) if brief else shape), place) for place in SCAN_PLACES]


def batches(page: Page, brief: bool) -> None:
    """Measure every kind and size."""
    if find_spec(Embree.module) is None:
        page.add('Embree is not installed here, and so batches of rays are left out.')
        return
    rows: list[list[Cell]] = []
    for size in (300,) if brief else BATCH_BOXES:
        boxes = uniform_boxes(size, np.random.default_rng(0))
        tree, scene = DynamicBVH.from_boxes(*boxes), Embree().scene(triangles(boxes))
        tree.raycast_many(*incoherent_rays(max(size, 100), np.random.default_rng(1)))
        for kind, turns in every_batch(brief):
            times = _batch_times(tree, scene, turns, brief)
            over = [times[0] / time for time in times[1:]]
            rows.append([size, kind, len(turns[0].origins), *times, *over])
    page.add('### Batches of rays')
    page.add(
        'One call with as many rays, all in, others each time: the same again and again are '
        'learnt by the processor. bvh_ros takes float64 and returns id, distance and '
        'normal, as Embree does from float32 arrays that are ready (`run(..., output=True)`); '
        'the *triangle alone* is what its default query returns.'
    )
    columns = [*(f'{name}, us' for name in PEERS), *(f'ours / {name}' for name in PEERS[1:])]
    page.table(Table('peers_batches', ['boxes', 'rays', 'in a batch', *columns], rows))
    _plot_batches(
        page.plot('peers_batches', 'Time a ray against rays in a batch, from anywhere'), rows
    )


def _batch_times(tree: DynamicBVH, scene: Any, turns: list[Batch], brief: bool) -> list[float]:
    """Microseconds a call, in the order of `PEERS`."""
    reach, ours = turns[0].t_max if np.isfinite(turns[0].t_max) else None, cycle(turns)
    theirs = cycle([[np.float32(part) for part in turn[:2]] for turn in turns])
    runs = (
        lambda: tree.raycast_many(*next(ours)),
        lambda: scene.run(*next(theirs), dists=reach, output=True),
        lambda: scene.run(*next(theirs), dists=reach),
    )
    jobs = {name: many_times(Job(run, 1), brief) for name, run in zip(PEERS, runs, strict=True)}
    found = interleaved(jobs, 3 if brief else BATCH_REPEATS, warm=not brief)
    return [found[name].nanoseconds / 1e3 for name in PEERS]


def _plot_batches(path: Path, rows: list[list[Cell]]) -> None:
    from matplotlib.figure import Figure

    shown = {row[0]: [r for r in rows if r[:2] == [row[0], ANYWHERE]] for row in rows}
    figure = Figure(figsize=(4.6 * len(shown), 3.4), layout='constrained')
    panels = figure.subplots(1, len(shown), squeeze=False, sharey=True)[0]
    for axes, (size, points) in zip(panels, shown.items(), strict=True):
        counts = np.array([row[2] for row in points])
        for column, name in enumerate(PEERS, 3):
            axes.plot(counts, [row[column] for row in points] / counts, 'o-', label=name)
        axes.set(xscale='log', yscale='log', xlabel='rays in a batch', title=f'{size:,} boxes')
        axes.xaxis.set_major_formatter('{x:,.0f}')
        axes.yaxis.set_major_formatter('{x:g}')
        axes.yaxis.set_minor_formatter('')
        axes.grid(alpha=0.3, which='both')
    panels[0].set_ylabel('us a ray')
    panels[0].legend()
    figure.savefig(path)


def many_times(job: Job, brief: bool) -> Job:
    """So often that the clock's own time is none of it."""
    job.run()
    times = 1 if brief else max(1, int(1e-3 / timing.seconds(job.run)))

    def run() -> None:
        for _ in range(times):
            job.run()

    return Job(run, times * job.units)


# ---- What one call of a tree or a scene costs from Python, all in, beside one of a peer.


CALL_BOXES, CALLS, CALL_REPEATS = 10_000, 500, 9
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
    size, count, repeats = (300, 20, 3) if brief else (CALL_BOXES, CALLS, CALL_REPEATS)
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


# ---- `bvh_report peers`: other libraries on the same work in the same run.


class Task(NamedTuple):
    """One kind of work."""

    name: str
    """Name of the libraries' method, and of the table."""
    title: str
    unit: str
    """What a figure is a time of."""
    answers: str
    """What was counted, to see that all gave the same answer."""
    sizes: tuple[int, ...]
    asked: int
    """Rays, queries or points."""


MIDDLE, GROWING = (10_000,), (1_000, 10_000, 100_000)
TASKS = (
    Task('cast', 'Cast rays: the first box on each', 'ns a ray', 'hits', GROWING, 20_000),
    Task('frame', 'Move all boxes a little, then 1,000 rays', 'ns a frame', 'hits', MIDDLE, 1_000),
    Task('move_all', 'Move all boxes a little', 'ns a box', '', MIDDLE, 1),
    Task('move_some', 'Move 1 box in 32 to anywhere', 'ns a box', '', MIDDLE, 1),
    Task('build', 'Build from nothing', 'ns a box', 'boxes', MIDDLE, 1),
    Task('overlap', 'Overlaps of a small box', 'ns a query', 'hits', MIDDLE, 20_000),
    Task('pairs', 'All pairs of boxes that overlap', 'ns a box', 'pairs', MIDDLE, 1),
    Task('nearest', 'Nearest of many points', 'ns a query', 'mm in sum', MIDDLE, 20_000),
)  # fmt: skip
REPEATS, REPEATS_QUICK = 15, 3


def quick(task: Task) -> Task:
    """The same kind of work in a small form."""
    return task._replace(sizes=(300,), asked=min(task.asked, 200))


def all_tasks(page: Page, brief: bool) -> None:
    """Measure every task that two or more installed libraries can do."""
    libraries = [library for library in LIBRARIES if library.installed()]
    page.add(_introduction(libraries))
    with one_processor():
        for task in TASKS:
            found = measure(quick(task) if brief else task, libraries, brief)
            page.add(f'### {task.title}')
            page.table(table(task, found))


def _introduction(libraries: list[Library]) -> str:
    absent = [library.name for library in LIBRARIES if library not in libraries]
    notes = [f'- **{library.name}**: {library.note}.' for library in libraries]
    missing = f'Not installed here, and so left out: {", ".join(absent)}.'
    head = (
        'Boxes of random proportions that fill 2 % of a cube of 100 m; rays from anywhere to '
        'anywhere. One processor. The libraries take turns, each with untimed runs for '
        f'{timing.WARM_SECONDS * 1e3:.0f} ms before the timed one, and the medians of the '
        'turns are shown. *ours / this* below 1: bvh_ros is faster.'
    )
    return '\n'.join([head, '', *notes, '', missing if absent else 'All peers are installed.'])


@contextmanager
def one_processor() -> Iterator[None]:
    """Keep this process on one processor: some libraries would use more, unasked."""
    if not hasattr(os, 'sched_setaffinity'):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def measure(task: Task, libraries: list[Library], brief: bool) -> dict[int, dict[str, Timing]]:
    """Timings by number of boxes and by library."""
    found = {}
    for size in task.sizes:
        work: Work = make_work(size, task.asked)
        jobs = {
            library.name: getattr(library, task.name)(work)
            for library in libraries
            if hasattr(library, task.name)
        }
        repeats = REPEATS_QUICK if brief else REPEATS
        found[size] = interleaved(jobs, repeats, warm=not brief)
    return found


def table(task: Task, found: dict[int, dict[str, Timing]]) -> Table:
    """One row a library; for each number of boxes the time, and ours over theirs."""
    header = ['library']
    for size in found:
        header += [f'{task.unit}, {size:,} boxes', 'ours / this']
    last = list(found)[-1]
    header += [task.answers] if task.answers else []
    rows: list[list[Cell]] = []
    for name in found[last]:
        row: list[Cell] = [name]
        for timings in found.values():
            ours = timings['bvh_ros'].nanoseconds
            row += [timings[name].nanoseconds, ours / timings[name].nanoseconds]
        row += [found[last][name].answers] if task.answers else []
        rows.append(row)
    return Table(f'peers_{task.name}', header, rows)


INTRODUCTION = '## Peers'
ON_ONE = one_processor()(batches)
SECTIONS = {'all tasks': all_tasks, 'batches of rays': ON_ONE, 'calls': calls}
