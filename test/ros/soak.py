# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A node under load; every answer is checked, memory is watched.

python test/ros/soak.py MINUTES ends with 1 if an answer is wrong, or memory grows.
python test/ros/soak.py --publish NAMESPACE publishes the boxes until it is ended. It reads
from its standard input which frames the node knows, a line each, and never gets far ahead of them.

A thousand boxes, half of them turning, come and go at 30 Hz, published by a process of its own.
The answers to random rays, balls and boxes are compared with those of a scene of the frame that
the reply says it knows of.
"""

import re
import struct
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, NamedTuple

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point
from nav_msgs.srv import GetPlan
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.serialization import serialize_message
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.ros import running
from bvh_ros.scene import Scene, SceneHit, Shapes

Floats = NDArray[np.float64]

# ---- A thousand boxes that move, turn, come and go; a scene of the package answers about them


BOXES = 1000
SIDE = 40.0  # m, of the cube that holds the centres
ABSENT, CYCLE = 20, 200  # frames: each box is away for 20 of 200

_RNG = np.random.default_rng(5)
_BASE = _RNG.uniform(0.0, SIDE, (BOXES, 3))
_REACH = _RNG.uniform(-4.0, 4.0, (BOXES, 3))  # m, of the swing
_PACE = _RNG.uniform(0.005, 0.03, (BOXES, 1))  # radians a frame
_TURN = np.where(np.arange(BOXES) % 2 == 0, 0.0, _RNG.uniform(-0.05, 0.05, BOXES))
SIZE = _RNG.uniform(0.4, 2.4, (BOXES, 3))
"""Edge lengths, m."""


class Frame(NamedTuple):
    """The boxes of one frame; those that are away have a place, too."""

    present: np.ndarray  # (n,) bool
    centre: Floats  # (n, 3) m
    turn: Floats  # (n, 4) quaternions about z; every second box is never turned


def frame_at(number: int) -> Frame:
    """The world of one frame; there is nothing before frame 0."""
    phase = (number + 13 * np.arange(BOXES)) % CYCLE
    half, zero = _TURN * number / 2, np.zeros(BOXES)
    return Frame(
        (phase >= ABSENT) & (number >= 0),
        _BASE + _REACH * np.sin(_PACE * number),
        np.column_stack((zero, zero, np.sin(half), np.cos(half))),
    )


@lru_cache(maxsize=4)
def scene_at(number: int) -> Scene:
    """The same, without ROS."""
    frame, scene = frame_at(number), Scene()
    rows = np.flatnonzero(frame.present)
    shapes = Shapes.boxes(frame.centre[rows], SIZE[rows], frame.turn[rows])
    assert scene.update('soak', [f'soak/{row}' for row in rows], shapes, stamp=1) == []
    return scene


# ---- What is wrong with an answer


NEARLY = 1e-6  # m: of points at one distance, rounding may decide which is nearer


class Found(NamedTuple):
    """One obstacle of an answer."""

    name: str
    point: tuple[float, ...]


def fault(answer: Sequence[Found], hits: Sequence[SceneHit], origin: Floats, first: bool) -> str:
    """Say what is wrong with an answer, of which a scene says these hits; obstacles that are as
    far from the origin as each other may come in any order.
    """
    wanted = [Found(hit.name, tuple(hit.point.tolist())) for hit in hits]
    if first:
        wanted = [one for one, hit in zip(wanted, hits, strict=True) if hit.t == hits[0].t]
        return '' if [*answer] in ([[one] for one in wanted] or [[]]) else f'not of {wanted}'
    if sorted(answer) != sorted(wanted):
        return f'{sorted({*answer} ^ {*wanted})} is in one of them'
    far = [np.linalg.norm(np.subtract(one.point, origin)) for one in answer]
    return 'the order is wrong' if (np.diff(far) < -NEARLY).any() else ''


# ---- Random questions to the running node


TIMEOUT = 600.0  # seconds, against hanging


class Answer(NamedTuple):
    """What became of one question."""

    frame: int  # the newest that the answer knows of, -1 if none
    seconds: float
    fault: str  # empty where the answer is right


class Asker:
    """Asks the services of a node in turn, at random places."""

    def __init__(self, node: Node) -> None:
        self._node, self._clients = node, dict[str, Any]()
        for name in ('raycast', 'raycast_all', 'overlap'):
            self._clients[name] = node.create_client(GetPlan, f'bvh/{name}')
        self._rng, self._turn = np.random.default_rng(), 0

    def ask(self) -> Answer:
        """Ask the next question: rays, every second one for all hits, boxes and balls."""
        self._turn += 1
        uniform = self._rng.uniform
        if self._turn % 2:
            name = 'raycast' if self._turn % 4 == 1 else 'raycast_all'
            return self._asked(name, *uniform(-4.0, SIDE + 4.0, (2, 3)), 0.0)
        centre, half = uniform(0.0, SIDE, 3), uniform(0.1, 4.0, 3)
        if self._turn % 4:
            return self._asked('overlap', centre - half, centre + half, 0.0)
        # tolerance is a float32
        return self._asked('overlap', centre, centre, float(np.float32(uniform(0.1, 5.0))))

    def _asked(self, name: str, start: Floats, goal: Floats, tolerance: float) -> Answer:
        request = GetPlan.Request(tolerance=tolerance)
        for pose, point in ((request.start.pose, start), (request.goal.pose, goal)):
            pose.position = Point(**dict(zip('xyz', point.tolist(), strict=True)))
        began = time.perf_counter()
        future = self._clients[name].call_async(request)
        rclpy.spin_until_future_complete(self._node, future, timeout_sec=TIMEOUT)
        seconds = time.perf_counter() - began
        if not future.done():
            self._clients[name].remove_pending_request(future)
            return Answer(-1, seconds, f'{name}: no answer within {TIMEOUT:g} s')
        plan = future.result().plan
        places = [(pose.header.frame_id, pose.pose.position) for pose in plan.poses]
        found = [Found(name, (at.x, at.y, at.z)) for name, at in places]
        if found and found[0].name.startswith('error: '):
            return Answer(-1, seconds, f'{name}: {found[0].name}')
        frame = plan.header.stamp.sec - 1
        scene = scene_at(frame)
        if name == 'overlap':
            wrong = fault(
                found, scene.overlap(start, goal, None, tolerance), (start + goal) / 2, False
            )
        else:
            wrong = fault(found, scene.raycast_all(start, goal), start, name == 'raycast')
        query = f'frame {frame}, {name} {start.tolist()} {goal.tolist()} {tolerance!r}'
        return Answer(frame, seconds, wrong and f'{query}: {wrong}')


# ---- The publisher of this world, a process of its own


RATE = 30.0  # frames a second
AHEAD = 60  # frames; more would pile up in the memory of a node without time
TOPIC = 'bvh/obstacles'
STAMP, ID, X = 0x1D0FACED, 0x0B0EAC71, -1.2345678901234567e89  # occur nowhere else


class Frames:
    """Makes the MarkerArray of a frame, as serialised bytes.

    rclpy takes 42 ms to serialise a thousand markers, longer than a frame lasts. So one message is
    serialised, and its numbers are overwritten in place.
    """

    def __init__(self) -> None:
        serialised = _serialised()
        self._bytes = np.frombuffer(serialised, np.uint8).copy()
        self._stamps = _places(serialised, struct.pack('<i', STAMP), 4)
        # An id is followed by type and action, a place by orientation and size.
        self._ids = _places(serialised, struct.pack('<i', ID), 4)
        self._poses = _places(serialised, struct.pack('<d', X), 80)

    def message(self, frame: int) -> bytes:
        """Frame number `frame`, stamped with as many seconds and one."""
        world = frame_at(frame)
        order = np.argsort(~world.present, kind='stable')  # deletions come last
        table = np.column_stack((world.centre, world.turn, SIZE))[order]
        actions = np.where(world.present, Marker.ADD, Marker.DELETE)[order, None]
        self._write(self._stamps, np.full((BOXES, 1), 1 + frame))
        self._write(self._ids, order[:, None])
        self._write(self._ids + 8, actions)
        self._write(self._poses, table)
        return self._bytes.tobytes()

    def _write(self, places: NDArray[np.int64], values: NDArray[Any]) -> None:
        kind = '<i4' if values.dtype.kind == 'i' else '<f8'
        self._bytes[places] = values.astype(kind).view(np.uint8).reshape(places.shape)


def _places(serialised: bytes, mark: bytes, size: int) -> NDArray[np.int64]:
    """(n, size) indices of the bytes that begin with a mark, one row a marker."""
    starts = np.array([found.start() for found in re.finditer(re.escape(mark), serialised)])
    return starts[:, None] + np.arange(size)


def _serialised() -> bytes:
    """A MarkerArray with marks where frames differ."""
    array = MarkerArray()
    for _ in range(BOXES):
        marker = Marker(ns='soak', id=ID, type=Marker.CUBE)
        marker.header.frame_id = 'map'
        marker.header.stamp.sec = STAMP
        marker.pose.position.x = X
        array.markers.append(marker)
    return bytes(serialize_message(array))


def publish(namespace: str) -> None:
    """Publish frame after frame; a late one comes at once, where the node has kept up."""
    rclpy.init(args=[])
    node = rclpy.create_node('soak_publisher', namespace=namespace)
    publisher = node.create_publisher(MarkerArray, TOPIC, 10)
    while publisher.get_subscription_count() == 0:
        time.sleep(0.01)
    frames, frame, known, began = Frames(), 0, 0, time.monotonic()
    while rclpy.ok():
        while frame > known + AHEAD:
            known = int(sys.stdin.readline())
        message = frames.message(frame)
        time.sleep(max(0.0, began + frame / RATE - time.monotonic()))
        publisher.publish(message)
        frame += 1


@contextmanager
def publishing(namespace: str) -> Iterator[IO[bytes]]:
    """Publish the world in a process of its own, which is to be told what the node knows."""
    command = [sys.executable, __file__, '--publish', namespace]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, bufsize=0)
    assert process.stdin is not None
    try:
        yield process.stdin
    finally:
        process.kill()
        process.wait()
        process.stdin.close()


# ---- The soak


ASKED = 100.0  # questions a second
LEAST = 500  # questions, however long they take: half of them are the warm-up
SHOWN = 10  # wrong answers that are printed
FLAT = 0.02  # of the memory after the warm-up; more growth than this over the run is a leak
WARM_UP = 0.5  # of the run: what is allocated once is not growth


class Soaked(NamedTuple):
    """What a soak found."""

    answers: list[Answer]
    levels: Floats  # (n, 2): minutes, and MB of the node
    figures: dict[str, str]  # of the source of markers, as the node reports them

    def faults(self) -> list[str]:
        """What is wrong with answers."""
        return [answer.fault for answer in self.answers if answer.fault]

    def growth(self) -> float:
        """MB an hour: the slope of a straight line through all after the warm-up."""
        minutes, megabytes = self.levels[self.settled() :].T
        return float(60.0 * np.polyfit(minutes, megabytes, 1)[0]) if len(minutes) > 1 else 0.0

    def leaks(self) -> bool:
        """Whether memory grows."""
        minutes, megabytes = self.levels.T
        return self.growth() * minutes[-1] / 60.0 > FLAT * megabytes[self.settled()]

    def settled(self) -> int:
        """Where the warm-up ends."""
        return int(WARM_UP * len(self.levels))


def memory(process: int) -> float:
    """Resident memory of a process, MB."""
    status = Path(f'/proc/{process}/status').read_text(encoding='utf-8')
    return int(status.partition('VmRSS:')[2].split()[0]) / 1024


def soak(minutes: float) -> Soaked:
    """Ask a node of its own for so long, from when it knows a frame."""
    answers, levels = list[Answer](), list[tuple[float, float]]()
    figures: dict[str, str] = {}

    def note(message: Any) -> None:
        for status in message.status:
            if status.name.endswith('source markers'):
                figures.update({pair.key: pair.value for pair in status.values})

    with (
        TemporaryFile() as log,
        running.served('soak', log=log) as (client, process),
        publishing(client.node.get_namespace()) as publisher,
    ):
        asker = Asker(client.node)
        while asker.ask().frame < 0:
            time.sleep(1.0 / ASKED)
        client.node.create_subscription(DiagnosticArray, '/diagnostics', note, 10)
        began = now = time.monotonic()
        levels.append((0.0, memory(process.pid)))
        while now < began + 60.0 * minutes or len(answers) < LEAST:
            answers.append(asker.ask())
            publisher.write(f'{answers[-1].frame}\n'.encode())
            time.sleep(max(0.0, now + 1.0 / ASKED - time.monotonic()))
            now = time.monotonic()
            if now - began >= 60.0 * levels[-1][0] + 1.0:
                levels.append(((now - began) / 60.0, memory(process.pid)))
    return Soaked(answers, np.array(levels), figures)


def main(minutes: str) -> int:
    """Soak, and print what was found."""
    found = soak(float(minutes))
    milliseconds = 1e3 * np.array([answer.seconds for answer in found.answers])
    for what, figure in (
        ('answers', len(found.answers)),
        ('wrong answers', len(found.faults())),
        ('frames asked about', len({answer.frame for answer in found.answers})),
        ('messages that the node took', found.figures.get('messages', '')),
        ('messages refused', found.figures.get('refused', '')),
        (
            'round trip, p50, p99, longest [ms]',
            np.percentile(milliseconds, (50, 99, 100)).round(2),
        ),
        ('memory after warm-up, at the end [MB]', found.levels[[found.settled(), -1], 1].round(1)),
        ('growth [MB an hour]', round(found.growth(), 1)),
    ):
        print(f'{what:40s} {figure}')
    for fault in found.faults()[:SHOWN]:
        print(f'wrong: {fault}')
    return int(bool(found.faults()) or found.leaks())


if __name__ == '__main__':
    if sys.argv[1:2] == ['--publish']:
        publish(sys.argv[2])
    else:
        sys.exit(main(*sys.argv[1:]))
