# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Other libraries on the same work in the same run."""

from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.util import find_spec
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from .. import DynamicBVH
from ..scene import Mesh, Scene, Shapes
from . import scenes
from .libraries import (
    COAL,
    EMBREE,
    LIBRARIES,
    OURS,
    CoalMesh,
    Library,
    Rows,
    closest_points_job,
    collision_objects,
    embree_scene,
)
from .page import BLUE, ORANGE, RED, Cell, Page
from .scenes import EDGE, Boxes, Floats, Queries, Rays
from .timing import Job, each, interleaved, one_processor, repeated

# ---- All libraries on the same work


SOME = 32  # one box in so many jumps in the task `move_some`


class Work(NamedTuple):
    """One scene and what is queried; the same for every library."""

    boxes: Boxes
    rays: Rays
    small: Boxes  # each overlaps half a box on average
    points: Floats  # (m, 3), for the nearest centre of a box
    away: Boxes  # all boxes, up to one edge away
    jumps: list[tuple[Rows, Boxes]]  # one box in 32, each time others, somewhere else in the cube


def make_work(count: int, queries: int) -> Work:
    """Make a scene of `count` boxes, and so many rays, small boxes and points."""
    rng = np.random.default_rng(0)
    boxes, rays = scenes.uniform_boxes(count, rng), scenes.incoherent_rays(queries, rng)
    corner, points = scenes.spread(queries, rng), scenes.spread(queries, rng)
    away = boxes.moved(rng.uniform(-1, 1, boxes.lo.shape) * boxes.edges)
    jumps = []
    for _ in range(8):
        rows = np.sort(rng.choice(count, max(1, count // SOME), replace=False))
        half, centers = boxes.edges[rows] / 2, scenes.spread(len(rows), rng)
        jumps.append((rows, Boxes(centers - half, centers + half)))
    return Work(
        boxes, rays, Boxes(corner, corner + scenes.query_edge(boxes, 0.5)), points, away, jumps
    )


class Task(NamedTuple):
    """One kind of work."""

    name: str  # of the table, and in `job_of`
    needs: str  # what a library must offer
    title: str
    unit: str  # what a figure is a time of
    answers: str = ''  # what was counted, to see that all gave the same answer
    queries: int = 1  # rays, boxes or points
    sizes: tuple[int, ...] = (10_000,)


GROWING = (1_000, 10_000, 100_000)
FRAME = 'Move all boxes a little, then 1,000 rays'
TASKS = (
    Task('cast', 'cast', 'Cast rays: the first box on each', 'ns a ray', 'hits', 20_000, GROWING),
    Task('frame', 'cast', FRAME, 'ns a frame', 'hits', 1_000),
    Task('move_all', 'mover', 'Move all boxes a little', 'ns a box'),
    Task('move_some', 'mover', 'Move 1 box in 32 to anywhere', 'ns a box'),
    Task('build', 'build', 'Build from nothing', 'ns a box', 'boxes'),
    Task('overlap', 'overlap', 'Overlaps of a small box', 'ns a query', 'hits', 20_000),
    Task('pairs', 'pairs', 'All pairs of boxes that overlap', 'ns a box', 'pairs'),
    Task('nearest', 'nearest', 'Nearest of many points', 'ns a query', 'mm in sum', 20_000),
)


def job_of(task: str, library: Library, work: Work) -> Job:
    """A task of a library. What makes its own form of boxes and rays is not timed."""
    form, rays = library.prepare(work.boxes), library.rays(work.rays)
    scene, count = library.build(form), len(work.boxes.lo)
    states, jumps = cycle((work.away, work.boxes)), cycle(work.jumps)
    match task:
        case 'cast':
            return Job(lambda: library.cast(scene, rays), len(work.rays.origins), _count_hits)
        case 'frame' if library.mover is None:
            forms = cycle([library.prepare(work.away), form])
            return Job(lambda: library.cast(library.build(next(forms)), rays), 1, _count_hits)
        case 'frame':
            move = library.mover(scene)

            def move_and_cast() -> Any:
                move(None, next(states))
                return library.cast(scene, rays)

            return Job(move_and_cast, 1, _count_hits)
        case 'move_all':
            move = library.mover(scene)
            return Job(lambda: move(None, next(states)), count)
        case 'move_some':
            move = library.mover(scene)
            return Job(lambda: move(*next(jumps)), len(work.jumps[0][0]))
        case 'build':
            return Job(lambda: library.build(form), count, library.size)
        case 'overlap':
            small = library.prepare(work.small)
            return Job(lambda: library.overlap(scene, small), len(work.small.lo), int)
        case 'pairs':
            return Job(lambda: library.pairs(scene), count, int)
    centers = work.boxes.centers  # a point is a box without extent
    scene = library.build(library.prepare(Boxes(centers, centers)))
    return Job(lambda: library.nearest(scene, work.points), len(work.points), _millimetres)


def _count_hits(ids: Any) -> int:
    return int(np.count_nonzero(ids >= 0))


def _millimetres(distances: Floats) -> int:
    """Equal only if the same points were found."""
    return round(float(np.sum(distances)) * 1e3)


REPEATS, REPEATS_QUICK = 15, 3


def all_tasks(page: Page, brief: bool) -> None:
    """Boxes of random proportions that fill 2 % of a cube of 100 m; rays from anywhere to
    anywhere. One processor. The libraries take turns, each with untimed runs for 10 ms before the
    timed one, and the medians of the turns are shown. *ours / this* below 1: bvh_ros is faster.
    """
    libraries = [library for library in LIBRARIES if library.installed()]
    absent = [library.name for library in LIBRARIES if not library.installed()]
    page.add('\n'.join(f'- **{library.name}**: {library.note}.' for library in libraries))
    page.add(
        f'Not installed here, and so left out: {", ".join(absent)}.'
        if absent
        else 'All peers are installed.'
    )
    for task in TASKS:
        _measure(page, task, libraries, brief)


def _measure(page: Page, task: Task, libraries: list[Library], brief: bool) -> None:
    """One row a library; for each number of boxes the time, and ours over theirs."""
    able = [library for library in libraries if getattr(library, task.needs) is not None]
    header, rows = ['library'], {library.name: list[Cell]([library.name]) for library in able}
    for size in (300,) if brief else task.sizes:
        work = make_work(size, min(task.queries, 200) if brief else task.queries)
        jobs = {library.name: job_of(task.name, library, work) for library in able}
        found = interleaved(jobs, REPEATS_QUICK if brief else REPEATS)
        header += [f'{task.unit}, {size:,} boxes', 'ours / this']
        for name, timing in found.items():
            ratio = found[OURS.name].nanoseconds / timing.nanoseconds
            rows[name] += [timing.nanoseconds, ratio]
    if task.answers:
        header.append(task.answers)
        for name, timing in found.items():
            rows[name].append(timing.answers)
    page.add(f'**{task.title}**')
    page.table(f'peers_{task.name}', header, [*rows.values()])


# ---- Batches of rays of every size and kind, compared with Embree


BATCH_BOXES = 1_000, 10_000, 100_000
BATCH_SIZES = 1, 4, 15, 16, 64, 255, 256, 1_024, 4_096, 20_000, 100_000
BATCH_RAYS, TURNS, BATCH_REPEATS = 200_000, 4_096, 9
LIDAR, PLANE = (64, 512), (1, 681)  # rows and beams a row of a scan
SCAN_PLACES = 0.2, 0.3, 0.4, 0.5  # m, on the cube's diagonal
ANYWHERE = 'from anywhere'
PEERS = {'bvh_ros': BLUE, 'Embree': RED, 'Embree, triangle alone': ORANGE}


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
    origins, directions = scenes.incoherent_rays(
        200 if brief else BATCH_RAYS, np.random.default_rng(3)
    )
    beyond = np.add(origins, (0.0, 0.0, 2.0 * EDGE))
    kinds = {
        ANYWHERE: Batch(origins, directions),
        'segments of 1 m': Batch(origins, directions, 1.0),
        'segments of 5 m': Batch(origins, directions, 5.0),
        'all miss': Batch(beyond, np.abs(directions)),
    }
    for count in (1, 20) if brief else BATCH_SIZES:
        rows = range(0, min(len(origins), TURNS * count) - count + 1, count)
        slices = [slice(row, row + count) for row in rows]
        for kind, rays in kinds.items():
            yield (kind, [Batch(rays.origins[k], rays.directions[k], rays.t_max) for k in slices])
    for kind, shape in (('lidar scan', LIDAR), ('scan in a plane', PLANE)):
        yield kind, [scan(*((2, 10) if brief else shape), place) for place in SCAN_PLACES]


def batches(page: Page, brief: bool) -> None:
    """One call with so many rays, input checks included, other rays each time: a processor learns
    rays that are repeated. bvh_ros takes float64 and returns id, distance and normal, as Embree
    does from float32 arrays that are ready (`run(..., output=True)`); the *triangle alone* is what
    its default query returns.
    """
    if not EMBREE.installed():
        page.add('Embree is not installed here, and so batches of rays are left out.')
        return
    rows: list[list[Cell]] = []
    for size in (300,) if brief else BATCH_BOXES:
        boxes = scenes.uniform_boxes(size, np.random.default_rng(0))
        tree, scene = DynamicBVH.from_boxes(*boxes), EMBREE.build(EMBREE.prepare(boxes))
        tree.raycast_many(*scenes.incoherent_rays(max(size, 100), np.random.default_rng(1)))
        for kind, turns in every_batch(brief):
            times = _batch_times(tree, scene, turns, brief)
            ratios = [times[0] / time for time in times[1:]]
            rows.append([size, kind, len(turns[0].origins), *times, *ratios])
    columns = [f'{name}, us' for name in PEERS]
    columns += [f'ours / {name}' for name in [*PEERS][1:]]
    page.table('peers_batches', ['boxes', 'rays', 'in a batch', *columns], rows)
    _plot_batches(page, rows)


def _batch_times(tree: DynamicBVH, scene: Any, turns: list[Batch], brief: bool) -> list[float]:
    """Microseconds a call, in the order of `PEERS`."""
    reach, ours = turns[0].t_max if np.isfinite(turns[0].t_max) else None, cycle(turns)
    theirs = cycle([[np.float32(part) for part in turn[:2]] for turn in turns])
    runs = (
        lambda: tree.raycast_many(*next(ours)),
        lambda: scene.run(*next(theirs), dists=reach, output=True),
        lambda: scene.run(*next(theirs), dists=reach),
    )
    jobs = {name: repeated(Job(run, 1)) for name, run in zip(PEERS, runs, strict=True)}
    found = interleaved(jobs, 3 if brief else BATCH_REPEATS)
    return [found[name].microseconds for name in PEERS]


def _plot_batches(page: Page, rows: list[list[Any]]) -> None:
    from matplotlib.figure import Figure

    sizes = list(dict.fromkeys(row[0] for row in rows))
    figure = Figure(figsize=(4.6 * len(sizes), 3.4), layout='constrained')
    panels = figure.subplots(1, len(sizes), squeeze=False, sharey=True)[0]
    for axes, size in zip(panels, sizes, strict=True):
        points = np.array([row[2:6] for row in rows if row[:2] == [size, ANYWHERE]])
        counts = points[:, 0]
        for column, (name, colour) in enumerate(PEERS.items(), 1):
            axes.plot(counts, points[:, column] / counts, 'o-', color=colour, label=name)
        axes.set(xscale='log', yscale='log', xlabel='rays in a batch', title=f'{size:,} boxes')
        axes.xaxis.set_major_formatter('{x:,.0f}')
        axes.yaxis.set_major_formatter('{x:g}')
        axes.yaxis.set_minor_formatter('')
        axes.grid(alpha=0.3, which='both')
    panels[0].set_ylabel('us a ray')
    panels[0].legend(frameon=False)
    page.picture('peers_batches', 'Time a ray against rays in a batch, from anywhere', figure)


# ---- The full cost of one call from Python, compared with a peer


CALL_BOXES, CALLS, CALL_REPEATS = 10_000, 500, 9
STEP = 0.01  # m that an obstacle goes


def calls(page: Page, brief: bool) -> None:
    """10,000 boxes, one call after the other, us a call with all that it takes: input checked, in
    a scene names looked up, points and normals of the hits. coal returns the pairs of the same
    box, without names, points or normals, or moves the same box; Embree returns the triangle
    alone. *move* is to a place nearby and back.
    """
    size, count, repeats = (300, 20, 3) if brief else (CALL_BOXES, CALLS, CALL_REPEATS)
    rng = np.random.default_rng(1)
    boxes, (starts, directions) = (
        scenes.uniform_boxes(size, rng),
        scenes.incoherent_rays(count, rng),
    )
    corner, goals = scenes.spread(count, rng), starts + EDGE * directions
    small = Boxes(corner, corner + scenes.query_edge(boxes, 0.5))
    queries = Queries(starts, directions, goals, np.inf, small, small.edges, 0.0, count, [1])
    tree, names = DynamicBVH.from_boxes(*boxes), [str(row) for row in range(size)]
    scene = scenes.scene_of(Shapes.boxes(boxes.centers, boxes.edges))
    rooms = {
        'tree': scenes.of_tree(tree, queries),
        'scene': scenes.of_scene(scene, names, queries),
    }
    ours = {f'{room}: {name}': job for room, some in rooms.items() for name, job in some.items()}
    ours |= _changes(boxes, count, scene, names)
    rows = rows_with_peers(ours, _peer_jobs(boxes, queries), repeats)
    page.table(
        'peers_calls', ['call', 'us a call', 'peer', 'us a call there', 'ours / peer'], rows
    )


Peers = dict[str, tuple[str, Job]]  # name of the peer and job, by the name of our call


def rows_with_peers(ours: dict[str, Job], peers: Peers, repeats: int) -> list[list[Cell]]:
    """For each of our jobs a row: name, us, the peer's name, us there, and ours over that."""
    theirs = {f'{name} of a peer': job for name, (_, job) in peers.items()}
    found = interleaved(ours | theirs, repeats)
    rows: list[list[Cell]] = []
    for name in ours:
        time = found[name].microseconds
        rows.append([name, time, '', None, None])
        if name in peers:
            there = found[f'{name} of a peer'].microseconds
            rows[-1][2:] = [peers[name][0], there, time / there]
    return rows


def _changes(boxes: Boxes, count: int, scene: Scene, names: list[str]) -> dict[str, Job]:
    """Changes of a tree and of a scene, by name."""
    tree, centers, edges = DynamicBVH.from_boxes(*boxes), boxes.centers, boxes.edges
    handles, shifts = tree.ids()[:count].tolist(), cycle((STEP, 0.0))
    few = Boxes(boxes.lo[:count], boxes.hi[:count])

    def move() -> None:
        for handle, low, high in zip(handles, *few.moved(next(shifts)), strict=True):
            tree.move(handle, low, high)

    def insert_and_remove() -> None:
        for handle in [tree.insert(*box) for box in zip(*few, strict=True)]:
            tree.remove(handle)

    def updates(many: int) -> Job:
        """Runs of rows that go a step, and back in the next turn."""
        runs = [slice(row, row + many) for row in range(min(count, len(names) - many))]
        parts = [
            [(names[run], Shapes.boxes(centers[run] + step, edges[run])) for run in runs]
            for step in (STEP, 0.0)
        ]
        turns = cycle(parts)

        def run() -> None:
            for some, shapes in next(turns):
                scene.update('report', some, shapes, stamp=1)

        return Job(run, len(runs))

    return {
        'tree: move': Job(move, count),
        'tree: insert and remove': Job(insert_and_remove, count),
        'scene: update of one': updates(1),
        'scene: update of ten': updates(10),
    }


def _peer_jobs(boxes: Boxes, queries: Queries) -> Peers:
    """What installed peers have of the kind."""
    found: Peers = {}
    if EMBREE.installed():
        rays = [part.astype(np.float32)[:, None] for part in queries[:2]]
        found['tree: raycast'] = 'Embree', each(EMBREE.build(EMBREE.prepare(boxes)).run, *rays)
    if not COAL.installed():
        return found
    broad, small = COAL.build(COAL.prepare(boxes)), COAL.prepare(queries.small)
    states = cycle((STEP, 0.0))

    def update() -> None:
        places = boxes.centers + next(states)
        for item, center in zip(broad.objects[: len(small)], places, strict=False):
            item.setTranslation(center)
            item.computeAABB()
            broad.manager.update()

    for room, changed in (('tree', 'move'), ('scene', 'update of one')):
        found[f'{room}: overlap'] = 'coal', each(lambda item: broad.overlaps([item]), small)
        found[f'{room}: {changed}'] = 'coal', Job(update, len(small))
    return found


# ---- Meshes that are not convex


GRIDS = (32, 20), (320, 128)  # fields of the ring: 1,280 and 81,920 triangles
MESH_RAYS, MESH_QUERIES, MESH_REPEATS = 20_000, 1_000, 9
BALL, POSES = 0.1, 1_000  # m; obstacles that share a mesh


def meshes(page: Page, brief: bool) -> None:
    """A solid ring with waves, 2.9 m across: random rays from 3 m away to anywhere in the box
    around it, as Embree answers them with triangle, u, v and t; balls of 0.1 m on such rays;
    points in a box three times as large; boxes and balls up to 2 m away, which coal is asked for
    one by one from Python. Of *new poses*, 1,000 obstacles share the mesh, beside as many turned
    boxes.
    """
    count, queries, repeats = (50, 20, 3) if brief else (MESH_RAYS, MESH_QUERIES, MESH_REPEATS)
    rows: list[list[Cell]] = []
    for grid in ((8, 6),) if brief else GRIDS:
        vertices, faces = scenes.wavy_ring(*grid)
        found = rows_with_peers(*_mesh_jobs(vertices, faces, count, queries), repeats)
        rows += [[len(faces), *row] for row in found]
    columns = ['triangles', 'work', 'us', 'beside', 'us there', 'ours / this']
    page.table('peers_meshes', columns, rows)


def _mesh_jobs(
    vertices: Floats, faces: Any, count: int, queries: int
) -> tuple[dict[str, Job], Peers]:
    """The work on a mesh."""
    rng, mesh, extent = np.random.default_rng(0), Mesh(vertices, faces), abs(vertices).max(axis=0)
    scene = scenes.scene_of(Shapes.of_meshes(mesh, np.zeros((1, 3))))
    origins = 3.0 * scenes.units(rng.normal(size=(count, 3)))
    directions = rng.uniform(-extent, extent, (count, 3)) - origins
    some = slice(0, queries)
    points, centres = rng.uniform(-3, 3, (2, queries, 3)) * extent
    centres = scenes.units(centres) * rng.uniform(1.5, 3.5, (queries, 1))
    turns = scenes.units(rng.normal(size=(queries, 4)))
    edges = np.full((queries, 3), 0.3)
    boxes = Shapes.boxes(centres, edges, turns)
    balls = Shapes.spheres(centres, np.full(queries, 0.2))
    posed = _pose_job(lambda at, turn: Shapes.of_meshes(mesh, at, turn), rng)
    boxed = _pose_job(lambda at, turn: Shapes.boxes(at, np.full((POSES, 3), 1.0), turn), rng)
    jobs = {
        'ray': Job(lambda: scene.raycast_many(origins, directions), count),
        'swept ball': Job(
            lambda: scene.raycast_many(origins[some], directions[some], 1.0, radius=BALL), queries
        ),
        'nearest': Job(lambda: scene.nearest_many(points), queries),
        'clearance of a turned box': Job(lambda: scene.clearance_many(boxes), queries),
        'clearance of a ball': Job(lambda: scene.clearance_many(balls), queries),
        'overlap of a turned box': Job(lambda: scene.overlap_many(centres, edges, turns), queries),
        'build': Job(lambda: Mesh(vertices, faces).tree, 1),
        'new pose': posed,
    }
    peers = {'new pose': ('new pose, turned box', boxed)}
    if EMBREE.installed():
        theirs = vertices.astype(np.float32), faces
        peer, rays = embree_scene(theirs), EMBREE.rays(Rays(origins, directions))
        peers['ray'] = 'ray, Embree', Job(lambda: peer.run(*rays, output=True), count)
        peers['build'] = 'build, Embree', Job(lambda: embree_scene(theirs), 1)
    if COAL.installed():
        other, coal = CoalMesh(vertices, faces), import_module('coal')
        poses = Rotation.from_quat(turns).as_matrix(), centres
        cubes, spheres = (
            collision_objects('coal', [form] * queries, *poses)
            for form in (coal.Box(0.3, 0.3, 0.3), coal.Sphere(0.2))
        )
        peers |= {
            'clearance of a turned box': (
                'distance, coal',
                Job(lambda: other.distances(cubes), queries),
            ),
            'clearance of a ball': (
                'distance, coal',
                Job(lambda: other.distances(spheres), queries),
            ),
            'overlap of a turned box': (
                'collide, coal',
                Job(lambda: other.touches(cubes), queries),
            ),
        }
    if find_spec('open3d') is not None:
        closest = closest_points_job(vertices, faces, points)
        peers['nearest'] = 'closest points, Open3D', Job(closest, queries)
    return jobs, peers


def _pose_job(shapes: Callable[[Floats, Floats], Shapes], rng: np.random.Generator) -> Job:
    """New poses for all of many obstacles."""
    scene, names = Scene(), [f'one{row}' for row in range(POSES)]
    poses = [
        (scenes.spread(POSES, rng), scenes.units(rng.normal(size=(POSES, 4)))) for _ in range(4)
    ]
    turns = cycle([shapes(*pose) for pose in poses])

    def run() -> None:
        scene.update('report', names, next(turns), stamp=0)

    return Job(run, POSES)


SECTIONS = {
    'The same work': one_processor()(all_tasks),
    'Batches of rays': one_processor()(batches),
    'Calls': calls,
    'Meshes': one_processor()(meshes),
}
