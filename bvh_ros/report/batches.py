# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of every size and kind of rays, with Embree on the same in the same run."""

from collections.abc import Callable
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np

from .. import DynamicBVH
from . import timing
from .libraries.embree import Embree, triangles
from .page import Page
from .scenes import EDGE, Floats, incoherent_rays, uniform_boxes
from .tables import Cell, Table
from .timing import Job, Timing, interleaved

BOXES = 1_000, 10_000, 100_000
SIZES = 1, 4, 15, 16, 64, 255, 256, 1_024, 4_096, 20_000
LIDAR, PLANE = (64, 512), (1, 681)  # rows and beams a row of a scan
REPEATS = 9


class Batch(NamedTuple):
    """What is cast at once."""

    origins: Floats
    directions: Floats
    t_max: float


def scan(rows: int, beams: int) -> Batch:
    """A scan from near the middle: `rows` from 0.4 rad below the horizon to as much above."""
    across = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    up = np.linspace(-0.4, 0.4, rows) if rows > 1 else np.zeros(1)
    up, across = np.repeat(up, beams), np.tile(across, rows)
    flat = np.cos(up)
    directions = np.stack([flat * np.cos(across), flat * np.sin(across), np.sin(up)], axis=1)
    return Batch(np.full(directions.shape, 0.2), directions, np.inf)


def batches_of(count: int, rng: np.random.Generator) -> dict[str, Batch]:
    """Rays of every kind that comes in any number."""
    origins, directions = incoherent_rays(count, rng)
    return {
        'from anywhere': Batch(origins, directions, np.inf),
        'segments of 1 m': Batch(origins, directions, 1.0),
        'segments of 5 m': Batch(origins, directions, 5.0),
        'all miss': Batch(np.add(origins, (0.0, 0.0, 2.0 * EDGE)), np.abs(directions), np.inf),
    }


def batches(page: Page, brief: bool) -> None:
    """Measure every kind and size."""
    if find_spec(Embree.module) is None:
        page.add('Embree is not installed here, and so batches of rays are left out.')
        return
    rows: list[list[Cell]] = []
    for size in (300,) if brief else BOXES:
        ask = _asking(size)
        for count in (1, 20) if brief else SIZES:
            for kind, batch in batches_of(count, np.random.default_rng(count)).items():
                rows.append(_row(size, kind, batch, brief, ask))
        for kind, shape in (('lidar scan', LIDAR), ('scan in a plane', PLANE)):
            rows.append(_row(size, kind, scan(*((2, 10) if brief else shape)), brief, ask))
    page.add('### Batches of rays')
    page.add(
        'One call with as many rays, all in. Embree is given float32 arrays that are ready, and '
        'returns the triangle alone; bvh_ros takes float64 and returns id, distance and normal.'
    )
    header = ('boxes', 'rays', 'in a batch', 'bvh_ros, us', 'Embree, us', 'ours / Embree')
    page.table(Table('peers_batches', header, rows))


def _asking(size: int) -> Callable[[Batch], dict[str, Job]]:
    """Return what makes the jobs of a batch in a scene of so many boxes."""
    boxes = uniform_boxes(size, np.random.default_rng(0))
    tree, scene = DynamicBVH.from_boxes(*boxes), Embree().scene(triangles(boxes))
    warm = incoherent_rays(max(size, 100), np.random.default_rng(1))
    tree.raycast_many(*warm)

    def jobs(batch: Batch) -> dict[str, Job]:
        parts = [np.ascontiguousarray(part, np.float32) for part in batch[:2]]
        if np.isfinite(batch.t_max):
            parts.append(np.full(len(parts[0]), batch.t_max, np.float32))
        return {
            'ours': Job(lambda: tree.raycast_many(*batch), 1),
            'Embree': Job(lambda: scene.run(*parts), 1),
        }

    return jobs


def _row(
    size: int, kind: str, batch: Batch, brief: bool, jobs: Callable[[Batch], dict[str, Job]]
) -> list[Cell]:
    found: dict[str, Timing] = interleaved(
        {name: many_times(job, brief) for name, job in jobs(batch).items()},
        3 if brief else REPEATS,
        warm=True,
    )
    ours, theirs = found['ours'].nanoseconds / 1e3, found['Embree'].nanoseconds / 1e3
    return [size, kind, len(batch.origins), ours, theirs, ours / theirs]


def many_times(job: Job, brief: bool) -> Job:
    """So often that the clock's own time is none of it."""
    job.run()
    times = 1 if brief else max(1, int(1e-3 / timing.seconds(job.run)))

    def run() -> None:
        for _ in range(times):
            job.run()

    return Job(run, times * job.units)
