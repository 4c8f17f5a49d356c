# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calls: what one call from Python costs, all in, next to the same work in a batch."""

from collections.abc import Callable
from itertools import cycle
from typing import Any

import numpy as np

from ... import DynamicBVH
from ..page import Page
from ..scenes import Boxes, Rays, incoherent_rays, uniform_boxes
from ..tables import Cell, Table
from ..timing import Job, Timing, interleaved

BOXES, CALLS, REPEATS = 10_000, 2_000, 5


def calls(page: Page, brief: bool) -> None:
    """Measure."""
    size, count = (300, 50) if brief else (BOXES, CALLS)
    times = interleaved(_jobs(size, count), REPEATS, warm=True)
    names = list(dict.fromkeys(name.partition(' ')[0] for name in times))
    rows: list[list[Cell]] = [
        [name, *(_microseconds(times, f'{name} {form}') for form in ('one', 'batch'))]
        for name in names
    ]
    page.add('### Calls')
    page.add(
        f'{size:,} boxes, {count:,} calls, each with rows of numpy arrays. '
        '*move* is to a place nearby and back.'
    )
    page.table(Table('speed_calls', ('method', 'us a call', 'us a row in a batch'), rows))


def _microseconds(times: dict[str, Timing], name: str) -> float | None:
    return times[name].nanoseconds / 1e3 if name in times else None


def _each(function: Callable[..., Any], *columns: Any) -> Callable[[], None]:
    rows = list(zip(*columns, strict=True))

    def run() -> None:
        for row in rows:
            function(*row)

    return run


def _jobs(size: int, calls: int) -> dict[str, Job]:
    rng = np.random.default_rng(1)
    boxes, rays = uniform_boxes(size, rng), incoherent_rays(calls, rng)
    near = uniform_boxes(calls, rng)
    return _question_jobs(boxes, rays, near, calls) | _change_jobs(boxes, min(calls, size))


def _question_jobs(boxes: Boxes, rays: Rays, near: Boxes, calls: int) -> dict[str, Job]:
    tree = DynamicBVH.from_boxes(*boxes)
    runs = {
        'raycast one': _each(tree.raycast, *rays),
        'raycast batch': lambda: tree.raycast_many(*rays),
        'occluded one': _each(tree.occluded, *rays),
        'occluded batch': lambda: tree.occluded_many(*rays),
        'overlap one': _each(tree.overlap, *near),
        'overlap batch': lambda: tree.overlap_many(*near),
        'boxcast one': _each(tree.boxcast, *near, near.hi - near.lo),
        'nearest one': _each(tree.nearest, near.lo),
        'nearest batch': lambda: tree.nearest_many(near.lo),
    }
    return {name: Job(run, calls) for name, run in runs.items()}


def _change_jobs(boxes: Boxes, count: int) -> dict[str, Job]:
    one, batch = DynamicBVH.from_boxes(*boxes), DynamicBVH.from_boxes(*boxes)
    rows, away = one.ids()[:count], cycle((0.5, 0.0))
    low, high = boxes.lo[:count], boxes.hi[:count]

    def move_one() -> None:
        shift = next(away)
        for handle, lo, hi in zip(rows.tolist(), low + shift, high + shift, strict=True):
            one.move(handle, lo, hi)

    def move_batch() -> None:
        shift = next(away)
        batch.move_many(rows, low + shift, high + shift)

    def insert_and_remove_one() -> None:
        for handle in [one.insert(lo, hi) for lo, hi in zip(low, high, strict=True)]:
            one.remove(handle)

    return {
        'move one': Job(move_one, count),
        'move batch': Job(move_batch, count),
        'insert+remove one': Job(insert_and_remove_one, count),
    }
