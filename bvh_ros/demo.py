# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_demo`: start the node, move obstacles, ask who is in the way, print the answers, end.

Everything goes over real ROS 2: the node runs in a process of its own, obstacles are published
as markers, questions are service calls.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import rclpy
from rclpy.node import Node
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.client import BvhClient, BvhTimeoutError
from bvh_ros.questions import Question, Table
from bvh_ros.ros import large_messages
from bvh_ros.ros.running import init, keep_apart, running_node, wait_until_ready

DURATION = 15.0  # seconds of the warehouse
MOST_DOMAIN = 232  # of ROS_DOMAIN_ID: beyond, there are no ports
RATE = 10.0  # frames a second of the warehouse
PRINT_EVERY = 1.0  # seconds between the answers that are printed; all are counted
MARKER_TYPES = {'box': Marker.CUBE, 'sphere': Marker.SPHERE, 'cylinder': Marker.CYLINDER}
EVERYWHERE = ((-1e6, -1e6, -1e6), (1e6, 1e6, 1e6))
Vector = tuple[float, float, float]
Play = Callable[[Node, BvhClient], Table]


class Thing(NamedTuple):
    """An obstacle at one moment."""

    kind: str  # a key of MARKER_TYPES
    namespace: str
    number: int
    centre: Vector
    size: Vector
    yaw: float


class Frame(NamedTuple):
    """The world at one moment, and what is asked about it."""

    t: float
    things: list[Thing]
    questions: list[Question]


def warehouse() -> Iterator[Frame]:
    """Forklifts, people and a ball between two shelves."""
    shelves = [
        Thing('box', 'shelf', side, (10.0, 4.0 * (2 * side - 1), 1.5), (16.0, 0.6, 3.0), 0.0)
        for side in (0, 1)
    ]
    questions = [
        Question('ray along the aisle, 20 m', lambda c: c.raycast((0, 0, 1), (20, 0, 1))),
        Question(
            'robot, radius 0.4 m, drives 20 m',
            lambda c: c.raycast((0, -2.4, 0.5), (20, -2.4, 0.5), 0.4),
        ),
        Question('who is in the loading zone', lambda c: c.overlap((8, -2, 0), (12, 2, 2))),
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
        if t < 0.6 * DURATION:  # then somebody picks it up
            height = 0.3 + abs(math.sin(2.0 * t))
            moving.append(Thing('sphere', 'ball', 0, (10.0, 1.5, height), (0.6, 0.6, 0.6), 0.0))
        yield Frame(t, shelves + moving, questions)


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
    seen = [thing.number for _, _, thing in rows]
    ego = max(set(seen), key=lambda number: (seen.count(number), -number))
    for _, group in groupby(rows, key=itemgetter(0)):
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
            f'{name}: who is ahead, 50 m', lambda c: c.raycast(ahead(bumper), ahead(bumper + 50))
        ),
        Question(
            f'{name}: 1.2 m wide behind, 50 m',
            lambda c: c.raycast(ahead(-bumper - 0.6), ahead(-bumper - 50.6), 0.6),
        ),
        Question(
            f'{name}: who else is within 8 m',
            lambda c: [
                hit for hit in c.overlap(car.centre, car.centre, tolerance=8.0) if hit.name != name
            ],
        ),
    ]


def markers(things: Iterable[Thing], gone: Iterable[tuple[str, int]]) -> MarkerArray:
    """Return the things as markers, and those that are gone as deletions."""
    array = MarkerArray()
    for thing in things:
        marker = Marker(ns=thing.namespace, id=thing.number, type=MARKER_TYPES[thing.kind])
        pose, scale = marker.pose, marker.scale
        pose.position.x, pose.position.y, pose.position.z = thing.centre
        pose.orientation.z, pose.orientation.w = math.sin(thing.yaw / 2), math.cos(thing.yaw / 2)
        scale.x, scale.y, scale.z = thing.size
        marker.color.g = marker.color.a = 1.0  # to be seen in RViz too
        array.markers.append(marker)
    array.markers += [Marker(ns=ns, id=number, action=Marker.DELETE) for ns, number in gone]
    for marker in array.markers:
        marker.header.frame_id = 'map'
    return array


