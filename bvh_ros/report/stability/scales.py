# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scenes of many boxes at every scale, with rays at their corners, against brute force in whole
numbers.
"""

from collections.abc import Iterable
from fractions import Fraction

import numpy as np

from ... import DynamicBVH
from ..scenes import Boxes, Floats, Rays
from .case import Case, within_2_ulp
from .rays import exact_entry

SCALES = (5e-324, 1e-300, 1e-160, 1e-3, 1.0, 1e8, 1e15, 1e150, 1e307)
BOXES, RAYS, RAYS_QUICK = 24, 400, 70
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


def _compare(name: str, boxes: Boxes, rays: Rays) -> Case:
    """Cast one by one and in a batch."""
    tree = DynamicBVH.from_boxes(*boxes)
    tree.validate()
    slots = {handle: row for row, handle in enumerate(tree.ids().tolist())}
    entries = [_entries(boxes, *ray) for ray in zip(*rays, strict=True)]
    firsts = [_first(row) for row in entries]
    batch = tree.raycast_many(*rays)
    wrong = 0
    for ray, first in enumerate(firsts):
        hit = tree.raycast(rays.origins[ray], rays.directions[ray])
        singly = (slots[hit.id], hit.t) if hit else None
        handle = int(batch.ids[ray])
        together = (slots[handle], float(batch.t[ray])) if handle >= 0 else None
        wrong += not (_right(singly, first) and _right(together, first))
    hits = sum(first is not None for first in firsts)
    return Case(
        name,
        f'{len(boxes.lo)} boxes, {len(firsts)} rays',
        f'{hits} hits, 0 wrong',
        f'{int((batch.ids >= 0).sum())} hits, {wrong} wrong',
        wrong == 0,
    )


def _entries(boxes: Boxes, origin: Floats, direction: Floats) -> Entries:
    pairs = zip(boxes.lo.tolist(), boxes.hi.tolist(), strict=True)
    return [exact_entry(lo, hi, origin.tolist(), direction.tolist()) for lo, hi in pairs]


def _first(entries: Entries) -> tuple[Fraction, int] | None:
    met = [(t, row) for row, t in enumerate(entries) if t is not None]
    return min(met) if met else None


def _right(answer: tuple[int, float] | None, first: tuple[Fraction, int] | None) -> bool:
    if answer is None or first is None:
        return answer is None and first is None
    return answer[0] == first[1] and within_2_ulp(answer[1], first[0])
