# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compile the kernels that a configuration needs before its services appear."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bvh_ros.scene import Mesh, Numbered, Scene, ShapeKind, Shapes

MANY = 4096  # boxes and rays enough that the batch is sorted and cast through a wide snapshot
BOXES = 24  # enough that every branch of building, inserting and rotating runs
EDGE = (0.9, 0.9, 0.9)
ABOUT_Z = (0.0, 0.0, 0.3, 0.9)  # the only way to turn what is seen from above
TURNED = (0.1, 0.2, 0.3, 0.9)
CORNERS = np.vstack((np.zeros(3), np.eye(3)))
TETRAHEDRON = [np.delete(CORNERS, corner, axis=0) for corner in range(4)]  # its faces
SLOW = 0.5  # seconds: a step that takes longer was not in the cache

Step = tuple[str, Callable[[], object]]
Vector = tuple[float, float, float]


def warm_up(
    *,
    planar: bool,
    margin: float,
    kinds: Iterable[ShapeKind],
    batch: bool,
    more: Iterable[Step] = (),
    log: Callable[[str], object],
) -> None:
    """Run every kind of call once on a throw-away scene.

    Parameters
    ----------
    planar, margin
        As the node's scene has them.
    kinds : iterable of ShapeKind
        The shapes that its sources can bring.
    batch : bool
        Whether rays come in batches.
    more : iterable of (str, callable)
        Further calls, and what they are for.
    log : callable
        Takes a line about the progress, when there is something to wait for.
    """
    kinds = sorted(kinds)
    scene = Scene(planar=planar, margin=margin, meshes=ShapeKind.MESH in kinds)
    steps = [*_steps(scene, kinds, margin), *more]
    if batch:
        steps.append(('batches of rays', lambda: _batches(Scene(planar=planar, margin=margin))))
    for number, (name, call) in enumerate(steps, 1):
        began = time.perf_counter()
        call()
        took = time.perf_counter() - began
        if took > SLOW:
            log(f'compiled {number} of {len(steps)}: {name} ({took:.1f} s)')


def _steps(scene: Scene, kinds: list[ShapeKind], margin: float) -> list[Step]:
    """Return the calls; queries come after what fills the scene."""
    numbers = np.arange(BOXES)
    names = Numbered('box#', numbers)
    middle = np.column_stack((numbers, numbers % 5, numbers % 3)).astype(np.float64)

    def replace(shift: float) -> object:
        return scene.replace('cloud', '', names, Shapes.boxes(middle + shift, EDGE), stamp=1)

    def put(number: int, place: NDArray[np.float64]) -> None:
        scene.update('markers', [f'one/{number}'], Shapes.boxes(place, EDGE), stamp=1)

    def add_one_by_one() -> None:
        for number in range(BOXES):
            put(number, middle[number] + 50.0)

    def move_some() -> None:
        put(1, middle[1] - 9.0)
        replace(1.001 * margin + 0.001)  # just out of the fat boxes: they are refitted
        replace(3.0 * margin + 7.0)

    # Through boxes, seen from above or not: what writes down a hit is compiled by hitting.
    start, goal = (0.0, 0.0, 0.0), (60.0, 60.0, 60.0)
    steps: list[Step] = [
        ('build', lambda: replace(0.0)),
        ('insert', add_one_by_one),
        ('move', move_some),
        ('remove', lambda: scene.remove('markers', ['one/0', 'one/1'])),
        ('rebuild', scene.rebuild),
        ('statistics', scene.stats),
        ('validate', scene.validate),
        *_queries(scene, start, goal, 'boxes'),
    ]
    for kind in kinds:
        steps.append((f'add {kind.name.lower()}s', partial(_add_turned, scene, kind)))
    return [*steps, *_queries(scene, start, goal, 'turned and round shapes')]


def _rays(scene: Scene, start: Vector, goal: Vector, what: str) -> list[Step]:
    return [
        (f'raycast, {what}', lambda: scene.raycast(start, goal)),
        (f'raycast_all, {what}', lambda: scene.raycast_all(start, goal)),
        (f'swept ball, {what}', lambda: scene.raycast_all(start, goal, 0.5)),
        (f'first of swept ball, {what}', lambda: scene.raycast(start, goal, 0.5)),
    ]


def _queries(scene: Scene, start: Vector, goal: Vector, what: str) -> list[Step]:
    return [
        *_rays(scene, start, goal, what),
        (f'overlap, {what}', lambda: scene.overlap((0.0, 0.0, 0.0), (9.0, 9.0, 9.0))),
        (
            f'overlap of a turned box, {what}',
            lambda: scene.overlap((0.0, 0.0, 0.0), (9.0, 9.0, 9.0), ABOUT_Z, 0.5),
        ),
        (
            f'overlap of a ball, {what}',
            lambda: scene.overlap((3.0,) * 3, (3.0,) * 3, ABOUT_Z, 2.0),
        ),
    ]


def _add_turned(scene: Scene, kind: ShapeKind) -> None:
    place = [3.0, 3.5 + kind, 3.0]
    if kind == ShapeKind.MESH:
        shape = Shapes.of_meshes([Mesh(TETRAHEDRON)], place, [TURNED])
    else:
        shape = Shapes.boxes(place, EDGE, [TURNED])
        shape = shape._replace(kind=np.array([kind], dtype=np.uint8))
    scene.update('turned', [f'{kind.name}/0'], shape, stamp=3)


def _batches(scene: Scene) -> None:
    """Cast a batch of each size that the tree answers in a way of its own."""
    line = np.arange(MANY * 3.0).reshape(MANY, 3)
    scene.replace(
        'cloud', '', Numbered('box#', np.arange(MANY)), Shapes.boxes(line, EDGE), stamp=1
    )
    for count in (1, MANY):
        scene.raycast_many(line[:count], line[:count])
