# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a configuration compiles: calls on throw-away scenes that need its kernels."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros import DynamicBVH
from bvh_ros.ros.cdr import path
from bvh_ros.scene import Mesh, NodeScene, Numbered, ShapeKind, Shapes
from bvh_ros.scene.cast.arguments import THIN, Hits, Rays, world_of
from bvh_ros.scene.cast.batch import first_hits
from bvh_ros.scene.cast.query import described
from bvh_ros.scene.distance.narrow_phase import hull_gap
from bvh_ros.scene.names import Registry, as_families
from bvh_ros.scene.shapes.hull import Hull
from bvh_ros.scene.store import Obstacles
from bvh_ros.tree.access import inherit_entry
from bvh_ros.tree.compiler import prepare


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
    any_mesh : bool
        Whether meshes may be of any form, not only convex.
    """

    planar: bool
    margin: float
    kinds: Sequence[ShapeKind]
    batch: bool
    threads: int = 1
    moving: bool = False
    any_mesh: bool = False


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


MANY = 4096  # boxes and rays enough that the batch is sorted and cast through a wide snapshot
BOXES = 24  # enough that every branch of building, inserting and rotating runs
EDGE = (0.9, 0.9, 0.9)
ABOUT_Z = (0.0, 0.0, 0.3, 0.954)  # the only way to turn what is seen from above
TURNED = (0.1, 0.3, 0.3, 0.9)
CORNERS = np.vstack((np.zeros(3), np.eye(3)))
TETRAHEDRON = [np.delete(CORNERS, corner, axis=0) for corner in range(4)]  # its faces
# Through boxes, seen from above or not: what writes down a hit is compiled by hitting.
START, GOAL = (0.0, 0.0, 0.0), (60.0, 60.0, 60.0)
FAR = (9.0, 9.0, 9.0)
RADIUS = 0.5
NUMBERS = np.arange(BOXES)
MIDDLE = np.column_stack((NUMBERS, NUMBERS % 5, NUMBERS % 3)).astype(np.float64)


def empty(needs: Needs) -> NodeScene:
    """A scene in which moving obstacles come to rest."""
    return NodeScene(
        planar=needs.planar,
        margin=needs.margin,
        meshes=ShapeKind.MESH in needs.kinds,
        any_mesh=needs.any_mesh,
        max_prediction=1.0,
    )


def replace(scene: NodeScene, shift: float, numbers: NDArray[np.int64] = NUMBERS) -> None:
    shapes = Shapes.boxes(MIDDLE[numbers] + shift, EDGE)
    scene.replace('cloud', '', Numbered('box#', numbers), shapes, stamp=1)


def with_boxes(needs: Needs) -> NodeScene:
    scene = empty(needs)
    replace(scene, 0.0)
    return scene


def with_shapes(needs: Needs) -> NodeScene:
    """Return turned and round shapes among boxes."""
    scene = with_boxes(needs)
    for kind in needs.kinds:
        place = [3.0, 3.5 + kind, 3.0]
        if kind == ShapeKind.MESH:
            shape = Shapes.of_meshes([Mesh(TETRAHEDRON)], place, [TURNED])
        else:
            shape = Shapes.boxes(place, EDGE, [TURNED])
            shape = shape._replace(kind=np.array([kind], dtype=np.uint8))
        scene.update('turned', [f'{kind.name}/0'], shape, stamp=3)
    return scene


def scenes(needs: Needs) -> Iterator[NodeScene]:
    """The empty one first: while another process compiles how boxes get there, its queries are
    compiled here.
    """
    yield empty(needs)
    yield with_boxes(needs)
    yield with_shapes(needs)


def use_tree(ndim: int) -> None:
    """Queries of a tree without a scene."""
    tree = DynamicBVH(ndim=ndim)
    low, high = np.zeros(ndim), np.ones(ndim)
    handle = tree.insert(low, high)
    tree.raycast(low - 1.0, high)
    tree.move(handle, low + 1.0, high + 1.0)
    boxes = MIDDLE[:, :ndim]
    handles = tree.insert_many(boxes, boxes + 0.9)
    tree.move_many(handles, boxes + 0.1, boxes + 1.0)
    tree.raycast_all(low, high)
    tree.raycast_many(boxes, boxes)
    tree.overlap(low, high)
    tree.overlap_pairs()
    tree.nearest(low, 2)
    tree.boxcast(low, high, high)
    tree.remove(handle)
    tree.remove_many(handles)


# Jobs for all shapes share most of what they compile. Each compiles what it can before it needs a
# scene with shapes: another process compiles meanwhile how shapes get there.


def _distances_of_meshes(needs: Needs) -> None:
    """The longest part that all share. Begun first, it is there when they come to it."""
    vector = np.zeros(3)
    prepare(hull_gap, Hull(CORNERS, CORNERS[None], 1.0), vector, vector, vector)
    if needs.any_mesh:
        fine = [np.add(face, 8.0 * k) for k in range(8) for face in TETRAHEDRON]
        _ = Mesh(fine).tree  # with the snapshot that many triangles have


def _rays(needs: Needs) -> None:
    """Balls, and thin rays at shapes, which the same kernel answers."""
    for scene in scenes(needs):
        scene.raycast(START, GOAL, RADIUS)
        scene.raycast_all(START, GOAL, RADIUS)


def _overlaps(needs: Needs) -> None:
    """Of a turned box with round corners, a ball, and a box, which is compiled elsewhere."""
    for scene in scenes(needs):
        scene.overlap(START, FAR, ABOUT_Z, RADIUS)
        scene.overlap((3.0,) * 3, (3.0,) * 3, ABOUT_Z, 2.0)
        scene.overlap(START, FAR)


def _hits(needs: Needs) -> None:
    """Where rays and balls hit shapes."""
    store, point = _no_shapes(needs), np.zeros(3)
    segment = (point[: store.tree.ndim],) * 2
    none = Hits(np.empty(0, np.int64), np.empty(0), np.empty(0, np.int64))
    described(world_of(store.tree, store.columns), segment, 0.0, none, point)


def _batches_of_rays(needs: Needs) -> None:
    """Rays at shapes, and all balls."""
    store, row = _no_shapes(needs), np.zeros((1, 3))
    rays = Rays(row, row, np.ones(1), np.ones(1, np.uint32), THIN, False, False, False)
    first_hits(store.tree, store.columns, rays)
    with_shapes(needs).raycast_many([START], [GOAL])


def _no_shapes(needs: Needs) -> Obstacles:
    """What would hold shapes: where there are none, a scene asks its tree."""
    meshes = ShapeKind.MESH in needs.kinds
    return Obstacles(needs.planar, needs.margin, meshes, 1, needs.any_mesh)


# Jobs for sources that predict.

LATER = 10**10  # ns: by then all obstacles are at rest


def _moving_scenes(needs: Needs) -> Iterator[NodeScene]:
    """Some that hold obstacles, one of which has a velocity."""
    for scene in scenes(needs):
        shape = Shapes.boxes(GOAL, EDGE)
        scene.update('moving', ['one'], shape, stamp=1, velocities=[EDGE])
        yield scene


def other_times(needs: Needs) -> None:
    """Rays, balls and overlaps at a time, and while it passes."""
    for scene in _moving_scenes(needs):
        for radius in (0.0, RADIUS):
            scene.raycast(START, GOAL, radius, at=2, until=3)
            scene.raycast(START, GOAL, radius, at=2, until=LATER)
            scene.raycast_all(START, GOAL, radius, at=2)
        scene.overlap(START, GOAL, ABOUT_Z, RADIUS, at=2)
        if needs.batch:
            scene.raycast_many([START], [GOAL], 1.0, at=2, until=3)
    if needs.batch:
        _rays_among_boxes(needs)


def _rays_among_boxes(needs: Needs) -> None:
    """So many that boxes are swept for them, and for balls, as for rays among other shapes."""
    scene, line = next(scenes(needs)), np.arange(MANY * 3.0).reshape(MANY, 3)
    names = Numbered('box#', np.arange(MANY))
    speeds = np.ones((MANY, 3))
    scene.replace('cloud', '', names, Shapes.boxes(line, EDGE), stamp=1, velocities=speeds)
    for radius in (0.0, RADIUS):
        for until in (3, LATER):
            scene.raycast_many(line, line, 1.0, radius=radius, at=2, until=until)
    scene.raycast_many(line, line, 1.0, at=np.full(MANY, 2), until=until)


def nearest_then(needs: Needs) -> None:
    """What is nearest at a time."""
    for scene in _moving_scenes(needs):
        scene.nearest(START, 2, at=2)


def paths_then(needs: Needs) -> None:
    """How far a shape is at a time."""
    for scene in _moving_scenes(needs):
        shapes = Shapes.boxes([START], EDGE, [ABOUT_Z])
        scene.clearance_many(shapes, signed=True, at=2)


# The jobs of a configuration.

FEW = 128  # rays that go through the snapshot one by one, where there is one

# Queries that are compiled on first use.
NEAREST, POINTS = 'nearest', 'batches of points'
BOXES_ASKED, CLEARANCES = 'batches of boxes', 'distances of shapes'
NEAREST_THEN, PATHS_THEN = 'nearest at other times', 'paths at other times'
SWEEPS = 'sweeps of shapes'


# Whether it is needed, the name, the seconds and the call of a `Job`.
Call = tuple[bool, str, float, Callable[[Needs], None]]


def jobs(needs: Needs) -> list[Job]:
    """Return all calls: those that the first answers wait for, then the longest."""
    batch, meshes = needs.batch, ShapeKind.MESH in needs.kinds and not needs.planar
    calls: list[Call] = [
        (True, 'obstacles', 9.0, _obstacles),
        (True, 'thin rays', 6.0, _thin_rays),
        (True, 'names', 1.5, _names),
        (batch, 'batches of rays', 8.0, _batches),
        (meshes, 'distances of meshes', 5.0, _distances_of_meshes),
        (True, 'rays and balls', 13.0, _rays),
        (True, 'hits', 2.0, _hits),
        (True, 'overlaps', 6.0, _overlaps),
        (True, 'boxes', 3.0, _among_boxes),
        (batch and needs.threads > 1, 'threads', 1.0, _threads),
        (batch, 'batches of rays at shapes', 4.0, _batches_of_rays),
        (needs.moving, 'other times', 70.0, other_times),
        (True, 'checks', 1.5, _checks),
    ]
    return _needed(calls, needs)


def later_jobs(needs: Needs) -> list[Job]:
    """Return the jobs of queries that are compiled on first use."""
    calls: list[Call] = [
        (True, NEAREST, 8.0, _nearest),
        (needs.batch, BOXES_ASKED, 20.0, _boxes_asked),
        (needs.batch, POINTS, 10.0, _points),
        (needs.batch, CLEARANCES, 20.0, _paths),
        (needs.batch, SWEEPS, 20.0, _sweeps),
        (needs.moving, NEAREST_THEN, 30.0, nearest_then),
        (needs.moving, PATHS_THEN, 30.0, paths_then),
    ]
    return _needed(calls, needs)


def path_jobs(needs: Needs, *, meshes: bool = False, between: bool = False) -> list[Job]:
    """Return what paths need: compiled at the start, where there is a footprint. `meshes`: that is
    a polygon; `between`: poses are connected by sweeps.
    """
    paths, sweeps = ('paths of polygons', 'sweeps of polygons') if meshes else ('paths', SWEEPS)
    calls: list[Call] = [
        (True, paths, 20.0, partial(_paths, polygon=meshes)),
        (between, sweeps, 20.0, partial(_sweeps, polygon=meshes)),
    ]
    return _needed(calls, needs)


def _needed(calls: Sequence[Call], needs: Needs) -> list[Job]:
    tells_apart = _tells_apart(needs)
    return [
        Job(name, f'{name} {tells_apart}', seconds, partial(call, needs), call in EARLY)
        for is_needed, name, seconds, call in calls
        if is_needed
    ]


def _tells_apart(needs: Needs) -> tuple[int, ...]:
    """What other kernels are compiled by."""
    kinds = map(int, needs.kinds)
    more = [*([-1] if needs.moving else []), *([-2] if needs.any_mesh else [])]
    return needs.planar, needs.margin > 0.0, *kinds, *more


def _nearest(needs: Needs) -> None:
    for scene in scenes(needs):
        scene.nearest(START, 2)


def _boxes_asked(needs: Needs) -> None:
    for scene in scenes(needs):
        scene.overlap_many([START], EDGE, want='hits')
        scene.overlap_many([START], EDGE, [ABOUT_Z], RADIUS, want='hits')


def _points(needs: Needs) -> None:
    for scene in scenes(needs):
        scene.nearest_many([START])
        scene.nearest_many([START] * 1000)  # answered in the order of neighbours


def _paths(needs: Needs, polygon: bool = False) -> None:
    path.read(path.EMPTY)
    for scene in scenes(needs):
        scene.clearance_many(_footprint(polygon), signed=True)


def _footprint(polygon: bool) -> Shapes:
    if polygon:
        return Shapes.of_meshes([Mesh(TETRAHEDRON)], [START])
    return Shapes.boxes([START], EDGE, [ABOUT_Z])


def _sweeps(needs: Needs, polygon: bool = False) -> None:
    shape = _footprint(polygon)
    for scene in _moving_scenes(needs) if needs.moving else scenes(needs):
        given = shape, [START], [ABOUT_Z], [FAR], [TURNED]
        scene.sweep_shape_many(*given)
        if needs.moving:
            scene.sweep_shape_many(*given, at=2, until=3)


def _obstacles(needs: Needs) -> None:
    """All that adds, moves and removes obstacles, and the figures that diagnostics read. The
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
    """Names, and figures of a tree, without a box in it."""
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
    scene = NodeScene(planar=needs.planar, margin=needs.margin)
    line = np.arange(MANY * 3.0).reshape(MANY, 3)
    scene.raycast_many(line[:1], line[:1])
    scene.replace(
        'cloud', '', Numbered('box#', np.arange(MANY)), Shapes.boxes(line, EDGE), stamp=1
    )
    for count in (1, MANY, FEW):  # the snapshot is there after many rays
        scene.raycast_many(line[:count], line[:count])


def _threads(needs: Needs) -> None:
    """Count the rays of a batch that several threads have answered, each some of them."""
    from bvh_ros.tree.access import few_entry

    line = MIDDLE[:, : 2 if needs.planar else 3]
    few_entry(line.shape[1])
    DynamicBVH(line.shape[1]).raycast_many(line, line, threads=2)


EARLY = _obstacles, _thin_rays, _names
