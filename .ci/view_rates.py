# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How fast the view is, and what it costs the node. Run, in the folder of a clone:

PYTHONPATH=test python .ci/view_rates.py page 10000          moving boxes, page alone, in a browser
PYTHONPATH=test python .ci/view_rates.py page 100000 --static while the camera goes around
PYTHONPATH=test python .ci/view_rates.py node 10000           the node, with and without a viewer
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bvh_ros.scene import NodeScene, Shapes
from bvh_ros.view.worlds import ShownWorld

SECONDS = 10.0
SETTLED = 5.0  # seconds before
RATE = 20.0
AHEAD = np.array((1.0, 0.0, 0.0))
PLACE = -1.2345678901234567e89  # occurs nowhere else in a message
TICK = os.sysconf('SC_CLK_TCK')


class Boxes(ShownWorld):
    """Boxes of 1 m on a floor that move to and fro, as fast as they are shown."""

    def __init__(self, count: int, moving: bool) -> None:
        self._places, self._moving, self._changes = places(count), moving, 0
        self._names = [f'box/{number}' for number in range(count)]
        super().__init__('boxes', NodeScene())
        self._put()

    def _put(self) -> None:
        shapes = Shapes.boxes(self._places + np.sin(time.monotonic()) * AHEAD, 1.0)
        self.scene.update('boxes', self._names, shapes, stamp=self._changes)
        self._changes += 1

    def advance(self, until: float) -> None:
        if self._moving:
            self._put()
        super().advance(until)

    def version(self) -> int:
        return self._changes


def places(count: int) -> np.ndarray:
    side = 2.0 * np.sqrt(count)
    return np.random.default_rng(0).uniform((0.0, 0.0, 0.5), (side, side, 6.0), (count, 3))


def cpu_of(processes: list[int]) -> float:
    """Seconds that processes have used."""
    fields = [
        Path(f'/proc/{one}/stat').read_text().rpartition(')')[2].split() for one in processes
    ]
    return sum(int(user) + int(system) for *_, user, system in (f[:13] for f in fields)) / TICK


def chromium_part(kind: str) -> list[int]:
    found = []
    for path in Path('/proc').glob('[0-9]*'):
        with contextlib.suppress(OSError):
            words = (path / 'cmdline').read_bytes().decode(errors='replace')
            if f'--type={kind}' in words and 'headless' in words:
                found.append(int(path.name))
    return found


def page(count: int, moving: bool) -> None:
    """What reaches a browser without a graphics card, and who takes how long for it."""
    from view import chromium, pages

    browser = chromium.open_browser(1200, 760)
    with pages.shown(Boxes(count, moving)) as shown:
        pages.visit(browser, shown, count)
        ended = threading.Event()
        turning = threading.Thread(target=turn, args=(shown, ended))
        if not moving:
            turning.start()
        time.sleep(SETTLED)
        parts = {'rendering': 'gpu-process', "the page's program": 'renderer'}
        used = {name: chromium_part(kind) for name, kind in parts.items()} | {'us': [os.getpid()]}
        script = 'return {...window.counted}'
        began, sent, before = time.monotonic(), shown.sent, browser.execute_script(script)
        cpu = {name: cpu_of(processes) for name, processes in used.items()}
        time.sleep(SECONDS)
        after, seconds = browser.execute_script(script), time.monotonic() - began
        pictures = max(after['pictures'] - before['pictures'], 1)
        print(f'{count} boxes, {"moving" if moving else "static"}: a second', end=' ')
        print(f'{(shown.sent - sent) / seconds:.1f} updates sent,', end=' ')
        print(f'{(after["updates"] - before["updates"]) / seconds:.1f} applied,', end=' ')
        print(f'{pictures / seconds:.1f} pictures shown')
        for name, processes in used.items():
            whole = cpu_of(processes) - cpu[name]
            each = whole / (max(shown.sent - sent, 1) if name == 'us' else pictures)
            print(f'  {name}: {whole / seconds:.2f} of a core, {1e3 * each:.0f} ms each')
        ended.set()
        if not moving:
            turning.join()
    browser.quit()


