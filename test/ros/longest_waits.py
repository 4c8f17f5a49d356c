# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How long a raycast waits while a large message is applied or answered.

Usage: longest_waits.py [WORD ...]: only the cases whose names contain one of the words.

The node, the program that asks and the one that publishes are three processes. It prints a table,
and fails if a raycast, or a row of a batch, is not answered or answered wrongly.
"""

import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path as Poses
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

sys.path.insert(0, str(Path(__file__).parents[1]))
from ros.clouds import cloud, table
from ros.messages import LATCHED, marker, stamp

from bvh_ros.client import UNANSWERED, BvhClient
from bvh_ros.ros import large_messages, running

START, GOAL, HIT = (-60.0, 0.0, 0.0), (-40.0, 0.0, 0.0), -50.5  # the x where the one cube is hit
PAUSE = 0.002  # seconds between an answer and the next question
LAST = 0.3  # seconds that are watched after a message is known
PATIENCE = 60.0  # seconds
PARAMETERS = {
    'sources': ['still', 'plain', 'given', 'followed', 'markers', 'ids'],
    'still': {'type': 'MarkerArray', 'topic': '/still'},
    'plain': {'type': 'PointCloud2', 'topic': '/plain'},
    'given': {'type': 'PointCloud2', 'topic': '/given', 'predict': 'given'},
    'followed': {'type': 'PointCloud2', 'topic': '/followed', 'predict': 'constant_velocity'},
    'markers': {'type': 'MarkerArray', 'topic': '/markers', 'predict': 'constant_velocity'},
    'ids': {'type': 'PointCloud2', 'topic': '/ids'},
    'footprint': [0.8, 0.5, 1.0],
    'max_obstacles': 3_000_000,
    'max_prediction': 10.0,
}


def ask(namespace: str) -> None:
    """Ask without end, and print when each question was put and how long its answer took."""
    rclpy.init()
    client = BvhClient(rclpy.create_node('asks', namespace=namespace), timeout=PATIENCE)
    client.wait_until_ready()
    while True:
        put, began = time.time(), time.perf_counter()
        hit = client.raycast(START, GOAL)
        took = time.perf_counter() - began
        print(put, took, hit is not None and hit.point[0] == HIT, flush=True)
        time.sleep(PAUSE)


class Wait(NamedTuple):
    """A question of the program that asks."""

    put: float  # s of the clock
    took: float  # s
    is_right: bool


class Asker:
    """The program that asks."""

    def __init__(self, namespace: str, folder: str) -> None:
        self._file = Path(folder, 'waits')
        command = [sys.executable, __file__, '--ask', namespace]
        with self._file.open('wb') as out:
            self.process = subprocess.Popen(command, stdout=out)
        while len(self.waits()) < 100:
            time.sleep(0.1)

    def waits(self) -> list[Wait]:
        """All answers so far."""
        lines = [line.split() for line in self._file.read_text().splitlines()[:-1]]
        return [Wait(float(put), float(took), right == 'True') for put, took, right in lines]


class Work:
    """Publishes to the node, and sees when what it published is known."""

    def __init__(self, client: BvhClient, process: Any, asker: Asker) -> None:
        self.client, self.node, self.process, self.asker = client, client.node, process, asker
        self._random = np.random.default_rng(0)
        self._publishers: dict[str, Any] = {}
        self._replies: dict[str, list[bytes]] = {}
        self._number = 0
        self.stamp = self.node.get_clock().now().to_msg()

    def uniform(self, rows: int, names: Sequence[str], lo: float, hi: float) -> dict[str, Any]:
        """Columns of uniform numbers."""
        return {name: self._random.uniform(lo, hi, rows).astype('f4') for name in names}

    def cloud(self, topic: str, columns: dict[str, Any]) -> Callable[[], None]:
        """Prepare a cloud of boxes, the first of which is by itself: it shows that all are known.
        Return what publishes it and waits for that.
        """
        self._number += 1
        at = -20.0, float(self._number), 0.0
        for name, column in columns.items():
            column[0] = dict(zip('xyz', at, strict=True)).get(name, 0.2 * (name[0] == 's'))
        kind = columns['x'].dtype.str[1:]
        message = cloud(columns, kind=kind, kinds={'id': 'u4'})
        self.stamp = message.header.stamp = self.node.get_clock().now().to_msg()
        return self.known(self.sender(topic, message), at)

    def known(self, send: Callable[[], None], at: Sequence[float]) -> Callable[[], None]:
        """What sends a message, and waits until its obstacle at a place is known."""

        def publish_and_wait() -> None:
            send()
            self.until(lambda: self.client.raycast((*at[:2], 5.0), (*at[:2], -5.0)))

        return publish_and_wait

    def boxes(self, topic: str, rows: int) -> Callable[[], None]:
        """Boxes at random."""
        return self.cloud(topic, self.uniform(rows, 'xyz', 0.0, 100.0))

    def moving(self, topic: str, rows: int) -> Callable[[], None]:
        """Boxes with velocities."""
        speeds = self.uniform(rows, ('vx', 'vy', 'vz'), -1.0, 1.0)
        return self.cloud(topic, self.uniform(rows, 'xyz', 0.0, 100.0) | speeds)

    def markers(self, topic: str, rows: int) -> Callable[[], None]:
        """The same of markers."""
        self._number += 1
        at = -20.0, float(self._number), 0.0
        markers = [cube('a', k, (k % 100, k // 100, self._number)) for k in range(1, rows)]
        array = MarkerArray(markers=[cube('a', 0, at), *markers])
        return self.known(self.sender(topic, array), at)

    def batch(self, asked: str, told: str, rows: int, message: Any) -> Callable[[], None]:
        """Prepare a batch of questions; return what publishes it and waits for its answer."""
        message.header.stamp = self.stamp  # that of the data: t0 counts from it
        send = self.sender(f'bvh/{asked}', message)
        topic = f'bvh/{told}'
        if topic not in self._replies:
            replies = self._replies[topic] = []
            self.node.create_subscription(PointCloud2, topic, replies.append, 10)

        def publish_and_wait() -> None:
            replies = self._replies[topic]
            end = time.monotonic() + PATIENCE
            while True:
                replies.clear()
                send()
                self.until(lambda: self.spin() or replies)
                without = table(replies[0])['obstacle'] == UNANSWERED
                if not without.any():
                    break
                # Kernels for it are compiled, or loaded.
                assert without.all()
                assert time.monotonic() < end
                time.sleep(0.2)
            assert len(without) == rows

        return publish_and_wait

    def rays(self, rows: int, **more: Any) -> Callable[[], None]:
        """A batch of rays of 9 m, or balls."""
        columns = self.uniform(rows, 'xyz', 0.0, 100.0)
        columns |= dict.fromkeys(('dx', 'dy', 'dz'), np.full(rows, 5, 'f4'))
        columns |= {'t_max': np.ones(rows, 'f4')} | more
        return self.batch('rays', 'ray_hits', rows, cloud(columns, kind='f4'))

    def volumes(self, asked: str, told: str, rows: int, **more: Any) -> Callable[[], None]:
        """A batch of points, or boxes of these sizes."""
        columns = self.uniform(rows, 'xyz', 0.0, 100.0) | more
        return self.batch(asked, told, rows, cloud(columns, kind='f4'))

    def path(self, rows: int) -> Callable[[], None]:
        """A path of poses."""
        path = Poses()
        for k in range(rows):
            pose = PoseStamped()
            pose.pose.position.x, pose.pose.orientation.w = float(k % 100), 1.0
            path.poses.append(pose)
        return self.batch('paths', 'path_hits', rows, path)

    def trigger(self, name: str) -> Callable[[], None]:
        """A call of a service."""
        client = self.node.create_client(Trigger, f'bvh/{name}')
        self.until(client.service_is_ready)
        time.sleep(1.0)

        def call_and_wait() -> None:
            future = client.call_async(Trigger.Request())
            self.until(lambda: self.spin() or future.done())
            assert future.result().success

        return call_and_wait

    def sender(self, topic: str, message: Any) -> Callable[[], None]:
        """Serialise a message; return what publishes it."""
        if topic not in self._publishers:
            qos = LATCHED if topic == '/still' else 10
            publisher = self.node.create_publisher(type(message), topic, qos)
            self._publishers[topic] = publisher
            self.until(publisher.get_subscription_count)
            time.sleep(1.0)
        serialised = serialize_message(message)
        return lambda: self._publishers[topic].publish(serialised)

    def spin(self) -> None:
        """Take messages for a moment."""
        rclpy.spin_once(self.node, timeout_sec=0.05)

    @staticmethod
    def until(condition: Callable[[], object]) -> None:
        """Wait until it holds."""
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, 'it takes too long'
            time.sleep(0.02)

    def measure(self, name: str, act: Callable[[], None]) -> None:
        """Do something, and print how long the others waited meanwhile."""
        time.sleep(0.5)
        began, used = time.time(), self._used()
        act()
        known = time.time()
        time.sleep(LAST)
        used, end = self._used() - used, time.time()
        self.until(lambda: self.asker.waits()[-1].put > end)
        meanwhile = [w for w in self.asker.waits() if began < w.put + w.took and w.put < end]
        assert meanwhile
        assert all(wait.is_right for wait in meanwhile)
        took = np.sort([wait.took for wait in meanwhile]) * 1e3
        print(
            f'{name:46s} {took[-1]:7.0f} {took[-2]:5.0f} {took[-3]:5.0f} {np.median(took):7.1f} '
            f'{known - began:8.2f} {used:6.2f}',
            flush=True,
        )

    def _used(self) -> float:
        fields = Path(f'/proc/{self.process.pid}/stat').read_text().rpartition(')')[2].split()
        return (int(fields[11]) + int(fields[12])) / 100


def cube(space: str, number: int, at: Sequence[float]) -> Marker:
    """A marker of now."""
    made = marker(number, at, ns=space)
    made.header.stamp = stamp(time.time_ns())
    return made


@contextmanager
def work(name: str):
    """A node that knows one cube, and a program that asks about it."""
    with (
        TemporaryDirectory() as folder,
        Path(folder, 'log').open('wb') as log,
        running.served(name, PARAMETERS, log=log) as (client, process),
    ):
        still = client.node.create_publisher(MarkerArray, '/still', LATCHED)
        still.publish(MarkerArray(markers=[cube('still', 0, (-50.0, 0.0, 0.0))]))
        Work.until(lambda: client.raycast(START, GOAL))
        asker = Asker(client.node.get_namespace(), folder)
        try:
            yield Work(client, process, asker)
        finally:
            asker.process.kill()
            asker.process.wait()


def ones(rows: int, value: float, *names: str) -> dict[str, Any]:
    """Columns of one value."""
    return dict.fromkeys(names, np.full(rows, value, 'f4'))


def obstacles(here: Work) -> None:
    """Messages of obstacles, one after the other."""
    here.measure('no other load', lambda: time.sleep(2.0))
    for rows in (20_000, 100_000, 300_000, 300_000):
        here.measure(f'{rows:,} boxes with velocities', here.moving('/given', rows))
    for _ in range(3):
        here.measure('100,000 boxes by constant_velocity', here.boxes('/followed', 100_000))
    for _ in range(3):
        here.measure('10,000 markers that are predicted', here.markers('/markers', 10_000))


def batches(here: Work, among: str = '') -> None:
    """Batches of questions."""
    rows = 100_000
    ball = ones(rows, 0.3, 'radius')
    for again in ('', ', again'):
        here.measure(f'100,000 balls{among}{again}', here.rays(rows, **ball))
        here.measure(f'100,000 rays{among}{again}', here.rays(rows))
        here.measure(f'100,000 points{among}{again}', here.volumes('points', 'nearest_hits', rows))
        sizes = ones(rows, 1.0, 'sx', 'sy', 'sz')
        boxes = here.volumes('boxes', 'box_hits', rows, **sizes)
        here.measure(f'100,000 boxes asked{among}{again}', boxes)
        timed = here.rays(20_000, **ones(20_000, 0.3, 'radius'), **ones(20_000, 0.1, 't0'))
        here.measure(f'20,000 balls with t0{among}{again}', timed)
        here.measure(f'a path of 3,000 poses{among}{again}', here.path(3_000))


def timed(here: Work) -> None:
    """Batches among boxes with velocities."""
    here.moving('/given', 300_000)()
    batches(here, ' among 300,000 moving')
    here.measure('~/rebuild of 300,000 moving', here.trigger('rebuild'))


def large(here: Work) -> None:
    """Clouds of 10^6 rows."""
    rows = 1_000_000
    first, second = here.boxes('/plain', rows), here.boxes('/plain', rows)
    here.measure('10^6 boxes', first)
    here.measure('10^6 boxes, replaced', second)
    send = here.sender('/plain', cloud(here.uniform(rows, 'xyz', 0.0, 100.0), kind='f4'))
    last = here.boxes('/plain', rows)

    def both() -> None:
        send()
        last()

    here.measure('10^6 boxes and others at once', both)
    here.measure('~/rebuild of 10^6', here.trigger('rebuild'))
    here.measure('~/rebuild of 10^6, again', here.trigger('rebuild'))


def hostile(here: Work) -> None:
    """Clouds of 10^6 rows, most of which cannot be used."""
    rows, random = 1_000_000, np.random.default_rng(4)
    for topic, share in (('/plain', 0.3), ('/ids', 0.3), ('/ids', 0.02), ('/plain', 0.9)):
        columns = here.uniform(rows, 'xyz', 0.0, 100.0)
        columns |= here.uniform(rows, ('sx', 'sy', 'sz'), 0.01, 0.4)
        columns = {name: column.astype('f8') for name, column in columns.items()}
        bad = random.random(rows) >= share
        bad[0] = False
        values = np.array([np.nan, np.inf, -np.inf, -0.5, 1e300])
        axis = random.integers(0, 6, rows)
        for k, name in enumerate(columns):
            which = bad & (axis == k)
            columns[name][which] = values[random.integers(0, 5, int(which.sum()))]
        if topic == '/ids':
            columns['id'] = random.permutation(rows).astype('u4')
        here.measure(f'10^6 rows, {share:.0%} good{topic}', here.cloud(topic, columns))


GROUPS = (obstacles, batches, timed, large, hostile)


def main(words: Sequence[str]) -> None:
    """Measure the groups that are asked for, or all."""
    large_messages.enable()
    print(
        f'{"longest waits of a raycast, ms, beside":46s} longest 2nd   3rd  median known,s CPU,s'
    )
    for group in GROUPS:
        if not words or group.__name__ in words:
            with work(group.__name__) as here:
                group(here)


if __name__ == '__main__':
    if sys.argv[1:2] == ['--ask']:
        ask(sys.argv[2])
    else:
        main(sys.argv[1:])
