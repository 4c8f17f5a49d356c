# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes within boxes and balls, pairs of two trees, nearest to a box, exits of rays: against brute
force in exact arithmetic.
"""

import math
from fractions import Fraction

import numpy as np
import pytest
from tree.reference import LARGEST, SMALLEST, is_within_2_ulp, squared_distance

from bvh_ros import ALL, DynamicBVH

SCALES = [SMALLEST, 1e-160, 0.1, 1e160, LARGEST / 32]


def lattice(rng, count, ndim, scale):
    """Boxes that meet and coincide, flat ones too."""
    lo = rng.integers(-5, 6, (count, ndim))
    return lo * scale, (lo + rng.integers(0, 3, lo.shape)) * scale


@pytest.mark.parametrize('ndim', [2, 3])
def test_contains(ndim):
    rng = np.random.default_rng(ndim)
    for scale in SCALES:
        lo, hi = lattice(rng, 80, ndim, scale)
        masks = rng.integers(0, 4, 80)
        tree = DynamicBVH.from_boxes(lo, hi, mask=masks, margin=scale / 4)
        found = 0
        for low, high in zip(*lattice(rng, 60, ndim, scale), strict=True):
            high = np.minimum(high + scale * 4, LARGEST)
            mask = int(rng.choice([ALL, 1]))
            rows = (low <= lo).all(axis=1) & (hi <= high).all(axis=1) & (masks & mask != 0)
            ids = tree.contains(low, high, mask)
            assert ids.tolist() == tree.ids()[rows].tolist()
            found += len(ids)
        assert found


@pytest.mark.parametrize('ndim', [2, 3])
def test_query_ball(ndim):
    """Radii that are a distance exactly, and their neighbours among the doubles."""
    rng = np.random.default_rng(ndim + 10)
    for scale in SCALES:
        lo, hi = lattice(rng, 50, ndim, scale)
        masks = rng.integers(1, 4, 50)
        tree = DynamicBVH.from_boxes(lo, hi, mask=masks)
        points = rng.integers(-6, 7, (60, ndim)) * scale
        radii = rng.choice([0.0, 1.0, 2.0, math.sqrt(2), 5.0], 60) * scale
        radii = np.nextafter(radii, rng.choice([0.0, LARGEST], 60), where=radii > 0, out=radii)
        seen = rng.choice([1, ALL], 60).astype(np.uint32)
        for threads in (1, 3):
            offsets, ids = tree.query_ball(points, radii, seen, threads)
            for i, (point, r) in enumerate(zip(points, radii.tolist(), strict=True)):
                squares = [squared_distance(*box, point) for box in zip(lo, hi, strict=True)]
                rows = np.array([square <= Fraction(r) ** 2 for square in squares])
                rows &= masks & seen[i] != 0
                assert ids[offsets[i] : offsets[i + 1]].tolist() == tree.ids()[rows].tolist()
    assert tree.query_ball(np.empty((0, ndim)), 1.0)[0].tolist() == [0]
    one = tree.query_ball(points[:2], float(scale))
    assert one[0].tolist() == tree.query_ball(points[:2], [scale] * 2)[0].tolist()


@pytest.mark.parametrize('ndim', [2, 3])
def test_pairs_with_another_tree(ndim):
    rng = np.random.default_rng(ndim + 20)
    lo, hi = lattice(rng, 60, ndim, 0.1)
    low, high = lattice(rng, 45, ndim, 0.1)
    masks, others = rng.integers(1, 4, 60), rng.integers(1, 4, 45)
    tree = DynamicBVH.from_boxes(lo, hi, mask=masks, margin=0.3)
    other = DynamicBVH.from_boxes(low, high, mask=others)
    for mask in (ALL, 1):
        touching = ((lo[:, None] <= high) & (low <= hi[:, None])).all(axis=2)
        touching &= ((masks & mask) != 0)[:, None] & ((others & mask) != 0)
        ours, theirs = np.nonzero(touching)
        expected = np.column_stack((tree.ids()[ours], other.ids()[theirs]))
        assert tree.pairs_with(other, mask).tolist() == expected.tolist()
        assert len(expected)
    assert other.pairs_with(tree).tolist() == sorted(tree.pairs_with(other)[:, ::-1].tolist())
    assert tree.pairs_with(DynamicBVH(ndim)).shape == (0, 2)
    for wrong in (DynamicBVH(5 - ndim), None, lo):
        with pytest.raises(ValueError, match='other'):
            tree.pairs_with(wrong)


@pytest.mark.parametrize('ndim', [2, 3])
def test_nearest_to_a_box(ndim):
    rng = np.random.default_rng(ndim + 30)
    lo, hi = lattice(rng, 80, ndim, 1.0)
    tree = DynamicBVH.from_boxes(lo, hi, margin=0.5)
    for low, high in zip(*lattice(rng, 60, ndim, 1.0), strict=True):
        gaps = np.maximum(np.maximum(lo - high, low - hi), 0.0)
        squares = (gaps**2).sum(axis=1)
        order = np.lexsort((tree.ids(), squares))[:7]
        for box in ((low, high), [low.tolist(), high.tolist()], np.array([low, high])):
            ids, distances = tree.nearest(box, 7)
            assert ids.tolist() == tree.ids()[order].tolist()
            assert distances.tolist() == np.sqrt(squares[order]).tolist()
        reach = float(distances[3])
        assert (tree.nearest((low, high), 80, reach)[1] <= reach).all()
    for box in ([hi[0], lo[0] - 1], [[math.nan] * ndim] * 2, [[0.0]] * 2, np.zeros((3, ndim))):
        with pytest.raises(ValueError, match='point'):
            tree.nearest(box)


@pytest.mark.parametrize('ndim', [2, 3])
def test_exits(ndim):
    rng = np.random.default_rng(ndim + 40)
    for scale in SCALES:
        lo, hi = lattice(rng, 60, ndim, scale)
        tree = DynamicBVH.from_boxes(lo, hi, margin=scale)
        origins = rng.integers(-8, 9, (80, ndim)) * scale
        directions = rng.integers(-2, 3, (80, ndim)) * rng.choice([1.0, 0.3, 7e-3])
        offsets, ids, ts = tree.raycast_all_many(origins, directions)
        rays = np.repeat(np.arange(80), np.diff(offsets))
        exits = tree.exits(origins[rays], directions[rays], ids)
        rows = np.searchsorted(tree.ids(), ids)
        for ray, row, t, t_exit in zip(rays, rows, ts, exits.tolist(), strict=True):
            leave = []
            for axis in np.flatnonzero(directions[ray]):
                plane = (hi if directions[ray, axis] > 0 else lo)[row, axis]
                way = Fraction(plane) - Fraction(origins[ray, axis])
                leave.append(way / Fraction(directions[ray, axis]))
            if leave:
                assert is_within_2_ulp(t_exit, min(leave))
                assert t_exit >= t or is_within_2_ulp(t_exit, Fraction(t))
            else:
                assert t_exit == math.inf
        assert len(ids) > 20
    assert np.isnan(tree.exits(origins[:1], directions[:1], [-1])).all()
    with pytest.raises(KeyError):
        tree.exits(origins[:1], directions[:1], [10**9])
    with pytest.raises(ValueError, match='ids'):
        tree.exits(origins[:2], directions[:2], [-1])
