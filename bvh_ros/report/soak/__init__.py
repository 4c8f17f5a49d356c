# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report soak`: the node for half an hour under load, every answer checked, memory watched.

The node, the publisher of a thousand moving boxes and this process, which asks, talk over ROS 2.
"""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from ..page import Page
from ..progress import bar
from .record import Record

if TYPE_CHECKING:
    from rclpy.node import Node

ASKED = 100.0  # questions a second
STEP = 5.0  # seconds between two moves of the progress bar


def run(page: Page, minutes: float) -> int:
    """Soak; returns how many answers were wrong, and one more if memory grew."""
    from bvh_ros.ros import running

    with (
        (page.folder / 'soak_node.log').open('wb') as log,
        running.served('soak', log=log) as (client, process),
    ):
        record = Record(process.pid)
        with publishing(client.node.get_namespace()):
            ask_on(client.node, record, max(1, int(60.0 * minutes / STEP)))
    return record.write(page)


def ask_on(node: 'Node', record: Record, steps: int) -> None:
    """Ask at an even pace."""
    from .asking import Asker

    asker = Asker(node, record.hear)
    began = now = time.monotonic()
    for step in bar(range(1, steps + 1), lambda _: record.in_short()):
        while now < began + step * STEP:
            record.add(asker.ask(), now)
            time.sleep(max(0.0, now + 1.0 / ASKED - time.monotonic()))
            now = time.monotonic()


@contextmanager
def publishing(namespace: str) -> Iterator[None]:
    """Publish the soak's world in a process of its own."""
    from .publisher import __name__ as module

    process = subprocess.Popen([sys.executable, '-m', module, namespace], start_new_session=True)
    try:
        yield
    finally:
        process.kill()
        process.wait()
