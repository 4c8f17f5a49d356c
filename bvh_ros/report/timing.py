# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Timing: jobs take turns and the median counts, so that what else the machine does hits all."""

import statistics
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

WARM_SECONDS = 0.01


class Job(NamedTuple):
    """A piece of work that can be repeated."""

    run: Callable[[], Any]
    """What is timed."""
    units: int
    """How many rays, boxes or queries one run answers."""
    answers: Callable[[Any], int] | None = None
    """Counts the answers of a run (hits, pairs), to compare what was answered; not timed."""


class Timing(NamedTuple):
    """What a job took."""

    nanoseconds: float
    """Median over the repeats, a unit."""
    answers: int | None
    """Answers of the first run."""


def seconds(run: Callable[[], Any]) -> float:
    """How long one run takes."""
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def _warm_up(job: Job) -> None:
    until = time.perf_counter() + WARM_SECONDS
    job.run()
    while time.perf_counter() < until:
        job.run()


def interleaved(jobs: Mapping[str, Job], repeats: int, warm: bool = False) -> dict[str, Timing]:
    """Run the jobs in turns, after an untimed run each.

    `warm`: untimed runs for some milliseconds before every timed one, so that short jobs don't pay
    for what the job before them has driven from the caches.
    """
    first = {name: job.run() for name, job in jobs.items()}
    counts = {
        name: job.answers(first[name]) if job.answers else None for name, job in jobs.items()
    }
    took: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(repeats):
        for name, job in jobs.items():
            if warm:
                _warm_up(job)
            took[name].append(seconds(job.run) / job.units)
    return {
        name: Timing(statistics.median(times) * 1e9, counts[name]) for name, times in took.items()
    }


def memory(process: int | str = 'self') -> float:
    """Resident memory of a process, MB; FileNotFoundError if it has ended."""
    status = Path(f'/proc/{process}/status').read_text(encoding='utf-8')
    return int(status.partition('VmRSS:')[2].split()[0]) / 1024
