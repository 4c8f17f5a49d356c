# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a configuration calls, on throw-away scenes: whoever runs it has the kernels compiled."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros import DynamicBVH
from bvh_ros.scene import Mesh, Numbered, Scene, ShapeKind, Shapes
from bvh_ros.tree.jit.worker import side_by_side

FEW = 256  # rays that go through the snapshot one by one, where there is one
MANY = 4096  # boxes and rays enough that the batch is sorted and cast through a wide snapshot
BOXES = 24  # enough that every branch of building, inserting and rotating runs
EDGE = (0.9, 0.9, 0.9)
ABOUT_Z = (0.0, 0.0, 0.3, 0.9)  # the only way to turn what is seen from above
TURNED = (0.1, 0.2, 0.3, 0.9)
CORNERS = np.vstack((np.zeros(3), np.eye(3)))
TETRAHEDRON = [np.delete(CORNERS, corner, axis=0) for corner in range(4)]  # its faces
# Through boxes, seen from above or not: what writes down a hit is compiled by hitting.
START, GOAL = (0.0, 0.0, 0.0), (60.0, 60.0, 60.0)
RADIUS = 0.5
NUMBERS = np.arange(BOXES)
MIDDLE = np.column_stack((NUMBERS, NUMBERS % 5, NUMBERS % 3)).astype(np.float64)

# What is compiled only when somebody asks.
NEAREST, BALLS, POINTS = 'nearest', 'batches of balls', 'batches of points'
BOXES_ASKED, PATHS = 'batches of boxes', 'paths'
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
        ('obstacles', 11.0, _obstacles),
        ('thin rays', 6.0, _thin_rays),
        ('true shapes', 24.0, _true_shapes),  # and 4 more in a fork
        *([('batches of rays', 8.0, _batches)] if needs.batch else []),
        *([('threads', 1.0, _threads)] if needs.batch and needs.threads > 1 else []),
        *_moving(needs)[:1],
        ('checks', 1.5, _checks),
    ]
    tells_apart = _tells_apart(needs)
    return [
        Job(name, f'{name} {tells_apart}', seconds, partial(call, needs), call in EARLY)
        for name, seconds, call in calls
    ]


def later_jobs(needs: Needs) -> list[Job]:
    """Return what is compiled only when somebody asks."""
    calls: list[tuple[str, float, Callable[[Needs], None]]] = [
        (NEAREST, 8.0, _nearest),
        *([(BALLS, 12.0, _balls), (BOXES_ASKED, 20.0, _boxes_asked)] if needs.batch else []),
        *([(POINTS, 10.0, _points)] if needs.batch else []),
        (PATHS, 20.0, _paths),
        *_moving(needs)[1:],
    ]
    tells_apart = _tells_apart(needs)
    return [
        Job(name, f'{name} {tells_apart}', seconds, partial(call, needs))
        for name, seconds, call in calls
    ]


def _moving(needs: Needs) -> list[tuple[str, float, Callable[[Needs], None]]]:
    """What is called at the start, and once somebody asks, where obstacles have velocities."""
    if not needs.moving:
        return []
    from bvh_ros.ros.moving_jobs import nearest_then, other_times, paths_then

    later = (NEAREST_THEN, 30.0, nearest_then), (PATHS_THEN, 30.0, paths_then)
    return [('other times', 60.0, other_times), *later]


def _tells_apart(needs: Needs) -> tuple[int, ...]:
    """What other kernels are compiled by."""
    kinds = map(int, needs.kinds)
    return needs.planar, needs.margin > 0.0, *kinds, *([-1] if needs.moving else [])


def _nearest(needs: Needs) -> None:
    for scene in scenes(needs):
        scene.nearest(START, 2)


def _balls(needs: Needs) -> None:
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
    for scene in scenes(needs):
        scene.clearance_many(Shapes.boxes([START], EDGE, [ABOUT_Z]), signed=True)


def _empty(needs: Needs) -> Scene:
    return Scene(planar=needs.planar, margin=needs.margin, meshes=ShapeKind.MESH in needs.kinds)


def _replace(scene: Scene, shift: float, numbers: NDArray[np.int64] = NUMBERS) -> None:
    shapes = Shapes.boxes(MIDDLE[numbers] + shift, EDGE)
    scene.replace('cloud', '', Numbered('box#', numbers), shapes, stamp=1)


