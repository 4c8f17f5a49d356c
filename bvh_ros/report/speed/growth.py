# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Growth: time and memory a box, and time a ray, from a thousand to a million boxes."""

import resource

import numpy as np

from ... import DynamicBVH
from ..page import Page
from ..scenes import incoherent_rays, uniform_boxes
from ..tables import Table
from ..timing import Job, interleaved

SIZES = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
SIZES_QUICK = (100, 1_000)
RAYS, REPEATS = 20_000, 5
HEADER = (
    'boxes', 'ns a ray', 'ns a ray, 2 threads', 'ns a box, built', 'bytes a box', 'height',
    '4 log2 n + 4', 'tree cost',
)  # fmt: skip


def growth(page: Page, brief: bool) -> None:
    """Measure."""
    rows = []
    for size in SIZES_QUICK if brief else SIZES:
        rows.append(_row(size, 200 if brief else RAYS))
    page.add('### Growth')
    page.add(
        'Uniform boxes that fill 2 % of the cube; incoherent rays in batches, after so many that '
        'the wide snapshot was worth building; margin 0. '
        '*bytes a box*: the arrays of a tree built at this size. The process has used '
        f'{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:,.0f} MB at most.'
    )
    page.table(Table('speed_growth', HEADER, rows))


def _row(size: int, asked: int) -> list[int | float]:
    rng = np.random.default_rng(size)
    boxes, rays = uniform_boxes(size, rng), incoherent_rays(asked, rng)
    tree = DynamicBVH.from_boxes(*boxes)
    while not tree.stats()['wide_snapshot']:
        tree.raycast_many(*rays)
    jobs = {
        'one': Job(lambda: tree.raycast_many(*rays), asked),
        'two': Job(lambda: tree.raycast_many(*rays, threads=2), asked),
        'build': Job(lambda: DynamicBVH.from_boxes(*boxes), size),
    }
    timings = interleaved(jobs, REPEATS, warm=True)
    times = {name: timing.nanoseconds for name, timing in timings.items()}
    bytes_a_box = DynamicBVH.from_boxes(*boxes).stats()['bytes'] / size
    bound = 4 * float(np.log2(size)) + 4
    return [size, *times.values(), bytes_a_box, tree.height, bound, tree.cost()]
