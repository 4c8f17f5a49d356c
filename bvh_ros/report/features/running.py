# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs workloads in processes of their own: one scene each, or several side by side."""

import json
import statistics
import subprocess
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...scene import Shapes
from ..scenes import Floats

WORKLOAD = Path(__file__).with_name('workload.py')
ROOT = Path(__file__).resolve().parents[3]  # where the package is that runs now
TURNS_ALONE = 9

Figures = dict[str, float]
Turns = dict[str, list[float]]


class World(NamedTuple):
    """Obstacles, and segments to ask about."""

    shapes: Shapes
    starts: Floats
    goals: Floats
    triangles: Floats | None = None
    """Of the mesh that all obstacles are; None if they are none."""

    def save(self, folder: Path, name: str) -> Path:
        """Write it where a workload can read it."""
        path = folder / f'{name}.npz'
        columns = {**self.shapes._asdict(), **self._asdict()}
        del columns['shapes']
        np.savez(path, **{name: column for name, column in columns.items() if column is not None})
        return path


class Job(NamedTuple):
    """A configuration of a scene, see `workload`."""

    file: Path
    planar: bool = False
    margin: float = 0.0
    masks: bool = False
    batch: int = 0
    package: str = 'bvh_ros'
    """The build to run."""
    path: Path = ROOT
    """The folder that it is in."""
    kernels: Path | None = None
    """Where it keeps its kernels, if not where everybody does: they remember its name."""


def run_in_turns(
    jobs: Mapping[str, Job], repeats: int, tick: Callable[[], None]
) -> dict[str, list[Figures]]:
    """What every run of every job took, each run in a process of its own: every job once, then all
    again, after an untimed round, which compiles what is not compiled yet. What disturbs a turn
    only makes it slower: the fastest counts.
    """
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda job: side_by_side({'': job}, 1), set(jobs.values())))
    took: dict[str, list[Figures]] = {name: [] for name in jobs}
    for _ in range(repeats):
        for name, job in jobs.items():
            turns = side_by_side({name: job}, TURNS_ALONE)[name]
            took[name].append({kind: min(times) for kind, times in turns.items()})
            tick()
    return took


def medians(runs: list[Figures]) -> Figures:
    """The median of each figure."""
    return {name: statistics.median(run[name] for run in runs) for name in runs[0]}


def side_by_side(jobs: Mapping[str, Job], turns: int) -> dict[str, Turns]:
    """Run jobs in one process, turn by turn."""
    given = {name: job._asdict() for name, job in jobs.items()}
    order = json.dumps({'jobs': given, 'turns': turns}, default=str)
    result = subprocess.run(
        [sys.executable, str(WORKLOAD), order], capture_output=True, text=True, check=False
    )
    if result.returncode:
        raise RuntimeError(f'a workload failed: {result.stderr}')
    took: dict[str, Turns] = json.loads(result.stdout.splitlines()[-1])
    return took
