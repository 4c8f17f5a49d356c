# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ray against box: the leaf's decision is exact, and the test of inner nodes never loses a hit."""

import math
from fractions import Fraction

import numpy as np
import pytest
from tree.adversary import (
    SCALES,
    coordinates,
    each_ndim,
    each_scale,
    nudge,
    rays_at,
    reaches,
    some_boxes,
)
from tree.reference import (
    INSIDE,
    LARGEST,
    SMALLEST,
    Floats,
    effort,
    exact_hits,
    is_within_2_ulp,
    seen,
)

from bvh_ros.tree.query.slab import (
    RAY_ROWS,
    compare_distances,
    compare_hits,
    intersect_exact,
    intersect_node,
    plane_distance,
    prepare_ray,
    set_ray,
    traversal_distance,
)


def ray_rows(origin: Floats, direction: Floats) -> Floats:
    """A ray with room for what `prepare_ray` and `intersect_exact` add."""
    rows = np.empty((RAY_ROWS, len(origin)))
    set_ray(rows, origin, direction)
    return rows


@each_scale
@each_ndim
def test_leaves_are_decided_exactly(ndim: int, scale: float) -> None:
    rng = np.random.default_rng([1, ndim, SCALES.index(scale)])
    lo, hi = some_boxes(rng, 12, ndim, scale)
    origins, directions = rays_at(rng, lo, hi, effort(100, 5000), scale)
    every = exact_hits(lo, hi, origins, directions)
    t_max = reaches(rng, every)
    for ray, hits in enumerate(every):
        rows = ray_rows(origins[ray], directions[ray])
        expected = {hit.row: hit for hit in seen(hits, np.arange(12), float(t_max[ray]))}
        for row in range(12):
            met, t, axis = intersect_exact(lo[row], hi[row], rows, t_max[ray])
            assert met == (row in expected)
            if met:
                assert axis == expected[row].axis
                assert is_within_2_ulp(t, expected[row].t)


@each_scale
@each_ndim
def test_two_hits_are_in_their_exact_order(ndim: int, scale: float) -> None:
    rng = np.random.default_rng([2, ndim, SCALES.index(scale)])
    lo, hi = some_boxes(rng, 12, ndim, scale)
    origins, directions = rays_at(rng, lo, hi, 200, scale)
    for ray, hits in enumerate(exact_hits(lo, hi, origins, directions)):
        rows = ray_rows(origins[ray], directions[ray])
        for a in hits:
            for b in hits[:4]:
                t_a, t_b = (intersect_exact(lo[h.row], hi[h.row], rows, np.inf)[1] for h in (a, b))
                order = compare_hits(
                    *(rows, lo[a.row], hi[a.row], (t_a, a.axis)),
                    *(lo[b.row], hi[b.row], (t_b, b.axis)),
                )
                assert order == (a.t > b.t) - (a.t < b.t)


@each_scale
@each_ndim
def test_inner_nodes_never_lose_a_hit(ndim: int, scale: float) -> None:
    """What the ray meets within t_max, it enters, at a distance that a hit below is not before by
    more than the padding.
    """
    rng = np.random.default_rng([3, ndim, SCALES.index(scale)])
    lo, hi = some_boxes(rng, 12, ndim, scale)
    origins, directions = rays_at(rng, lo, hi, effort(400, 20000), scale)
    bounds = lo.min(axis=0), hi.max(axis=0)
    for ray, hits in enumerate(exact_hits(lo, hi, origins, directions)):
        rows = ray_rows(origins[ray], directions[ray])
        power, wide = prepare_ray(rows, *bounds)
        for hit in hits:
            if hit.t > LARGEST:
                continue
            t = float(hit.t)
            t = (
                t if Fraction(t) >= hit.t else math.nextafter(t, math.inf)
            )  # the least t_max that counts
            entry = intersect_node(
                lo[hit.row], hi[hit.row], rows, traversal_distance(t, power), wide
            )
            assert entry < math.inf, (ray, hit)


@each_scale
def test_comparing_distances(scale: float) -> None:
    """(plane - origin) / direction against another, nearly equal one."""
    rng = np.random.default_rng([4, SCALES.index(scale)])
    signs = set()
    for _ in range(effort(2000, 100_000)):
        plane, origin, direction = coordinates(rng, (3,), scale)
        with np.errstate(over='ignore'):
            factor = rng.choice([1.0, -1.0, 2.0, 0.5, 3.0])
            other = nudge(
                rng, np.clip(np.array([plane, origin, direction]) * factor, -LARGEST, LARGEST), 0.2
            )
        ways = np.array([direction, other[2]])
        if not ways.all():
            continue
        exact = [
            (Fraction(p) - Fraction(o)) / Fraction(d)
            for p, o, d in ((plane, origin, direction), other.tolist())
        ]
        if min(exact) < 0:
            continue
        ts = plane_distance(plane, origin, direction), plane_distance(*other)
        got = compare_distances(ts[0], plane, origin, direction, ts[1], *other)
        assert all(is_within_2_ulp(t, e) for t, e in zip(ts, exact, strict=True))
        assert got == (exact[0] > exact[1]) - (exact[0] < exact[1])
        signs.add(got)
    assert signs == {-1, 0, 1}


DISTANCES = {
    # plane, origin, direction -> exact
    'simple': (3.0, 1.0, 4.0),
    'negative direction': (1.0, 3.0, -4.0),
    'the difference overflows': (LARGEST, -LARGEST, LARGEST),
    'the difference overflows, the quotient too': (LARGEST, -LARGEST, 1.0),
    'the quotient overflows': (1.0, 0.0, SMALLEST),
    'the quotient vanishes': (SMALLEST, 0.0, LARGEST),
    'subnormal': (3 * SMALLEST, 0.0, 2.0),
    'thirds': (1 / 3, 0.1, 0.7),
    'cancellation': (1.0, 1.0 - 2.0**-53, 3.0),
}


@pytest.mark.parametrize(
    ('plane', 'origin', 'direction'), DISTANCES.values(), ids=DISTANCES.keys()
)
def test_plane_distance(plane: float, origin: float, direction: float) -> None:
    exact = (Fraction(plane) - Fraction(origin)) / Fraction(direction)
    assert is_within_2_ulp(plane_distance(plane, origin, direction), exact)


def test_inside_is_an_axis_of_its_own() -> None:
    box = np.zeros(3), np.ones(3)
    assert intersect_exact(*box, ray_rows(np.full(3, 0.5), np.ones(3)), 0.0) == (True, 0.0, INSIDE)
