# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes and rays that float64 arithmetic decides wrongly: corners, edges, faces, lattices, thirds,
one ulp off, extreme scales.
"""

import math

import numpy as np
import pytest
from tree.reference import LARGEST, SMALLEST, ExactHit, Floats

MIXED = 0.0  # the scale that means all of them at once
SCALES = (1e-300, 1e-160, 1e-3, 1.0, 1e8, 1e15, 1e150, MIXED)

# What directions are multiplied with, exactly or not.
LENGTHS = (1.0, 1.0, 1.0, 0.5, 1 / 3, 3.0, 1e-3, 1e-100, 1e100, 1e-190, 1e190, 1e300)

each_scale = pytest.mark.parametrize(
    'scale', SCALES, ids=lambda s: 'mixed' if s == MIXED else f'{s:g}'
)
each_ndim = pytest.mark.parametrize('ndim', [2, 3], ids=['2D', '3D'])

Rng = np.random.Generator


def coordinates(rng: Rng, shape: tuple[int, ...], scale: float) -> Floats:
    """Lattice points, thirds, tenths and any doubles, times the scale."""
    whole = rng.integers(-4, 5, shape).astype(float)
    kinds = [whole, whole / 3, whole * 0.1, rng.uniform(-4, 4, shape)]
    values = np.choose(rng.choice(4, shape, p=[0.4, 0.2, 0.2, 0.2]), kinds)
    if scale != MIXED:
        return values * scale
    decades = rng.choice([-323, -308, -300, -160, -30, -1, 0, 1, 15, 150, 307], shape)
    return values * 10.0 ** (decades // 2) * 10.0 ** (decades - decades // 2)


def nudge(rng: Rng, values: Floats, share: float) -> Floats:
    """Move that share of the values by one ulp."""
    away = np.where(rng.random(values.shape) < 0.5, -np.inf, np.inf)
    with np.errstate(over='ignore'):
        return finite(
            np.where(rng.random(values.shape) < share, np.nextafter(values, away), values)
        )


def finite(values: Floats) -> Floats:
    return np.clip(np.nan_to_num(values, nan=0.0), -LARGEST, LARGEST)


def some_boxes(rng: Rng, count: int, ndim: int, scale: float) -> tuple[Floats, Floats]:
    """Boxes with many common faces; some flat, points, coincident, one ulp apart."""
    a, b = coordinates(rng, (count, ndim), scale), coordinates(rng, (count, ndim), scale)
    b = np.where(rng.random((count, ndim)) < 0.15, a, b)
    b = np.where(rng.random((count, 1)) < 0.05, a, b)
    a, b = nudge(rng, a, 0.15), nudge(rng, b, 0.15)
    twins = rng.random(count) < 0.1
    others = rng.integers(0, count, count)
    a[twins], b[twins] = a[others[twins]], b[others[twins]]
    return np.minimum(a, b), np.maximum(a, b)


def rays_at(rng: Rng, lo: Floats, hi: Floats, count: int, scale: float) -> tuple[Floats, Floats]:
    """Rays aimed at corners, edges and faces of the boxes."""
    shape = (count, lo.shape[1])
    rows = rng.integers(0, len(lo), count)
    middle = lo[rows] * 0.5 + hi[rows] * 0.5
    targets = np.choose(rng.choice(3, shape, p=[0.4, 0.4, 0.2]), [lo[rows], hi[rows], middle])
    whole = rng.integers(-3, 4, shape).astype(float)
    # Zero components and origins in the plane of a face.
    origins = np.where(rng.random(shape) < 0.2, targets, coordinates(rng, shape, scale))
    with np.errstate(over='ignore', under='ignore', invalid='ignore'):
        directions = finite(targets - origins)
        # As often a simple direction, and the origin some steps before the target.
        size = np.where(
            rng.random((count, 1)) < 0.5, 1.0, np.abs(coordinates(rng, (count, 1), scale))
        )
        steps = whole * size
        simple = rng.random((count, 1)) < 0.4
        before = finite(targets - steps * rng.choice([0, 1, 2, 3, 4, 100, 999], (count, 1)))
        origins = np.where(simple, before, origins)
        directions = np.where(simple, steps, directions)
        directions = finite(directions * rng.choice(LENGTHS, (count, 1)))
    tiny = SMALLEST * rng.integers(-3, 4, shape)
    directions = np.where(rng.random(shape) < 0.02, tiny, directions)
    directions[rng.random(count) < 0.02] = 0.0
    origins, directions = nudge(rng, origins, 0.1), nudge(rng, directions, 0.1)
    return signed_zeros(rng, origins), signed_zeros(rng, directions)


def signed_zeros(rng: Rng, values: Floats) -> Floats:
    return np.where((values == 0.0) & (rng.random(values.shape) < 0.5), -0.0, values)


def reaches(rng: Rng, hits: list[list[ExactHit]]) -> Floats:
    """A t_max for every ray: at a hit, one ulp beside it, or anything."""
    reach = rng.choice(
        [np.inf, 0.0, SMALLEST, 1.0, LARGEST], len(hits), p=[0.4, 0.1, 0.1, 0.3, 0.1]
    )
    for row, of_ray in enumerate(hits):
        if of_ray and rng.random() < 0.7:
            t = of_ray[rng.integers(len(of_ray))].t
            nearest = float(t) if t <= LARGEST else LARGEST
            reach[row] = math.nextafter(nearest, rng.choice([0.0, nearest, np.inf]))
    return reach
