# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Worlds frame by frame: the warehouse of the demo, and track files; questions about them."""

from __future__ import annotations

import csv
import itertools
import math
import statistics
import time
from collections.abc import Callable, Iterable, Iterator
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.client import BvhClient, BvhError, Hit
from bvh_ros.scene import Scene, ShapeKind, Shapes

# ---- What the demo asks a running node, and the table of the answers


class Question(NamedTuple):
    """One call of the client, and how the table names it."""

    text: str
    ask: Callable[[BvhClient], Hit | list[Hit] | None]


class Table:
    """Prints some answers and keeps the time of all."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.errors = 0

    def head(self) -> None:
        """Print the column names."""
        print(f'\n{"t [s]":>6}  {"question":34} {"answer":26} {"at x, y, z [m]":24} {"ms":>6}')

    def ask(self, client: BvhClient, question: Question, t: float, *, show: bool) -> None:
        """Ask one question."""
        began = time.perf_counter()
        try:
            answer = question.ask(client)
        except BvhError as error:
            self.errors += 1
            print(f'{t:6.1f}  {question.text:34} error: {error}')
            return
        took = 1e3 * (time.perf_counter() - began)
        self.times.append(took)
        if show:
            names, where = in_words(answer)
            print(f'{t:6.1f}  {question.text:34} {names:26} {where:24} {took:6.2f}')

    def summary(self) -> str:
        """Say how it went."""
        if not self.times:
            return 'no question was answered'
        return (
            f'{len(self.times)} questions answered, {self.errors} errors; round trip over ROS 2: '
            f'median {statistics.median(self.times):.2f} ms, slowest {max(self.times):.2f} ms'
        )


def in_words(answer: Hit | list[Hit] | None) -> tuple[str, str]:
    """Names of the hits, and the place of the first one."""
    hits = [] if answer is None else [answer] if isinstance(answer, Hit) else answer
    if not hits:
        return 'free', ''
    names = ', '.join(hit.name for hit in hits[:2])
    if len(hits) > 2:
        names += f', +{len(hits) - 2}'
    return names, '({:.2f}, {:.2f}, {:.2f})'.format(*hits[0].point)


# ---- The warehouse, and track files


DURATION = 15.0  # seconds of the warehouse
RATE = 10.0  # frames a second of the warehouse
LEVELS, THICK = (0.2, 1.2, 2.2), 0.08  # m, of the boards
MARKER_TYPES = {'box': Marker.CUBE, 'sphere': Marker.SPHERE, 'cylinder': Marker.CYLINDER}
KINDS = {'box': ShapeKind.BOX, 'sphere': ShapeKind.SPHERE, 'cylinder': ShapeKind.CYLINDER}
Vector = tuple[float, float, float]


class Thing(NamedTuple):
    """An obstacle at one moment."""

    kind: str  # a key of MARKER_TYPES
    namespace: str
    number: int
    centre: Vector
    size: Vector
    yaw: float


class Frame(NamedTuple):
    """The world at one moment, and questions about it."""

    t: float
    things: list[Thing]
    questions: list[Question]


def warehouse() -> Iterator[Frame]:
    """Forklifts, people and a ball between two racks with crates."""
    racks = _racks()
    questions = [
        Question('ray along the aisle, 20 m', lambda c: c.raycast((0, 0, 1), (20, 0, 1))),
        Question(
            'robot, radius 0.4 m, drives 20 m',
            lambda c: c.raycast((0, -2.4, 0.5), (20, -2.4, 0.5), 0.4),
        ),
        Question('what is in the loading zone', lambda c: c.overlap((8, -2, 0), (12, 2, 2))),
    ]
    for step in range(int(DURATION * RATE)):
        t = step / RATE
        moving = [
            Thing('box', 'forklift', 0, (4.0 + t, 0.4, 1.0), (2.4, 1.2, 2.0), 0.2 * t),
            Thing('box', 'forklift', 1, (16.0 - t, -2.0, 1.0), (2.4, 1.2, 2.0), 0.0),
            *(
                Thing('cylinder', 'person', i, _circling(t, i), (0.6, 0.6, 1.8), 0.0)
                for i in range(3)
            ),
        ]
        if t < 0.6 * DURATION:  # then a person picks it up
            height = 0.3 + abs(math.sin(2.0 * t))
            moving.append(Thing('sphere', 'ball', 0, (10.0, 1.5, height), (0.6, 0.6, 0.6), 0.0))
        yield Frame(t, racks + moving, questions)


def _racks() -> list[Thing]:
    """Posts and boards on both sides of the aisle, and crates on most places of the boards."""
    shelves, crates, rng = [], [], np.random.default_rng(3)
    for y in (-4.0, 4.0):
        shelves += [((x, y, 1.5), (0.1, 0.9, 3.0)) for x in (2.0, 6.0, 10.0, 14.0, 18.0)]
        shelves += [((10.0, y, z), (16.0, 0.9, THICK)) for z in LEVELS]
        for bay, along, z in itertools.product(range(4), (0.75, 2.0, 3.25), LEVELS):
            length, width, height = rng.uniform((0.6, 0.5, 0.3), (1.1, 0.85, 0.75)).tolist()
            middle = (2.0 + 4.0 * bay + along, y, z + 0.5 * (THICK + height))
            if rng.random() < 0.75:
                crates.append((middle, (length, width, height)))
    return [
        Thing('box', name, number, *box, 0.0)
        for name, boxes in (('shelf', shelves), ('crate', crates))
        for number, box in enumerate(boxes)
    ]


def _circling(t: float, which: int) -> Vector:
    angle = 0.5 * t + 2.1 * which
    return (10.0 + 5.0 * math.cos(angle), 2.5 * math.sin(angle), 0.9)


def tracks(path: Path) -> Iterator[Frame]:
    """Vehicles of a track file: columns frame, t_s, id, cx ... cz, sx ... sz, yaw, type.

    The questions are those of the vehicle that stays longest.
    """
    try:
        with path.open(newline='') as file:
            rows = [
                (row['frame'], float(row['t_s']), _vehicle(row)) for row in csv.DictReader(file)
            ]
    except (KeyError, ValueError, TypeError, OSError, csv.Error) as error:
        raise RuntimeError(f'{path} is no track file: {error!r}') from error
    if not rows:
        raise RuntimeError(f'{path} is no track file: it has no rows')
    numbers = [thing.number for _, _, thing in rows]
    ego = max(set(numbers), key=lambda number: (numbers.count(number), -number))
    for _, group in itertools.groupby(rows, key=itemgetter(0)):
        vehicles = list(group)
        things = [thing for _, _, thing in vehicles]
        own = [thing for thing in things if thing.number == ego]
        yield Frame(vehicles[0][1], things, _questions_of(own[0]) if own else [])


def _vehicle(row: dict[str, str]) -> Thing:
    return Thing(
        'box',
        row['type'],
        int(row['id']),
        (float(row['cx']), float(row['cy']), float(row['cz'])),
        (float(row['sx']), float(row['sy']), float(row['sz'])),
        float(row['yaw']),
    )


def _questions_of(car: Thing) -> list[Question]:
    forward = (math.cos(car.yaw), math.sin(car.yaw))
    (x, y, z), bumper = car.centre, 0.5 * car.size[0] + 0.1

    def ahead(distance: float) -> Vector:
        return (x + distance * forward[0], y + distance * forward[1], z)

    name = f'{car.namespace}/{car.number}'
    return [
        Question(
            f'{name}: what is ahead, 50 m', lambda c: c.raycast(ahead(bumper), ahead(bumper + 50))
        ),
        Question(
            f'{name}: 1.2 m wide behind, 50 m',
            lambda c: c.raycast(ahead(-bumper - 0.6), ahead(-bumper - 50.6), 0.6),
        ),
        Question(
            f'{name}: what else is within 8 m',
            lambda c: [
                hit for hit in c.overlap(car.centre, car.centre, tolerance=8.0) if hit.name != name
            ],
        ),
    ]


def show(frame: Frame, scene: Scene, stamp: int) -> None:
    """Make a scene of a frame, namespaces as sources; what it no longer has goes."""
    groups: dict[str, list[Thing]] = {}
    for thing in frame.things:
        groups.setdefault(thing.namespace, []).append(thing)
    for name in scene.sources():
        if name not in groups:
            scene.remove_group(name, '')
    for name, some in groups.items():
        names = [f'{name}/{thing.number}' for thing in some]
        for refusal in scene.replace(name, '', names, _shapes(some), stamp=stamp):
            raise RuntimeError(f'at {frame.t:g} s: {refusal}')


def _shapes(things: list[Thing]) -> Shapes:
    turns = [(0.0, 0.0, math.sin(thing.yaw / 2), math.cos(thing.yaw / 2)) for thing in things]
    return Shapes(
        np.array([KINDS[thing.kind] for thing in things], np.uint8),
        np.array([thing.centre for thing in things]),
        np.array(turns),
        np.array([thing.size for thing in things]),
    )


def markers(
    things: Iterable[Thing], removed: Iterable[tuple[str, int]], *, begin: bool = False
) -> MarkerArray:
    """Return the things as markers, and those that are gone as deletions; to begin with, all that
    was there before is deleted.
    """
    array = MarkerArray(markers=[Marker(action=Marker.DELETEALL)] if begin else [])
    for thing in things:
        marker = Marker(ns=thing.namespace, id=thing.number, type=MARKER_TYPES[thing.kind])
        pose, scale = marker.pose, marker.scale
        pose.position.x, pose.position.y, pose.position.z = thing.centre
        pose.orientation.z, pose.orientation.w = math.sin(thing.yaw / 2), math.cos(thing.yaw / 2)
        scale.x, scale.y, scale.z = thing.size
        marker.color.g = marker.color.a = 1.0  # to be seen in RViz too
        array.markers.append(marker)
    array.markers += [Marker(ns=ns, id=number, action=Marker.DELETE) for ns, number in removed]
    for marker in array.markers:
        marker.header.frame_id = 'map'
    return array
