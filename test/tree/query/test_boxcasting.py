# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A box swept along a way: decided as real arithmetic decides, at every scale."""

from fractions import Fraction

import numpy as np
import pytest
from tree.adversary import SCALES, Rng, coordinates, each_scale, nudge, rays_at, some_boxes
from tree.reference import (
    INSIDE,
    LARGEST,
    SMALLEST,
    ExactHit,
    Floats,
    effort,
    exact_sweeps,
    is_within_2_ulp,
    seen,
)

from bvh_ros import ALL, DynamicBVH, RayHit


def sweeps_at(
    rng: Rng, lo: Floats, hi: Floats, count: int, scale: float
) -> tuple[Floats, Floats, Floats]:
    """Boxes of which a corner, or a side on some axes, flies at corners, edges and faces."""
    corner, way = rays_at(rng, lo, hi, count, scale)
    size = np.abs(coordinates(rng, corner.shape, scale))
    size = np.where(rng.random(corner.shape) < 0.2, 0.0, size)
    leading = rng.random(corner.shape) < 0.7
    back = np.where(leading == (way > 0.0), -1.0, 1.0)
    with np.errstate(over='ignore'):
        other = np.clip(corner + back * size, -LARGEST, LARGEST)
    corner = nudge(rng, corner, 0.05)
    return np.minimum(corner, other), np.maximum(corner, other), way


def check_hit(hit: RayHit, exact: ExactHit, boxes: tuple[Floats, ...], way: Floats) -> None:
    """Everything that is promised of a hit but its handle; boxes: the obstacle's lo and hi, and
    the swept one's.
    """
    lo, hi, low, high = boxes
    normal = np.zeros(len(lo))
    if exact.axis != INSIDE:
        normal[exact.axis] = -np.sign(way[exact.axis])
        face = (lo if way[exact.axis] > 0 else hi)[exact.axis]
        assert hit.point[exact.axis] == face
    assert hit.normal.tolist() == normal.tolist()
    assert is_within_2_ulp(hit.t, exact.t)
    assert (lo <= hit.point).all()
    assert (hit.point <= hi).all()
    for axis, (got, move) in enumerate(zip(hit.point.tolist(), way.tolist(), strict=True)):
        if axis == exact.axis:
            continue
        centre = (Fraction(low[axis]) + Fraction(high[axis])) / 2
        place = centre + exact.t * Fraction(move)
        place = min(max(place, Fraction(lo[axis])), Fraction(hi[axis]))
        slack = (abs(centre) + abs(exact.t * Fraction(move))) * Fraction(2, 10**15)
        slack += Fraction(SMALLEST) * (4 + 4 * abs(Fraction(move)))
        assert abs(Fraction(got) - place) <= slack


@each_scale
@pytest.mark.parametrize('ndim', [2, 3], ids=['2D', '3D'])
def test_sweeps_are_decided_exactly(ndim: int, scale: float) -> None:
    """Whatever the tree: built at once, with a margin, inserted backwards; and with masks."""
    rng = np.random.default_rng([11, ndim, SCALES.index(scale)])
    lo, hi = some_boxes(rng, 20, ndim, scale)
    low, high, ways = sweeps_at(rng, lo, hi, effort(300, 20_000), scale)
    masks = rng.choice([1, 2, 3], 20).astype(np.uint32)
    plain, fat = DynamicBVH.from_boxes(lo, hi, mask=masks), DynamicBVH(ndim, margin=0.25)
    backwards = np.array(
        [fat.insert(*box) for box in zip(lo[::-1], hi[::-1], masks[::-1], strict=True)]
    )[::-1]
    entered = set()
    for i, hits in enumerate(exact_sweeps(lo, hi, low, high, ways)):
        for tree, handles in ((plain, plain.ids()), (fat, backwards)):
            for mask in (ALL, 2):
                expected = seen(hits, handles, visible=masks & mask != 0)
                hit = tree.boxcast(low[i], high[i], ways[i], mask)
                assert (hit is None) == (not expected), i
                if hit is not None:
                    row = expected[0].row
                    assert hit.id == handles[row], i
                    check_hit(hit, expected[0], (lo[row], hi[row], low[i], high[i]), ways[i])
                    entered.add(expected[0].axis)
    assert entered == {INSIDE, *range(ndim)}


def test_it_counts_as_a_ray() -> None:
    tree = DynamicBVH.from_boxes([[1 / 3, 1 / 3]], [[1, 1]])
    tree.boxcast([0, 0], [0, 0], [1, 1])
    assert (tree.stats()['rays'], tree.stats()['rays_decided_exactly']) == (1, 1)


def test_an_empty_tree_is_free() -> None:
    assert DynamicBVH(3).boxcast([0, 0, 0], [1, 1, 1], [1, 1, 1]) is None
