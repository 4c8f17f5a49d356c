# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A node under load; every answer is checked, memory is watched.

python test/ros/soak.py MINUTES ends with 1 if an answer is wrong, or memory grows.
python test/ros/soak.py --publish NAMESPACE publishes the boxes until it is ended. It reads
from its standard input which frames the node knows, a line each, and never gets far ahead of them.

A thousand boxes, half of them turning, come and go at 30 Hz, published by a process of its own.
The answers to random rays, balls and boxes are compared with brute force on the frame that the
reply says it knows of.
"""

import re
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
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

Floats = NDArray[np.float64]

# ---- A thousand boxes that move, turn, come and go; brute force answers about them


BOXES = 1000
SIDE = 40.0  # m, of the cube that holds the centres
ABSENT, CYCLE = 20, 200  # frames: each box is away for 20 of 200
UNDECIDED = 1e-7  # m: closer to touching than this, rounding may decide either way

_RNG = np.random.default_rng(5)
_BASE = _RNG.uniform(0.0, SIDE, (BOXES, 3))
_REACH = _RNG.uniform(-4.0, 4.0, (BOXES, 3))  # m, of the swing
_PACE = _RNG.uniform(0.005, 0.03, (BOXES, 1))  # radians a frame
_TURN = np.where(np.arange(BOXES) % 2 == 0, 0.0, _RNG.uniform(-0.05, 0.05, BOXES))
HALF = _RNG.uniform(0.2, 1.2, (BOXES, 3))
"""Half edge lengths, m."""


class NodeScene(NamedTuple):
    """The boxes of one frame; those that are away have a place, too."""

    present: np.ndarray  # (n,) bool
    centre: Floats  # (n, 3) m
    yaw: Floats  # (n,) radians; every second box is never turned

    def turned(self, points: Floats, back: bool = False) -> Floats:
        """Points or directions (n, 3), one a box, from the boxes' own axes or back to them."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        if back:
            s = -s
        x, y, z = points.T
        return np.column_stack((c * x - s * y, s * x + c * y, z))

    def entries(self, start: Floats, direction: Floats, grown: float) -> Floats:
        """Where on start + t * direction, 0 to 1, each box is entered; inf where it is not."""
        half = HALF + grown
        origin = self.turned(start - self.centre, back=True)
        along = self.turned(np.tile(direction, (BOXES, 1)), back=True)
        with np.errstate(divide='ignore'):
            one, other = (-half - origin) / along, (half - origin) / along
        enter = np.maximum(np.minimum(one, other).max(axis=1), 0.0)
        leave = np.minimum(np.maximum(one, other).min(axis=1), 1.0)
        return np.where(self.present & (enter <= leave), enter, np.inf)

    def closest(self, point: Floats) -> Floats:
        """The point (n, 3) of each box that is closest to a point (3,)."""
        local = self.turned(point - self.centre, back=True)
        return self.centre + self.turned(np.clip(local, -HALF, HALF))

    def gaps(self, centre: Floats, half: Floats | float) -> Floats:
        """How far each box is from a ball of a radius, or from an aligned box of half edges.

        Negative where they overlap, inf where a box is away. Of boxes it is the gap along the axis
        that parts them most: all are upright prisms, so x, y, z and the boxes' own two horizontal
        axes are enough (separating axes).
        """
        if isinstance(half, float):
            gaps = np.linalg.norm(self.closest(centre) - centre, axis=1) - half
        else:
            offset = centre - self.centre
            turn = np.abs(np.stack((np.cos(self.yaw), np.sin(self.yaw)), axis=1))
            reach = np.column_stack(
                (
                    (HALF[:, :2] * turn).sum(axis=1),
                    (HALF[:, :2] * turn[:, ::-1]).sum(axis=1),
                    HALF[:, 2],
                )
            )
            own = np.column_stack((turn @ half[:2], turn @ half[1::-1]))
            gaps = np.hstack((
                np.abs(offset) - half - reach,
                np.abs(self.turned(offset, back=True))[:, :2] - HALF[:, :2] - own,
            )).max(axis=1)  # fmt: skip
        return np.where(self.present, gaps, np.inf)


def scene_at(frame: int) -> NodeScene:
    """The world of one frame; there is nothing before frame 0."""
    phase = (frame + 13 * np.arange(BOXES)) % CYCLE
    return NodeScene(
        (phase >= ABSENT) & (frame >= 0), _BASE + _REACH * np.sin(_PACE * frame), _TURN * frame
    )


# ---- What is wrong with an answer, by brute force


