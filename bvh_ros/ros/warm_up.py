# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compile the kernels that a configuration needs before its services appear."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

import numpy as np

from bvh_ros.scene import Numbered, Scene, ShapeKind, Shapes
from bvh_ros.tree import compiling

BOXES = 24  # enough that every branch of building, inserting and rotating runs
SLOW = 1.0  # seconds: a step that takes longer was not in the cache

Step = tuple[str, Callable[[], object]]


def warm_up(
    *, planar: bool, margin: float, kinds: Iterable[ShapeKind], log: Callable[[str], object]
) -> None:
    """Run every kind of call once on a throw-away scene.

    Parameters
    ----------
    planar, margin
        As the node's scene has them.
    kinds : iterable of ShapeKind
        The shapes that its sources can bring.
    log : callable
        Takes a line about the progress, when there is something to wait for.
    """
    first_ever = not compiling.is_warm()
    if first_ever:
        log('first start on this machine: compiling, about a minute; later starts take seconds')
    steps = _steps(Scene(planar=planar, margin=margin), sorted(kinds))
    for number, (name, call) in enumerate(steps, 1):
        began = time.perf_counter()
        call()
        took = time.perf_counter() - began
        if first_ever or took > SLOW:
            log(f'compiled {number} of {len(steps)}: {name} ({took:.1f} s)')


def _steps(scene: Scene, kinds: list[ShapeKind]) -> list[Step]:
    """Return the calls; queries come after what fills the scene."""
    numbers = np.arange(BOXES)
    names = Numbered('box#', numbers)
    middle = np.column_stack((numbers, numbers % 5, numbers % 3)).astype(np.float64)

    def boxes(shift: float) -> Shapes:
        return _shapes(ShapeKind.BOX, middle + shift)

    def replace(shift: float) -> object:
        return scene.replace('cloud', '', names, boxes(shift), stamp=1)

    def add_one_by_one() -> None:
        for number in range(BOXES):
            shape = Shapes(*(column[number : number + 1] for column in boxes(50.0)))
            scene.update('markers', [f'one/{number}'], shape, stamp=1)

    def move_some() -> None:
        scene.update('markers', ['one/1'], _shapes(ShapeKind.BOX, middle[:1] - 9.0), stamp=2)
        replace(0.001)
        replace(7.0)

    start, goal = (-5.0, 0.5, 0.0), (60.0, 60.0, 60.0)
    steps: list[Step] = [
        ('build', lambda: replace(0.0)),
        ('insert', add_one_by_one),
        ('move', move_some),
        ('remove', lambda: scene.remove('markers', ['one/0', 'one/1'])),
        ('rebuild', scene.rebuild),
        ('statistics', scene.stats),
        *_queries(scene, start, goal, 'boxes'),
    ]
    for kind in kinds:
        steps.append((f'add {kind.name.lower()}s', lambda kind=kind: _add_turned(scene, kind)))
    return [*steps, *_rays(scene, start, goal, 'turned and round shapes')]


def _rays(scene: Scene, start: tuple, goal: tuple, what: str) -> list[Step]:
    return [
        (f'raycast, {what}', lambda: scene.raycast(start, goal)),
        (f'raycast_all, {what}', lambda: scene.raycast_all(start, goal)),
        (f'swept ball, {what}', lambda: scene.raycast_all(start, goal, 0.5)),
        (f'first of swept ball, {what}', lambda: scene.raycast(start, goal, 0.5)),
    ]


def _queries(scene: Scene, start: tuple, goal: tuple, what: str) -> list[Step]:
    return [
        *_rays(scene, start, goal, what),
        (f'overlap, {what}', lambda: scene.overlap((0.0, 0.0, 0.0), (9.0, 9.0, 9.0))),
    ]


def _add_turned(scene: Scene, kind: ShapeKind) -> None:
    place = np.array([[3.0, 3.5 + kind, 3.0]])
    scene.update('turned', [f'{kind.name}/0'], _shapes(kind, place, (0.1, 0.2, 0.3, 0.9)), stamp=3)


def _shapes(
    kind: ShapeKind, places: np.ndarray, turn: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)
) -> Shapes:
    n = len(places)
    return Shapes(
        np.full(n, kind, dtype=np.uint8), places, np.tile(turn, (n, 1)), np.full((n, 3), 0.9)
    )
