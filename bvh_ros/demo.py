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
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import rclpy
from rclpy.node import Node
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.client import BvhClient, BvhError, BvhTimeoutError, Hit

DURATION = 15.0  # seconds of the warehouse
RATE = 10.0  # frames a second of the warehouse
START_TIMEOUT = 300.0  # seconds: the first start on a machine compiles
PRINT_EVERY = 1.0  # seconds between the answers that are printed; all are counted
MARKER_TYPES = {'box': Marker.CUBE, 'sphere': Marker.SPHERE, 'cylinder': Marker.CYLINDER}
Vector = tuple[float, float, float]


class Thing(NamedTuple):
    """An obstacle at one moment."""

    kind: str  # a key of MARKER_TYPES
    namespace: str
    number: int
    centre: Vector
    size: Vector
    yaw: float


class Question(NamedTuple):
    """One call of the client, and how the table names it."""

    text: str
    ask: Callable[[BvhClient], Hit | list[Hit] | None]


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


def replay(path: Path) -> Iterator[Frame]:
    """Vehicles of a track file: columns frame, t_s, id, cx ... cz, sx ... sz, yaw, type.

    The questions are those of the vehicle that stays longest.
    """
    with path.open(newline='') as file:
        rows = list(csv.DictReader(file))
    seen = [int(row['id']) for row in rows]
    ego = max(set(seen), key=lambda number: (seen.count(number), -number))
    for frame, group in groupby(rows, key=lambda row: row['frame']):
        del frame
        vehicles = list(group)
        things = [_vehicle(row) for row in vehicles]
        own = [thing for thing in things if thing.number == ego]
        yield Frame(float(vehicles[0]['t_s']), things, _questions_of(own[0]) if own else [])


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
            who, where = _in_words(answer)
            print(f'{t:6.1f}  {question.text:34} {who:26} {where:24} {took:6.2f}')

    def summary(self) -> str:
        """Say how it went."""
        if not self.times:
            return 'no question was answered'
        return (
            f'{len(self.times)} questions answered, {self.errors} errors; round trip over ROS 2: '
            f'median {statistics.median(self.times):.2f} ms, slowest {max(self.times):.2f} ms'
        )


def _in_words(answer: Hit | list[Hit] | None) -> tuple[str, str]:
    hits = [] if answer is None else [answer] if isinstance(answer, Hit) else answer
    if not hits:
        return 'free', ''
    names = ', '.join(hit.name for hit in hits[:2])
    if len(hits) > 2:
        names += f', +{len(hits) - 2}'
    return names, '({:.2f}, {:.2f}, {:.2f})'.format(*hits[0].point)


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
        known, updates = present, updates + len(frame.things)
        second = int(frame.t / speed / PRINT_EVERY + 1e-6)
        for question in frame.questions:
            table.ask(client, question, frame.t, show=second > printed)
        printed = second
    print(f'\n{updates} obstacle updates in {time.monotonic() - began:.1f} s; {table.summary()}')
    return table


@contextmanager
def running_node() -> Iterator[subprocess.Popen[bytes]]:
    """Run bvh_node in a process of its own, with the Python that runs this."""
    environment = {**os.environ, 'RCUTILS_CONSOLE_OUTPUT_FORMAT': '  {name}: {message}'}
    command = [sys.executable, '-m', 'bvh_ros.ros.node']
    process = subprocess.Popen(command, env=environment)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()


def wait_for(client: BvhClient, process: subprocess.Popen[bytes]) -> None:
    """Wait until the node is ready, or raise RuntimeError if it has ended."""
    deadline = time.monotonic() + START_TIMEOUT
    while True:
        try:
            client.wait_until_ready(timeout=1.0)
            return
        except BvhTimeoutError:
            if process.poll() is not None:
                raise RuntimeError(f'the node ended with code {process.returncode}') from None
            if time.monotonic() > deadline:
                raise


def _arguments(args: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog='bvh_demo', description=(__doc__ or '').split('\n')[0])
    parser.add_argument('--replay', type=Path, metavar='FILE.csv', help='play this track file')
    parser.add_argument('--speed', type=float, default=1.0, help='times real time (default 1)')
    parser.add_argument(
        '--domain', type=int, help='ROS_DOMAIN_ID (default: $ROS_DOMAIN_ID, else one of its own)'
    )
    options = parser.parse_args(args)
    if not (math.isfinite(options.speed) and options.speed > 0.0):
        parser.error('--speed must be more than 0')
    if options.replay is not None and not options.replay.is_file():
        parser.error(f'there is no file {options.replay}')
    return options


def main(args: Sequence[str] | None = None) -> int:
    """Run the demo; return 0 if every question was answered."""
    options = _arguments(args)
    # Not to talk to robots nearby: this machine only, and by default a domain of our own.
    own_domain = os.environ.get('ROS_DOMAIN_ID') or str(1 + os.getpid() % 100)
    os.environ['ROS_DOMAIN_ID'] = str(own_domain if options.domain is None else options.domain)
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    print(f'starting bvh_node on ROS_DOMAIN_ID={os.environ["ROS_DOMAIN_ID"]}', flush=True)
    frames = warehouse() if options.replay is None else replay(options.replay)
    rclpy.init(args=[])
    try:
        node = rclpy.create_node('bvh_demo')
        client = BvhClient(node)
        with running_node() as process:
            began = time.monotonic()
            wait_for(client, process)
            print(f'ready after {time.monotonic() - began:.1f} s')
            table = play(frames, options.speed, node, client)
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
