# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A node under load; every answer is checked, memory is watched.

A thousand boxes, half of them turning, come and go at 30 Hz, published by a process of its own.
The answers to random rays, balls and boxes are compared with brute force on the frame that the
reply says it knows of.
"""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from .page import Cell, Page, bar
from .timing import memory

ASKED = 100.0  # questions a second
STEP = 5.0  # seconds between two moves of the progress bar
FLAT = 0.02  # of the memory after the warm-up; more growth than this over the run is a leak
WARM_UP = 0.5  # of the run: what is allocated once is not growth
SHOWN = 10  # wrong answers on the page


def run(page: Page, minutes: float) -> int:
    """Soak; returns how many answers were wrong, and one more if memory grew."""
    from diagnostic_msgs.msg import DiagnosticArray

    from ..ros import running
    from .soak_world import Answer, Asker

    answers, levels = list[Answer](), list[tuple[float, float]]()  # minutes, MB
    figures: dict[str, str] = {}  # of the source of markers, as the node reports them

    def note(message: Any) -> None:
        for status in message.status:
            if status.name.endswith('source markers'):
                figures.update({pair.key: pair.value for pair in status.values})

    def progress(_step: int) -> str:
        wrong = sum(bool(answer.fault) for answer in answers)
        return f'soak: {len(answers)} answers, {wrong} wrong, {levels[-1][1]:.0f} MB'

    with (
        (page.folder / 'soak_node.log').open('wb') as log,
        running.served('soak', log=log) as (client, process),
        publishing(client.node.get_namespace()),
    ):
        asker = Asker(client.node)
        client.node.create_subscription(DiagnosticArray, '/diagnostics', note, 10)
        began = now = time.monotonic()
        levels.append((0.0, memory(process.pid)))
        for step in bar(range(1, max(1, int(60.0 * minutes / STEP)) + 1), progress):
            while now < began + step * STEP:
                answers.append(asker.ask())
                time.sleep(max(0.0, now + 1.0 / ASKED - time.monotonic()))
                now = time.monotonic()
                if now - began >= 60.0 * levels[-1][0] + 1.0:
                    levels.append(((now - began) / 60.0, memory(process.pid)))
    return _write(page, answers, np.array(levels), figures)


def _write(page: Page, answers: list[Any], levels: Any, figures: dict[str, str]) -> int:
    """Add the part to the page; returns the number of faults."""
    faults = [answer.fault for answer in answers if answer.fault]
    milliseconds = 1e3 * np.array([answer.seconds for answer in answers])
    minutes, megabytes = levels.T
    settled = int(WARM_UP * len(levels))
    # MB an hour: slope of a straight line through all after the warm-up (least squares).
    growth = 0.0
    if len(levels) > settled + 1:
        growth = float(60.0 * np.polyfit(minutes[settled:], megabytes[settled:], 1)[0])
    rows: dict[str, Cell] = {
        'length [min]': float(minutes[-1]),
        'answers': len(answers),
        'wrong answers': len(faults),
        'different frames asked about': len({answer.frame for answer in answers}),
        'messages that the node took': figures.get('messages', ''),
        'refused': figures.get('refused', ''),
        'round trip, p50 [ms]': float(np.percentile(milliseconds, 50)),
        'round trip, p99 [ms]': float(np.percentile(milliseconds, 99)),
        'round trip, slowest [ms]': float(milliseconds.max()),
        'memory of the node after warm-up [MB]': float(megabytes[settled]),
        'memory at the end [MB]': float(megabytes[-1]),
        'growth [MB an hour]': growth,
    }
    page.table('soak', ('', 'measured'), [*rows.items()])
    for fault in faults[:SHOWN]:
        page.add(f'Wrong: {fault}')
    leak = growth * minutes[-1] / 60.0 > FLAT * megabytes[settled]
    page.add(f'**{len(faults)} wrong answers; memory {"grows" if leak else "is flat"}.**')
    return len(faults) + int(leak)


@contextmanager
def publishing(namespace: str) -> Iterator[None]:
    """Publish the soak's world in a process of its own."""
    command = [sys.executable, '-m', 'bvh_ros.report.soak_world', namespace]
    process = subprocess.Popen(command, start_new_session=True)
    try:
        yield
    finally:
        process.kill()
        process.wait()