def turn(shown: Any, ended: threading.Event) -> None:
    """Move the camera 20 times a second, as a hand does."""
    from view import pages

    camera = pages.camera_of(shown)
    middle, place = np.array(camera.look_at), np.array(camera.position)
    while not ended.wait(1.0 / RATE):
        angle = 0.3 * np.sin(time.monotonic())
        c, s = np.cos(angle), np.sin(angle)
        camera.position = middle + (place - middle) @ np.array([(c, s, 0), (-s, c, 0), (0, 0, 1)])


def publish(namespace: str, count: int) -> None:
    """Publish markers that move, RATE times a second."""
    import rclpy
    from rclpy.serialization import serialize_message
    from visualization_msgs.msg import Marker, MarkerArray

    rclpy.init()
    node = rclpy.create_node('publisher', namespace=namespace)
    publisher = node.create_publisher(MarkerArray, 'bvh/obstacles', 10)
    array = MarkerArray()
    at = places(count)
    for number, (_, y, z) in enumerate(at):
        marker = Marker(ns='box', id=number, type=Marker.CUBE)
        marker.header.frame_id = 'map'
        marker.pose.position.x, marker.pose.position.y, marker.pose.position.z = PLACE, y, z
        marker.scale.x = marker.scale.y = marker.scale.z = 1.0
        array.markers.append(marker)
    serialised = bytes(serialize_message(array))
    starts = [one.start() for one in re.finditer(re.escape(struct.pack('<d', PLACE)), serialised)]
    rows = np.array(starts)[:, None] + np.arange(8)
    message = np.frombuffer(serialised, np.uint8).copy()
    due = time.monotonic()
    while True:
        x = at[:, 0] + np.sin(time.monotonic())
        message[rows] = x.view(np.uint8).reshape(rows.shape)
        publisher.publish(message.tobytes())
        due = max(due + 1.0 / RATE, time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))


def listen(namespace: str) -> None:
    """Subscribe to what RViz shows, and to the obstacles, as RViz does."""
    import rclpy
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from visualization_msgs.msg import MarkerArray

    rclpy.init()
    node = rclpy.create_node('rviz', namespace=namespace)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    for topic, qos in (('obstacles', 10), ('scene', latched), ('queries', latched)):
        name = f'{namespace}/bvh/{topic}'
        node.create_subscription(MarkerArray, name, lambda message: None, qos, raw=True)
    rclpy.spin(node)


@contextlib.contextmanager
def beside(*command: str) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen([sys.executable, *command], stdout=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


def node_costs(count: int) -> None:
    """What the node takes of a core: alone, beside a view, beside what listens as RViz does."""
    import rclpy

    from bvh_ros.client import BvhClient
    from bvh_ros.ros.running import running_node, wait_until_ready

    space = f'/rates{os.getpid()}'
    rclpy.init()
    node = rclpy.create_node('rates', namespace=space)
    watchers: dict[str, Callable[[], Any]] = {
        'nobody looks': contextlib.nullcontext,
        'bvh_view': lambda: beside('-m', 'bvh_ros.view.main', f'{space}/bvh'),
        'a subscriber of obstacles, scene and queries': lambda: beside(__file__, 'listen', space),
    }
    with running_node(space, {}) as process:
        wait_until_ready(BvhClient(node), process)
        with beside(__file__, 'publish', space, str(count)):
            for name, watch in 2 * [*watchers.items()]:
                with watch() as other:
                    time.sleep(2.0 * SETTLED)
                    ids = [process.pid] + ([] if other is None else [other.pid])
                    before, began = [cpu_of([one]) for one in ids], time.monotonic()
                    time.sleep(SECONDS)
                    used = np.array([cpu_of([one]) for one in ids]) - before
                    shares = used / (time.monotonic() - began)
                    print(f'{name}: the node {shares[0]:.2f} of a core', *shares[1:], flush=True)
    node.destroy_node()
    rclpy.shutdown()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('what', choices=('page', 'node', 'publish', 'listen'))
    parser.add_argument('rest', nargs='+')
    parser.add_argument('--static', action='store_true')
    options = parser.parse_args()
    if options.what == 'page':
        page(int(options.rest[0]), not options.static)
    elif options.what == 'node':
        node_costs(int(options.rest[0]))
    elif options.what == 'publish':
        publish(options.rest[0], int(options.rest[1]))
    else:
        listen(options.rest[0])


if __name__ == '__main__':
    main()
