# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of rays among boxes that go together: they are swept as who goes along sees them."""

from typing import NamedTuple

import numpy as np
import pytest
from tree.motion.checking import check_rows, one_by_one, tree_of
from tree.motion.exact import Course, Floats, World, meetings
from tree.motion.test_wide_casting import crowd
from tree.motion.worlds import Random
from tree.reference import effort, seen

from bvh_ros import ALL, DynamicBVH
from bvh_ros.tree.access import OpenTree

pytestmark = pytest.mark.slow  # kernels of its own

KINDS = 'together', 'spread', 'some', 'one', 'wild', 'outrageous'
UNITS, SPANS = (2.0**-20, 1.0, 2.0**20), (2.0**-30, 0.7, 1.0, 2.0**20)  # m, s
MOVES = ('together', 'spread', 'some', 'wild')  # kinds that sweeps go along with


class Rays(NamedTuple):
    origins: Floats
    ways: Floats
    limits: Floats
    at: Floats
    paces: Floats


def drifting(rng: Random, ndim: int, kind: str, count: int) -> tuple[World, Rays]:
    """Boxes of whole units that go whole units in a span, and so many rays, as hard to decide
    about as who goes along sees them: along planes and through corners, from the start of the span
    or to its end; some of both but for the last digits.
    """
    unit, span, n = rng.choice(UNITS), rng.choice(SPANS), 80
    begin = span * rng.choice([0.0, -0.5, 1000.0])
    drift = rng.integers(8, 40, ndim) * rng.choice([-1, 1], ndim)
    drift = drift * (rng.random(ndim) < 0.7)
    drift[0] = drift[0] or 16
    ways = np.tile(drift, (n, 1)).astype(float)
    ways[rng.random(n) < 0.3] += rng.integers(-1, 2, ndim) * (drift != 0.0)
    if kind == 'some':
        ways[rng.random(n) < 0.1] = 0.0
    elif kind == 'one':  # the others stay
        ways[1:] = 0.0
    elif kind == 'wild':  # all but one go together
        ways[3] *= 8.0
    elif kind == 'outrageous':
        ways[:] *= 2.0**30
    elif kind == 'spread':
        ways += rng.uniform(-1, 1, ways.shape)
    middle = rng.choice([0.0, 0.0, 1e6, 2.0**24]) * rng.choice([-1, 1], ndim)
    lo = rng.integers(-8, 9, (n, ndim)) + middle
    world = World(
        lo * unit,
        (lo + rng.integers(0, 4, lo.shape)) * unit,
        ways * unit / span,
        np.full(n, begin) + span * rng.integers(-1, 2, n) * (kind == 'together'),
    )
    fraction, paces = rng.choice([0.0, 0.5, 1.0], count), rng.choice([0.0, 0.5, 1.0], count)
    paces = np.where(fraction == 0.0, paces, -np.minimum(paces, fraction))
    gone = drift * fraction[:, None] if kind != 'one' else 0.0
    seen_from = rng.integers(-10, 11, (count, ndim)) + middle
    seen_way = rng.integers(-9, 10, (count, ndim)) * rng.choice([1.0, 1.0, 0.0], (count, 1))
    seen_way[:4] = 0.0  # which go along, or stand
    origins = (seen_from + gone) * unit
    directions = (seen_way + drift * paces[:, None]) * unit
    directions[::2] = np.where(directions[::2] == 0.0, -0.0, directions[::2])
    nudged = rng.random(count) < 0.3
    origins[nudged] *= 1.0 + rng.integers(-1, 2, (nudged.sum(), ndim)) * 2.0**-52
    directions[nudged] *= 1.0 + rng.integers(-1, 2, (nudged.sum(), ndim)) * 2.0**-52
    if rng.random() < 0.4:  # a scan, whose rays are sorted by where they go
        origins[:] = origins[-1]
    limits = rng.choice([1.0, 1.0, 0.5, 0.0], count)
    return world, Rays(origins, directions, limits, begin + span * fraction, span * paces)


