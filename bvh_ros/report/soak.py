# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report soak`: a node under load; every answer is checked, memory is watched."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from .page import Cell, Page, Table, bar
from .timing import memory

if TYPE_CHECKING:
    from rclpy.node import Node

    from .soak_world import Answer

# ---- What a soak has seen, and its verdict.


FLAT = 0.02  # of the memory after the warm-up; more growth than this over the run is a leak
WARM_UP = 0.5  # of the run: what is allocated once is not growth
SHOWN = 10  # wrong answers on the page


class Record:
    """Counts answers, and watches the memory of the node.

    Parameters
    ----------
    pid : int
        Process of the node.
    """

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._looks: list[tuple[float, float]] = []  # minutes, MB
        self._began = time.monotonic()
        self.faults: list[str] = []
        self._frames: set[int] = set()
        self._seconds: list[float] = []
        self._told: dict[str, str] = {}
        self._next_look = 0.0
        self.look()

    def add(self, answer: 'Answer', now: float) -> None:
        """One question was asked; look at the memory once a second."""
        if now >= self._next_look:
            self.look()
            self._next_look = now + 1.0
        self._seconds.append(answer.took)
        self._frames.add(answer.frame)
        if answer.fault:
            self.faults.append(answer.fault)

    def look(self) -> None:
        """Sample the node's resident memory; FileNotFoundError if it has ended."""
        self._looks.append(((time.monotonic() - self._began) / 60.0, memory(self._pid)))

    def growth(self) -> float:
        """MB an hour: slope of a straight line through all after the warm-up (least squares)."""
        minutes, megabytes = np.array(self._looks[int(WARM_UP * len(self._looks)) :]).T
        return float(60.0 * np.polyfit(minutes, megabytes, 1)[0]) if len(minutes) > 1 else 0.0

    def hear(self, diagnostics: Any) -> None:
        """Remember what the node says about its source of markers."""
        for status in diagnostics.status:
            if status.name.endswith('source markers'):
                self._told = {pair.key: pair.value for pair in status.values}

    def in_short(self) -> str:
        """One line for the progress bar."""
        return (
            f'soak: {len(self._seconds)} answers, {len(self.faults)} wrong, '
            f'{self._looks[-1][1]:.0f} MB'
        )

    def write(self, page: Page) -> int:
        """Add a section to the page; returns the number of faults."""
        milliseconds, growth = 1e3 * np.array(self._seconds), self.growth()
        minutes, megabytes = zip(*self._looks, strict=True)
        settled = megabytes[int(WARM_UP * len(megabytes))]
        page.add('## Soak')
        page.add(
            'A thousand boxes, half of them turning, come and go at 30 Hz, published by a process '
            'of its own. The answers to random rays, balls and boxes are held against brute force '
            'on the frame that the reply says it knows of.'
        )
        rows: list[tuple[str, Cell]] = [
            ('length [min]', minutes[-1]),
            ('answers', len(self._seconds)),
            ('wrong answers', len(self.faults)),
            ('different frames asked about', len(self._frames)),
            ('messages that the node took', self._told.get('messages', '')),
            ('refused', self._told.get('refused', '')),
            ('round trip, p50 [ms]', float(np.percentile(milliseconds, 50))),
            ('round trip, p99 [ms]', float(np.percentile(milliseconds, 99))),
            ('round trip, slowest [ms]', float(milliseconds.max())),
            ('memory of the node after warm-up [MB]', settled),
            ('memory at the end [MB]', megabytes[-1]),
            ('growth [MB an hour]', growth),
        ]
        page.table(Table('soak', ('', 'measured'), rows))
        for fault in self.faults[:SHOWN]:
            page.add(f'Wrong: {fault}')
        leak = growth * minutes[-1] / 60.0 > FLAT * settled
        page.add(f'**{len(self.faults)} wrong answers; memory {"grows" if leak else "is flat"}.**')
        return len(self.faults) + leak


ASKED = 100.0  # questions a second
STEP = 5.0  # seconds between two moves of the progress bar


def run(page: Page, minutes: float) -> int:
    """Soak; returns how many answers were wrong, and one more if memory grew."""
    from ..ros import running

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
    from .soak_world import Asker

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
    from .soak_world import __name__ as module

    process = subprocess.Popen([sys.executable, '-m', module, namespace], start_new_session=True)
    try:
        yield
    finally:
        process.kill()
        process.wait()
