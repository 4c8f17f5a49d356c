# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Timing: jobs take turns and the median counts, so that what else the machine does hits all."""

import os
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

WARM_SECONDS = 0.01
CALL_SECONDS = 1e-3  # shorter jobs are repeated so long: the clock's own time is none of it


class Job(NamedTuple):
    """A piece of work that can be repeated."""

    run: Callable[[], Any]  # what is timed
    units: int  # how many rays, boxes or queries one run answers
    # Counts the answers of a run (hits, pairs), to compare what was answered; not timed.
    answers: Callable[[Any], int] | None = None


class Timing(NamedTuple):
    """What a job took."""

    nanoseconds: float  # median over the repeats, a unit
    answers: int | None  # answers of the first run

    @property
    def microseconds(self) -> float:
        """The same in us."""
        return self.nanoseconds / 1e3


def seconds(run: Callable[[], Any]) -> float:
    """How long one run takes."""
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def each(function: Callable[..., Any], *columns: Any) -> Job:
    """Call it with each row of the columns."""
    rows = list(zip(*columns, strict=True))

    def run() -> None:
        for row in rows:
            function(*row)

    return Job(run, len(rows))


def repeated(job: Job) -> Job:
    """The job so many times that one run takes a millisecond."""
    job.run()
    times = max(1, int(CALL_SECONDS / seconds(job.run)))

    def run() -> None:
        for _ in range(times):
            job.run()

    return Job(run, times * job.units)


def interleaved(jobs: Mapping[str, Job], repeats: int, warm: bool = True) -> dict[str, Timing]:
    """Run the jobs in turns, after an untimed run each.

    `warm`: untimed runs for some milliseconds before every timed one, so that short jobs don't pay
    for what the job before them has driven from the caches.
    """
    first = {name: job.run() for name, job in jobs.items()}
    times: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(repeats):
        for name, job in jobs.items():
            until = time.perf_counter() + WARM_SECONDS if warm else 0.0
            while time.perf_counter() < until:
                job.run()
            times[name].append(seconds(job.run) / job.units)
    return {
        name: Timing(
            statistics.median(times[name]) * 1e9, job.answers(first[name]) if job.answers else None
        )
        for name, job in jobs.items()
    }


def alone(run: Callable[[], Any], units: int, repeats: int) -> Timing:
    """Time one job as `interleaved` does."""
    return interleaved({'': Job(run, units)}, repeats)['']


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


def memory(process: int | str = 'self') -> float:
    """Resident memory of a process, MB; FileNotFoundError if it has ended."""
    status = Path(f'/proc/{process}/status').read_text(encoding='utf-8')
    return int(status.partition('VmRSS:')[2].split()[0]) / 1024