def drift_of(tree: OpenTree) -> tuple[float, ...] | None:
    """At which what is swept goes, None if nothing is."""
    sweep = tree.motion.sweep
    return None if sweep is None else tuple(sweep.leaves.records['lo'][-1].tolist())


def check(rays: Rays, world: World, tree: DynamicBVH, skip: bool, few: bool) -> int:
    """Check a batch; return how many of it meet anything."""
    asked = rays.origins, rays.ways, rays.limits if not few else 1.0, ALL, skip
    times = {'at': rays.at, 'pace': rays.paces}
    if few:
        times = {name: float(column[0]) for name, column in times.items()}
    every = []
    for row, (origin, way) in enumerate(zip(rays.origins, rays.ways, strict=True)):
        at, pace = (float(column[0 if few else row]) for column in rays[3:])
        limit = 1.0 if few else float(rays.limits[row])
        exact = meetings(world, Course(origin, origin, way, at, pace))
        every.append(seen(exact, tree.ids(), limit, skip))
    hits, occluded = tree.raycast_many(*asked, **times), tree.occluded_many(*asked, **times)
    check_rows(tree, hits, occluded, every)
    return sum(map(bool, every))


def test_rows_are_those_of_exact_arithmetic():
    """Of all kinds, from micrometres in nanoseconds to 1000 km in weeks, each ray at its time, and
    few of them that go at the same.
    """
    rng, goes, met = np.random.default_rng(17), dict.fromkeys(KINDS, 0), 0
    for number in range(effort(48, 4800)):
        kind, ndim = KINDS[number % len(KINDS)], 2 + number // len(KINDS) % 2
        world, rays = drifting(rng, ndim, kind, 72)
        tree, skip = tree_of(world), number % 4 == 3
        met += check(rays, world, tree, skip, few=False)
        drift = drift_of(tree)
        goes[kind] += drift is not None and any(drift)
        some = Rays(*(column[4:20] for column in rays))
        met += check(some, world, tree, skip, few=True)
        if kind == 'together' and drift is not None:
            assert np.allclose(drift, world.velocities.mean(axis=0), rtol=1e-6, atol=0.0)
    assert met > 15 * effort(48, 4800)
    assert all(bool(count) == (kind in MOVES) for kind, count in goes.items())


@pytest.mark.parametrize(
    ('drift', 'own', 'swept', 'goes'),
    [
        ((0.0, 0.0), 100.0, True, False),
        ((100.0, 60.0), 0.1, True, True),
        ((100.0, 60.0), 50.0, True, True),
        ((100.0, 60.0), 200.0, True, False),
        ((3e4, 0.0), 0.1, False, False),
        ((1e30, 0.0), 0.0, False, False),
    ],
)
def test_who_goes_far_is_gone_along_with(
    drift: tuple[float, float], own: float, swept: bool, goes: bool
):
    """Where boxes go together, unless that is a thousand scenes in the span."""
    rng = np.random.default_rng(4)
    world = crowd(rng, 400, own)
    world = World(*world[:2], world.velocities + drift, np.zeros(400))
    tree, times = tree_of(world), {'at': 0.25, 'pace': 1.0}
    origins, ways = rng.uniform(-40, 80, (200, 2)), rng.normal(0, 30, (200, 2))
    origins[100:] += 0.25 * np.array(drift)
    for _ in range(3):
        hits = tree.raycast_many(origins, ways, 1.0, **times)
    gone = drift_of(tree)
    assert (gone is not None) == swept
    assert gone is None or any(gone) == goes
    found = list(zip(hits.ids.tolist(), hits.t.tolist(), strict=True))
    assert found == one_by_one(tree, origins, ways, times)
    assert not swept or sum(row != -1 for row, _ in found) > 20
    moments = tree.raycast_many(origins, ways, 1.0, at=0.25)  # no way to go along
    found = list(zip(moments.ids.tolist(), moments.t.tolist(), strict=True))
    assert found == one_by_one(tree, origins, ways, {'at': 0.25})
    assert drift_of(tree) in (None, (0.0, 0.0))
