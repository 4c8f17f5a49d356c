# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Many boxes at every scale and speed, and rays at their corners, against whole numbers."""

from collections.abc import Iterable
from fractions import Fraction
from typing import Any

import numpy as np

from ... import DynamicBVH
from ..scenes import Boxes, Floats, Rays
from .case import Case, within_2_ulp
from .rays import Motion, exact_entry

SCALES = (5e-324, 1e-300, 1e-160, 1e-3, 1.0, 1e8, 1e15, 1e150, 1e307)
BOXES, MANY, RAYS, RAYS_QUICK = 24, 250, 400, 70
Entries = list[Fraction | None]


def scale_cases(brief: bool) -> Iterable[Case]:
    """One case a scale, then scales mixed in one scene."""
    count = RAYS_QUICK if brief else RAYS
    for scale in SCALES:
        boxes, rays = corner_scene(np.random.default_rng(1), np.full((BOXES, 1), scale), count)
        yield _compare(f'corner rays at scale {scale:g}', boxes, rays)
    ratio = 10.0 ** np.linspace(-15, 15, BOXES)[:, None]
    boxes, rays = corner_scene(np.random.default_rng(2), ratio, count)
    yield _compare('scales 1e-15 to 1e15 in one scene', boxes, rays)
    ends = np.resize([5e-324, 1e-308, 1e-150, 1.0, 1e150, 1e307], BOXES)[:, None]
    boxes, rays = corner_scene(np.random.default_rng(3), ends, count)
    yield _compare('5e-324 to 1.7e308 in one scene', boxes, rays)
    yield _at_all_speeds(BOXES if brief else MANY, RAYS_QUICK if brief else 10 * RAYS)


def _at_all_speeds(count: int, asked: int) -> Case:
    rng = np.random.default_rng(4)
    boxes, rays = corner_scene(rng, np.ones((count, 1)), asked)
    speeds = rng.integers(-2, 3, (count, 3)) * np.geomspace(1e-9, 1e4, count)[:, None]
    times = rng.choice([0.0, 1.0, -0.5], asked), rng.choice([0.0, 1.0, 0.5], asked)
    return _compare('1e-9 to 1e4 m/s in one scene', boxes, rays, speeds, times)


def corner_scene(rng: np.random.Generator, scales: Floats, count: int) -> tuple[Boxes, Rays]:
    """Boxes on a lattice of their own scale, some flat, and rays at their corners from lattice
    points before them.
    """
    low = rng.integers(-6, 6, (len(scales), 3))
    high = low + rng.integers(0, 4, low.shape)
    lo, hi = low * scales, high * scales
    rows = rng.integers(0, len(scales), count)
    corners = np.where(rng.random((count, 3)) < 0.5, low[rows], high[rows])
    steps = rng.integers(-2, 3, (count, 3))
    steps[~steps.any(axis=1)] = (1, 1, 2)
    origins = (corners - steps * rng.integers(1, 4, (count, 1))) * scales[rows]
    lengths = np.where(rng.random((count, 1)) < 0.5, scales[rows], 1.0)
    directions = steps.astype(np.float64) * lengths
    return Boxes(lo, hi), Rays(origins, directions)


def _compare(
    name: str,
    boxes: Boxes,
    rays: Rays,
    velocities: Floats | None = None,
    times: tuple[Floats, Floats] | None = None,
) -> Case:
    """Cast one by one and in a batch; times = (at, pace)."""
    tree, count = DynamicBVH.from_boxes(*boxes), len(rays.origins)
    if velocities is None:
        velocities = np.zeros_like(boxes.lo)
    else:
        tree.set_velocities(tree.ids(), velocities)
    at, pace = times or np.zeros((2, count))
    tree.validate()
    slots = {handle: row for row, handle in enumerate(tree.ids().tolist())}
    rows = list(zip(*(x.tolist() for x in (*rays, at, pace)), strict=True))
    sides = list(zip(*(x.tolist() for x in (*boxes, velocities)), strict=True))
    firsts = [_first([_entry(box, row) for box in sides]) for row in rows]
    batch, wrong = tree.raycast_many(*rays, at=at, pace=pace), 0
    for ray, (first, row) in enumerate(zip(firsts, rows, strict=True)):
        hit = tree.raycast(row[0], row[1], at=row[2], pace=row[3])
        singly = (slots[hit.id], hit.t) if hit else None
        handle = int(batch.ids[ray])
        together = (slots[handle], float(batch.t[ray])) if handle >= 0 else None
        wrong += not (_right(singly, first) and _right(together, first))
    hits = sum(first is not None for first in firsts)
    asked = f'{len(boxes.lo)} boxes, {count:,} rays: {len(boxes.lo) * count:,} exact entries'
    got = f'{int((batch.ids >= 0).sum())} hits, {wrong} wrong'
    return Case(name, asked, f'{hits} hits, 0 wrong', got, wrong == 0)


def _entry(box: tuple[Any, ...], row: tuple[Any, ...]) -> Fraction | None:
    (lo, hi, velocity), (origin, direction, *times) = box, row
    return exact_entry(lo, hi, origin, direction, Motion(velocity, *times))


def _first(entries: Entries) -> tuple[Fraction, int] | None:
    met = [(t, row) for row, t in enumerate(entries) if t is not None]
    return min(met) if met else None


def _right(answer: tuple[int, float] | None, first: tuple[Fraction, int] | None) -> bool:
    if answer is None or first is None:
        return answer is None and first is None
    return answer[0] == first[1] and within_2_ulp(answer[1], first[0])
