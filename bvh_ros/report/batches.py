# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of every size and kind of rays, with Embree on the same in the same run."""

from collections.abc import Iterator
from importlib.util import find_spec
from itertools import cycle
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
SIZES = 1, 4, 15, 16, 64, 255, 256, 1_024, 4_096, 20_000, 100_000
RAYS, TURNS, REPEATS = 200_000, 4_096, 9
LIDAR, PLANE = (64, 512), (1, 681)  # rows and beams a row of a scan
PLACES = 0.2, 0.3, 0.4, 0.5  # m, on the cube's diagonal
ANYWHERE = 'from anywhere'
PEERS = 'bvh_ros', 'Embree', 'Embree, triangle alone'


class Batch(NamedTuple):
    """What is cast at once."""

    origins: Floats
    directions: Floats
    t_max: float = np.inf


def scan(rows: int, beams: int, place: float) -> Batch:
    """A scan from near the middle: `rows` from 0.4 rad below the horizon to as much above."""
    across = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    up = np.linspace(-0.4, 0.4, rows) if rows > 1 else np.zeros(1)
    up, across = np.repeat(up, beams), np.tile(across, rows)
    flat = np.cos(up)
    directions = np.stack([flat * np.cos(across), flat * np.sin(across), np.sin(up)], axis=1)
    return Batch(np.full(directions.shape, place), directions)


def every_batch(brief: bool) -> Iterator[tuple[str, list[Batch]]]:
    """By kind, in every size: batches of other rays that take turns."""
    origins, directions = incoherent_rays(200 if brief else RAYS, np.random.default_rng(3))
    beyond = np.add(origins, (0.0, 0.0, 2.0 * EDGE))
    kinds = {
        ANYWHERE: Batch(origins, directions),
        'segments of 1 m': Batch(origins, directions, 1.0),
        'segments of 5 m': Batch(origins, directions, 5.0),
        'all miss': Batch(beyond, np.abs(directions)),
    }
    for count in (1, 20) if brief else SIZES:
        starts = range(0, min(len(origins), TURNS * count) - count + 1, count)
        for kind, every in kinds.items():
            begin, way, reach = every
            yield kind, [Batch(begin[k : k + count], way[k : k + count], reach) for k in starts]
    for kind, shape in (('lidar scan', LIDAR), ('scan in a plane', PLANE)):
        yield kind, [scan(*((2, 10) if brief else shape), place) for place in PLACES]


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
        for kind, turns in every_batch(brief):
            times = _times(tree, scene, turns, brief)
            over = [times[0] / time for time in times[1:]]
            rows.append([size, kind, len(turns[0].origins), *times, *over])
    page.add('### Batches of rays')
    page.add(
        'One call with as many rays, all in, others each time: the same again and again are '
        'learnt by the processor. bvh_ros takes float64 and returns id, distance and '
        'normal, as Embree does from float32 arrays that are ready (`run(..., output=True)`); '
        'the *triangle alone* is what its default query returns.'
    )
    columns = [*(f'{name}, us' for name in PEERS), *(f'ours / {name}' for name in PEERS[1:])]
    page.table(Table('peers_batches', ['boxes', 'rays', 'in a batch', *columns], rows))
    _plot(page.plot('peers_batches', 'Time a ray against rays in a batch, from anywhere'), rows)


def _times(tree: DynamicBVH, scene: Any, turns: list[Batch], brief: bool) -> list[float]:
    """Microseconds a call, in the order of `PEERS`."""
    reach, ours = turns[0].t_max if np.isfinite(turns[0].t_max) else None, cycle(turns)
    theirs = cycle([[np.float32(part) for part in turn[:2]] for turn in turns])
    runs = (
        lambda: tree.raycast_many(*next(ours)),
        lambda: scene.run(*next(theirs), dists=reach, output=True),
        lambda: scene.run(*next(theirs), dists=reach),
    )
    jobs = {name: many_times(Job(run, 1), brief) for name, run in zip(PEERS, runs, strict=True)}
    found = interleaved(jobs, 3 if brief else REPEATS, warm=not brief)
    return [found[name].nanoseconds / 1e3 for name in PEERS]


def _plot(path: Path, rows: list[list[Cell]]) -> None:
    from matplotlib.figure import Figure

    shown = {row[0]: [r for r in rows if r[:2] == [row[0], ANYWHERE]] for row in rows}
    figure = Figure(figsize=(4.6 * len(shown), 3.4), layout='constrained')
    panels = figure.subplots(1, len(shown), squeeze=False, sharey=True)[0]
    for axes, (size, points) in zip(panels, shown.items(), strict=True):
        counts = np.array([row[2] for row in points])
        for column, name in enumerate(PEERS, 3):
            axes.plot(counts, [row[column] for row in points] / counts, 'o-', label=name)
        axes.set(xscale='log', yscale='log', xlabel='rays in a batch', title=f'{size:,} boxes')
        axes.xaxis.set_major_formatter('{x:,.0f}')
        axes.yaxis.set_major_formatter('{x:g}')
        axes.yaxis.set_minor_formatter('')
        axes.grid(alpha=0.3, which='both')
    panels[0].set_ylabel('us a ray')
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