REPORTED = 1e-6  # m: a reported point may be this far from where it belongs


class Found(NamedTuple):
    """The boxes of an answer, and a point (k, 3) of each."""

    boxes: list[int]
    points: Floats


def ray_fault(scene: NodeScene, found: Found, start: Floats, goal: Floats, first: bool) -> str:
    """Say what is wrong with the answer of a raycast, first hit or all."""
    length = float(np.linalg.norm(goal - start))
    along = (goal - start) / length
    may, must = (length * scene.entries(start, goal - start, u) for u in (UNDECIDED, -UNDECIDED))
    reached = (found.points - start) @ along  # m
    if (np.abs(found.points - start - reached[:, None] * along) > REPORTED).any():
        return 'a point is not on the segment'
    early, late = may[found.boxes] - REPORTED, must[found.boxes] + REPORTED
    if (reached < early).any() or (reached > late).any():
        return 'a point is not where its box is entered'
    if not first:
        return _set_fault(found, np.isfinite(may), np.isfinite(must)) or _order_fault(reached)
    if not found.boxes:
        return 'free, but something is hit' if np.isfinite(must).any() else ''
    return 'something else comes first' if must.min() < reached[0] - REPORTED else ''


def overlap_fault(scene: NodeScene, found: Found, centre: Floats, half: Floats | float) -> str:
    """Say what is wrong with the answer of an overlap with a ball or an aligned box.

    Each point is its box's closest to the query's centre, and the nearest comes first.
    """
    gaps = scene.gaps(centre, half)
    if fault := _set_fault(found, gaps <= UNDECIDED, gaps <= -UNDECIDED):
        return fault
    if (np.abs(found.points - scene.closest(centre)[found.boxes]) > REPORTED).any():
        return "a point is not its box's closest"
    return _order_fault(np.linalg.norm(found.points - centre, axis=1))


def _set_fault(found: Found, may: np.ndarray, must: np.ndarray) -> str:
    answered = np.bincount(found.boxes, minlength=BOXES)
    for what, wrong in (
        ('is named twice', answered > 1),
        ('is missing', must & (answered == 0)),
        ('is too much', ~may & (answered > 0)),
    ):
        if wrong.any():
            return f'box {np.flatnonzero(wrong)[0]} {what}'
    return ''


def _order_fault(values: Floats) -> str:
    return 'the order is wrong' if (np.diff(values) < -REPORTED).any() else ''


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
        """Ask the next question."""
        self._turn += 1
        uniform = self._rng.uniform
        if self._turn % 2:
            name = 'raycast' if self._turn % 4 == 1 else 'raycast_all'
            start, goal = uniform(-4.0, SIDE + 4.0, (2, 3))
            check = partial(ray_fault, start=start, goal=goal, first=name == 'raycast')
            return self._checked(name, start, goal, 0.0, check)
        centre, half = uniform(0.0, SIDE, 3), uniform(0.1, 4.0, 3)
        if self._turn % 4:
            check = partial(overlap_fault, centre=centre, half=half)
            return self._checked('overlap', centre - half, centre + half, 0.0, check)
        radius = float(np.float32(uniform(0.1, 5.0)))  # tolerance is a float32
        check = partial(overlap_fault, centre=centre, half=radius)
        return self._checked('overlap', centre, centre, radius, check)

    def _checked(
        self,
        name: str,
        start: Floats,
        goal: Floats,
        tolerance: float,
        check: Callable[[NodeScene, Found], str],
    ) -> Answer:
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
        frame, names = plan.header.stamp.sec - 1, [pose.header.frame_id for pose in plan.poses]
        if names and names[0].startswith('error: '):
            return Answer(-1, seconds, f'{name}: {names[0]}')
        places = [pose.pose.position for pose in plan.poses]
        points = np.array([(at.x, at.y, at.z) for at in places]).reshape(-1, 3)
        boxes = [int(one.rpartition('/')[2]) for one in names]
        fault = check(scene_at(frame), Found(boxes, points))
        query = f'frame {frame}, {name} {start.tolist()} {goal.tolist()} {tolerance!r}'
        return Answer(frame, seconds, fault and f'{query}: {fault}')


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
        scene = scene_at(frame)
        order = np.argsort(~scene.present, kind='stable')  # deletions come last
        zero = np.zeros(BOXES)
        turn = (zero, zero, np.sin(scene.yaw / 2), np.cos(scene.yaw / 2))
        table = np.column_stack((scene.centre, *turn, 2.0 * HALF))[order]
        actions = np.where(scene.present, Marker.ADD, Marker.DELETE)[order, None]
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
