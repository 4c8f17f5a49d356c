# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of every size and kind of rays, with Embree on the same in the same run."""

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .. import DynamicBVH
from . import timing
from .libraries.embree import Embree, triangles
from .page import Page
from .scenes import EDGE, Floats, incoherent_rays, uniform_boxes
from .tables import Cell, Table
from .timing import Job, interleaved

BOXES = 1_000, 10_000, 100_000
SIZES = 1, 4, 15, 16, 64, 255, 256, 1_024, 4_096, 20_000
LIDAR, PLANE = (64, 512), 681  # rows and beams a row of a scan
REPEATS = 9
ANYWHERE = 'from anywhere'
PEERS = 'bvh_ros', 'Embree', 'Embree, triangle alone'


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
        ANYWHERE: Batch(origins, directions, np.inf),
        'segments of 1 m': Batch(origins, directions, 1.0),
        'segments of 5 m': Batch(origins, directions, 5.0),
        'all miss': Batch(np.add(origins, (0.0, 0.0, 2.0 * EDGE)), np.abs(directions), np.inf),
    }


def every_batch(brief: bool) -> Iterator[tuple[str, Batch]]:
    """By kind, in every size."""
    for count in (1, 20) if brief else SIZES:
        yield from batches_of(count, np.random.default_rng(count)).items()
    yield 'lidar scan', scan(*((2, 10) if brief else LIDAR))
    yield 'scan in a plane', scan(1, 10 if brief else PLANE)


def batches(page: Page, brief: bool) -> None:
    """Measure every kind and size."""
    if find_spec(Embree.module) is None:
        page.add('Embree is not installed here, and so batches of rays are left out.')
        return
    rows: list[list[Cell]] = []
    for size in (300,) if brief else BOXES:
        boxes = uniform_boxes(size, np.random.default_rng(0))
        tree, scene = DynamicBVH.from_boxes(*boxes), Embree().scene(triangles(boxes))
        tree.raycast_many(*incoherent_rays(max(size, 100), np.random.default_rng(1)))
        for kind, batch in every_batch(brief):
            times = _times(tree, scene, batch, brief)
            over = [times[0] / time for time in times[1:]]
            rows.append([size, kind, len(batch.origins), *times, *over])
    page.add('### Batches of rays')
    page.add(
        'One call with as many rays, all in. bvh_ros takes float64 and returns id, distance and '
        'normal, as Embree does from float32 arrays that are ready (`run(..., output=True)`); '
        'the *triangle alone* is what its default query returns.'
    )
    columns = [*(f'{name}, us' for name in PEERS), *(f'ours / {name}' for name in PEERS[1:])]
    page.table(Table('peers_batches', ['boxes', 'rays', 'in a batch', *columns], rows))
    _plot(page.plot('peers_batches', 'Time a ray against rays in a batch, from anywhere'), rows)


def _times(tree: DynamicBVH, scene: Any, batch: Batch, brief: bool) -> list[float]:
    """Microseconds a call, in the order of `PEERS`."""
    rays = [np.ascontiguousarray(part, np.float32) for part in batch[:2]]
    reach = batch.t_max if np.isfinite(batch.t_max) else None
    runs = (
        lambda: tree.raycast_many(*batch),
        lambda: scene.run(*rays, dists=reach, output=True),
        lambda: scene.run(*rays, dists=reach),
    )
    jobs = {name: many_times(Job(run, 1), brief) for name, run in zip(PEERS, runs, strict=True)}
    found = interleaved(jobs, 3 if brief else REPEATS, warm=True)
    return [found[name].nanoseconds / 1e3 for name in PEERS]


def _plot(path: Path, rows: list[list[Cell]]) -> None:
    from matplotlib.figure import Figure

    shown = {row[0]: [r for r in rows if r[:2] == [row[0], ANYWHERE]] for row in rows}
    figure = Figure(figsize=(4 * len(shown), 3.4), layout='constrained')
    panels = figure.subplots(1, len(shown), squeeze=False)[0]
    for axes, (size, points) in zip(panels, shown.items(), strict=True):
        counts = np.array([row[2] for row in points])
        for column, name in enumerate(PEERS, 3):
            axes.plot(counts, [row[column] for row in points] / counts, 'o-', label=name)
        axes.set(xscale='log', yscale='log', xlabel='rays in a batch', ylabel='us a ray')
        axes.set_title(f'{size:,} boxes')
    panels[0].legend()
    figure.savefig(path)


def many_times(job: Job, brief: bool) -> Job:
    """So often that the clock's own time is none of it."""
    job.run()
    times = 1 if brief else max(1, int(1e-3 / timing.seconds(job.run)))

    def run() -> None:
        for _ in range(times):
            job.run()

    return Job(run, times * job.units)
