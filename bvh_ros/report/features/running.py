# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Workloads in turns: every job once, then all again, each in a new process; medians count."""

import json
import os
import statistics
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...scene import Shapes
from ..scenes import Floats

WORKLOAD = Path(__file__).with_name('workload.py')
ROOT = Path(__file__).resolve().parents[3]  # where the package is that runs now

Figures = dict[str, float]


class World(NamedTuple):
    """Obstacles, and segments to ask about."""

    shapes: Shapes
    starts: Floats
    goals: Floats

    def save(self, folder: Path, name: str) -> Path:
        """Write it where a workload can read it."""
        path = folder / f'{name}.npz'
        columns = {name: c for name, c in self.shapes._asdict().items() if c is not None}
        np.savez(path, starts=self.starts, goals=self.goals, **columns)
        return path


class Job(NamedTuple):
    """A configuration of a scene, see `workload`."""

    file: Path
    planar: bool = False
    margin: float = 0.0
    masks: bool = False
    batch: int = 0
    without: tuple[str, ...] = ()


def run_in_turns(
    jobs: Mapping[str, Job], repeats: int, tick: Callable[[], None]
) -> dict[str, list[Figures]]:
    """What every run of every job took."""
    took: dict[str, list[Figures]] = {name: [] for name in jobs}
    for _ in range(repeats):
        for name, job in jobs.items():
            took[name].append(_run(job))
            tick()
    return took


def medians(runs: list[Figures]) -> Figures:
    """The median of each figure."""
    return {name: statistics.median(run[name] for run in runs) for name in runs[0]}


def _run(job: Job) -> Figures:
    order = json.dumps({**job._asdict(), 'file': str(job.file)})
    result = subprocess.run(
        [sys.executable, str(WORKLOAD), order],
        env={**os.environ, 'PYTHONPATH': str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    if result.returncode:
        raise RuntimeError(f'a workload failed: {result.stderr}')
    figures: Figures = json.loads(result.stdout.splitlines()[-1])
    return figures