def _with_boxes(needs: Needs) -> Scene:
    scene = _empty(needs)
    _replace(scene, 0.0)
    return scene


def _with_shapes(needs: Needs) -> Scene:
    """Return turned and round shapes among boxes."""
    scene = _with_boxes(needs)
    for kind in needs.kinds:
        place = [3.0, 3.5 + kind, 3.0]
        if kind == ShapeKind.MESH:
            shape = Shapes.of_meshes([Mesh(TETRAHEDRON)], place, [TURNED])
        else:
            shape = Shapes.boxes(place, EDGE, [TURNED])
            shape = shape._replace(kind=np.array([kind], dtype=np.uint8))
        scene.update('turned', [f'{kind.name}/0'], shape, stamp=3)
    return scene


def scenes(needs: Needs) -> Iterator[Scene]:
    """The empty one first: while another process compiles how boxes get there, what is asked of it
    can be compiled here.
    """
    yield _empty(needs)
    yield _with_boxes(needs)
    yield _with_shapes(needs)


def _obstacles(needs: Needs) -> None:
    """Every way in which obstacles come, move and go, and what is told of them all the time. The
    tree first: it takes longest, and `_thin_rays` compiles meanwhile what else a new box takes.
    """
    boxes = MIDDLE[:, : 2 if needs.planar else 3]
    DynamicBVH(boxes.shape[1]).insert_many(boxes, boxes)
    scene, margin = _with_boxes(needs), needs.margin
    places = [*(MIDDLE + 50.0), MIDDLE[1] - 9.0]
    for number, place in zip([*range(BOXES), 1], places, strict=True):
        scene.update('markers', [f'one/{number}'], Shapes.boxes(place, EDGE), stamp=1)
    _replace(scene, 1.001 * margin + 0.001)  # just out of the fat boxes: they are refitted
    _replace(scene, 3.0 * margin + 7.0)
    scene.remove('markers', ['one/0', 'one/1'])
    if needs.moving:
        place = Shapes.boxes(MIDDLE[0], EDGE)
        scene.update('markers', ['moving'], place, stamp=1, velocities=[EDGE])
    scene.rebuild()
    scene.stats()
    _with_shapes(needs)


def _thin_rays(needs: Needs) -> None:
    scene = _empty(needs)
    scene.raycast(START, GOAL)
    _replace(scene, 0.0, NUMBERS[:0])


def _true_shapes(needs: Needs) -> None:
    """Balls first: rays alone, or overlaps, would take three times as long in a process that has
    not compiled balls, most of which they share.
    """
    _swept_balls(needs)
    side_by_side(partial(_overlaps, needs), partial(_rays_at_shapes, needs))


def _rays_at_shapes(needs: Needs) -> None:
    for scene in scenes(needs):
        scene.raycast_all(START, GOAL)
        scene.raycast(START, GOAL)


def _swept_balls(needs: Needs) -> None:
    for scene in scenes(needs):
        scene.raycast_all(START, GOAL, RADIUS)
        scene.raycast(START, GOAL, RADIUS)


def _overlaps(needs: Needs) -> None:
    """Of a box, a turned one with round corners, and a ball."""
    far = (9.0, 9.0, 9.0)
    for scene in scenes(needs):
        scene.overlap(START, far)
        scene.overlap(START, far, ABOUT_Z, RADIUS)
        scene.overlap((3.0,) * 3, (3.0,) * 3, ABOUT_Z, 2.0)


def _checks(needs: Needs) -> None:
    _with_boxes(needs).validate()


def _batches(needs: Needs) -> None:
    """Cast a batch of each size that the tree answers in a way of its own."""
    scene = Scene(planar=needs.planar, margin=needs.margin)
    line = np.arange(MANY * 3.0).reshape(MANY, 3)
    scene.raycast_many(line[:1], line[:1])
    scene.replace(
        'cloud', '', Numbered('box#', np.arange(MANY)), Shapes.boxes(line, EDGE), stamp=1
    )
    for count in (1, MANY, FEW):  # the snapshot is there once many were asked
        scene.raycast_many(line[:count], line[:count])


def _threads(needs: Needs) -> None:
    """Count the rays of a batch that several threads have answered."""
    line = MIDDLE[:, : 2 if needs.planar else 3]
    DynamicBVH(line.shape[1]).raycast_many(line, line, threads=2)


def use_tree(ndim: int) -> None:
    """What a tree without a scene is asked."""
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


EARLY = _obstacles, _thin_rays
