# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report peers`: other libraries on the same work in the same run."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from . import batches, timing
from .calls import calls
from .libraries import LIBRARIES, Library
from .libraries.base import Work, make_work
from .page import Page
from .tables import Cell, Table
from .timing import Timing, interleaved


class Task(NamedTuple):
    """One kind of work."""

    name: str
    """Name of the libraries' method, and of the table."""
    title: str
    unit: str
    """What a figure is a time of."""
    answers: str
    """What was counted, to see that all gave the same answer."""
    sizes: tuple[int, ...]
    asked: int
    """Rays, queries or points."""


MIDDLE, GROWING = (10_000,), (1_000, 10_000, 100_000)
TASKS = (
    Task('cast', 'Cast rays: the first box on each', 'ns a ray', 'hits', GROWING, 20_000),
    Task('frame', 'Move all boxes a little, then 1,000 rays', 'ns a frame', 'hits', MIDDLE, 1_000),
    Task('move_all', 'Move all boxes a little', 'ns a box', '', MIDDLE, 1),
    Task('move_some', 'Move 1 box in 32 to anywhere', 'ns a box', '', MIDDLE, 1),
    Task('build', 'Build from nothing', 'ns a box', 'boxes', MIDDLE, 1),
    Task('overlap', 'Overlaps of a small box', 'ns a query', 'hits', MIDDLE, 20_000),
    Task('pairs', 'All pairs of boxes that overlap', 'ns a box', 'pairs', MIDDLE, 1),
    Task('nearest', 'Nearest of many points', 'ns a query', 'mm in sum', MIDDLE, 20_000),
)  # fmt: skip
REPEATS, REPEATS_QUICK = 15, 3


def quick(task: Task) -> Task:
    """The same kind of work in a small form."""
    return task._replace(sizes=(300,), asked=min(task.asked, 200))


def all_tasks(page: Page, brief: bool) -> None:
    """Measure every task that two or more installed libraries can do."""
    libraries = [library for library in LIBRARIES if library.installed()]
    page.add(_introduction(libraries))
    with one_processor():
        for task in TASKS:
            found = measure(quick(task) if brief else task, libraries, brief)
            page.add(f'### {task.title}')
            page.table(table(task, found))


def _introduction(libraries: list[Library]) -> str:
    absent = [library.name for library in LIBRARIES if library not in libraries]
    notes = [f'- **{library.name}**: {library.note}.' for library in libraries]
    missing = f'Not installed here, and so left out: {", ".join(absent)}.'
    head = (
        'Boxes of random proportions that fill 2 % of a cube of 100 m; rays from anywhere to '
        'anywhere. One processor. The libraries take turns, each with untimed runs for '
        f'{timing.WARM_SECONDS * 1e3:.0f} ms before the timed one, and the medians of the '
        'turns are shown. *ours / this* below 1: bvh_ros is faster.'
    )
    return '\n'.join([head, '', *notes, '', missing if absent else 'All peers are installed.'])


@contextmanager
def one_processor() -> Iterator[None]:
    """Keep this process on one processor: some libraries would use more, unasked."""
    if not hasattr(os, 'sched_setaffinity'):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def measure(task: Task, libraries: list[Library], brief: bool) -> dict[int, dict[str, Timing]]:
    """Timings by number of boxes and by library."""
    found = {}
    for size in task.sizes:
        work: Work = make_work(size, task.asked)
        jobs = {
            library.name: getattr(library, task.name)(work)
            for library in libraries
            if hasattr(library, task.name)
        }
        repeats = REPEATS_QUICK if brief else REPEATS
        found[size] = interleaved(jobs, repeats, warm=not brief)
    return found


def table(task: Task, found: dict[int, dict[str, Timing]]) -> Table:
    """One row a library; for each number of boxes the time, and ours over theirs."""
    header = ['library']
    for size in found:
        header += [f'{task.unit}, {size:,} boxes', 'ours / this']
    last = list(found)[-1]
    header += [task.answers] if task.answers else []
    rows: list[list[Cell]] = []
    for name in found[last]:
        row: list[Cell] = [name]
        for timings in found.values():
            ours = timings['bvh_ros'].nanoseconds
            row += [timings[name].nanoseconds, ours / timings[name].nanoseconds]
        row += [found[last][name].answers] if task.answers else []
        rows.append(row)
    return Table(f'peers_{task.name}', header, rows)


INTRODUCTION = '## Peers'
ON_ONE = one_processor()(batches.batches)
SECTIONS = {'all tasks': all_tasks, 'batches of rays': ON_ONE, 'calls': calls}