def play(frames: Iterable[Frame], speed: float, node: Node, client: BvhClient) -> Table:
    """Publish the frames when they are due, and ask after each."""
    publisher = node.create_publisher(MarkerArray, f'{client.name}/obstacles', 10)
    while publisher.get_subscription_count() == 0:
        time.sleep(0.01)
    table = Table()
    table.head()
    known: set[tuple[str, int]] = set()
    began, printed, updates = time.monotonic(), -1, 0
    for frame in frames:
        time.sleep(max(0.0, began + frame.t / speed - time.monotonic()))
        present = {(thing.namespace, thing.number) for thing in frame.things}
        publisher.publish(markers(frame.things, known - present))
        while not (known or client.overlap(*EVERYWHERE)):  # the first frame has to arrive
            time.sleep(0.01)
        known, updates = present, updates + len(frame.things)
        second = int(frame.t / speed / PRINT_EVERY + 1e-6)
        for question in frame.questions:
            table.ask(client, question, frame.t, show=second > printed)
        printed = second
    print(f'\n{updates} obstacle updates in {time.monotonic() - began:.1f} s; {table.summary()}')
    return table


def _arguments(args: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog='bvh_demo', description=(__doc__ or '').split('\n')[0])
    parser.add_argument(
        '--replay',
        type=Path,
        metavar='PATH',
        help='play a ROS 2 bag (folder, .mcap or .db3) or a track file (.csv)',
    )
    parser.add_argument(
        '--topic', default='', help='only this one of the bag; default: all that bring obstacles'
    )
    parser.add_argument('--speed', type=float, default=1.0, help='times real time (default 1)')
    parser.add_argument(
        '--domain', type=int, help='ROS_DOMAIN_ID (default: $ROS_DOMAIN_ID, else one of its own)'
    )
    options = parser.parse_args(args)
    if not (math.isfinite(options.speed) and options.speed > 0.0):
        parser.error('--speed must be more than 0')
    if options.domain is not None and not 0 <= options.domain <= MOST_DOMAIN:
        parser.error(f'--domain must be 0 to {MOST_DOMAIN}')
    if options.replay is not None and not options.replay.exists():
        parser.error(f'there is no file or folder {options.replay}')
    if options.topic and (options.replay is None or options.replay.suffix == '.csv'):
        parser.error('--topic is for bags')
    return options


def _show(options: argparse.Namespace, namespace: str) -> tuple[dict[str, object], Play]:
    """The node's parameters, and what to play to it."""
    path, speed = options.replay, options.speed
    if path is None or path.suffix == '.csv':
        return {}, partial(play, warehouse() if path is None else tracks(path), speed)
    from bvh_ros import bags, replay

    recording = bags.find(path, options.topic)
    return replay.parameters(recording, namespace), partial(replay.play, recording, speed)


def main(args: Sequence[str] | None = None) -> int:
    """Run the demo; return 0 if every question was answered."""
    options = _arguments(args)
    namespace = keep_apart(options.domain)
    try:
        parameters, play_to = _show(options, namespace)
        where = f'{namespace}/bvh on ROS_DOMAIN_ID={os.environ["ROS_DOMAIN_ID"]}'
        print(f'starting the node {where}', flush=True)
        large_messages.enable()
        init()
        node = rclpy.create_node('bvh_demo', namespace=namespace)
        client = BvhClient(node)
        with running_node(namespace, parameters) as process:
            began = time.monotonic()
            wait_until_ready(client, process)
            print(f'ready after {time.monotonic() - began:.1f} s')
            table = play_to(node, client)
    except KeyboardInterrupt:
        return 130
    except (BvhTimeoutError, RuntimeError) as error:
        print(f'bvh_demo: {error}', file=sys.stderr)
        return 1
    finally:
        rclpy.try_shutdown()
    return 1 if table.errors or not table.times else 0


if __name__ == '__main__':
    sys.exit(main())
