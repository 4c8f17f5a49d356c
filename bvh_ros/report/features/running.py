# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs workloads, each in a process of its own."""

import json
import statistics
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...scene import Shapes
from ..scenes import Floats

WORKLOAD = Path(__file__).with_name('workload.py')


class ObstacleField(NamedTuple):
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
    moving: bool = False
    turns: int = 9


def run_apart(job: Job) -> dict[str, Any]:
    """Run a workload: its figures (the fastest turn counts: what disturbs one makes it slower),
    the kernels that it compiled or loaded, and what it imported.
    """
    result = subprocess.run(
        [sys.executable, str(WORKLOAD), json.dumps(job._asdict(), default=str)],
        capture_output=True,
        text=True,
        check=False,
    )
    if result.returncode:
        raise RuntimeError(f'a workload failed: {result.stderr}')
    told: dict[str, Any] = json.loads(result.stdout.splitlines()[-1])
    return told


def run_in_turns(jobs: Mapping[str, Job], repeats: int) -> dict[str, dict[str, Any]]:
    """Medians of every job's figures, after an untimed round, which compiles what is not compiled
    yet.
    """
    for job in jobs.values():
        run_apart(job._replace(turns=1))
    told: dict[str, list[dict[str, Any]]] = {name: [] for name in jobs}
    for _ in range(repeats):
        for name, job in jobs.items():
            told[name].append(run_apart(job))
    return {
        name: runs[0] | {
            key: statistics.median(run[key] for run in runs)
            for key, value in runs[0].items()
            if isinstance(value, float)
        }
        for name, runs in told.items()
    }  # fmt: skip
