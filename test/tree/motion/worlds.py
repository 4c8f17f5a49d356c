# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Worlds of moving boxes that are hard to decide about, and courses through them."""

import math
from collections.abc import Iterator

import numpy as np
from tree.motion.exact import Course, Floats, World, meetings
from tree.reference import LARGEST

Random = np.random.Generator


def decades(rng: Random, shape: tuple[int, ...], least: float, most: float) -> Floats:
    """Numbers of both signs, their magnitudes spread over decades."""
    exponents = np.clip(rng.uniform(least, most, shape), -323, 308)
    return rng.choice([-1.0, 1.0], shape) * 10.0**exponents


def _boxes(middles: Floats, halves: Floats) -> tuple[Floats, Floats]:
    return middles - halves, middles + halves


def plain(rng: Random, ndim: int) -> tuple[World, Course]:
    """Metres, and speeds from 1e-9 to 1e4 m/s in one scene."""
    n = 12
    lo, hi = _boxes(rng.uniform(-9, 9, (n, ndim)), rng.uniform(0, 3, (n, ndim)))
    world = World(lo, hi, decades(rng, (n, ndim), -9, 4), rng.uniform(-1, 1, n))
    low = rng.uniform(-9, 9, ndim)
    way, at = decades(rng, (ndim,), -3, 3), float(rng.uniform(-2, 2))
    return world, Course(low, low + rng.choice([0.0, 1.0]), way, at, float(rng.choice([0, 1, -1])))


def whole_numbers(rng: Random, ndim: int) -> tuple[World, Course]:
    """Ties, touching faces, zero relative velocity, grazed edges: few whole numbers."""
    n = 12
    lo = rng.integers(-5, 5, (n, ndim)).astype(float)
    hi = lo + rng.integers(0, 4, (n, ndim))
    velocities = rng.integers(-2, 3, (n, ndim)).astype(float)
    world = World(lo, hi, velocities, rng.integers(-2, 3, n).astype(float))
    low = rng.integers(-5, 6, ndim).astype(float)
    way = rng.integers(-2, 3, ndim).astype(float)
    times = (float(x) for x in rng.integers(-2, 3, 2))
    return world, Course(low, low + rng.integers(0, 2, ndim), way, *times)


def grazing(rng: Random, ndim: int) -> tuple[World, Course]:
    """Rays through where corners of moving boxes will be, but for the rounding of it."""
    world, _ = plain(rng, ndim)
    world = World(*world[:2], decades(rng, world.lo.shape, -2, 2), world.references)
    way, at, pace = rng.normal(size=ndim), float(rng.uniform(-1, 1)), float(rng.uniform(-1, 1))
    row, t = rng.integers(len(world.lo)), rng.uniform(0, 2)
    corner = np.where(rng.random(ndim) < 0.5, world.lo[row], world.hi[row])
    there = corner + world.velocities[row] * (at + t * pace - world.references[row])
    low = there - t * way
    for other in rng.permutation(len(world.lo))[:4]:  # others that are met there, too
        if other != row:
            velocity = world.velocities[other]
            place = there - velocity * (at + t * pace - world.references[other])
            world.lo[other], world.hi[other] = place, place + rng.uniform(0, 1, ndim)
    return world, Course(low, low, way, at, pace)


def together(rng: Random, ndim: int) -> tuple[World, Course]:
    """Boxes that go as fast as the ray, or but for the last digits, on some axes."""
    world, course = grazing(rng, ndim)
    same = course.direction / course.pace
    nudged = same * (1 + rng.integers(-2, 3, world.lo.shape) * 2.0**-52)
    chosen = rng.random(world.lo.shape) < 0.6
    velocities = np.where(chosen, nudged, world.velocities)
    return World(*world[:2], velocities, world.references), course


def all_decades(rng: Random, ndim: int) -> tuple[World, Course]:
    """Any finite doubles."""
    n, scale = 8, rng.uniform(-300, 300)
    lo = decades(rng, (n, ndim), max(scale - 9, -320), min(scale + 1, 307))
    hi = np.maximum(lo, lo + decades(rng, (n, ndim), max(scale - 9, -320), min(scale, 307)))
    times, rate = rng.uniform(-60, 60), np.clip(scale, -290, 290)
    velocities = (
        decades(rng, (n, ndim), rate - times - 9, rate - times) * (rng.random(n) < 0.7)[:, None]
    )
    references = decades(rng, (n,), times - 5, times)
    low = decades(rng, (ndim,), max(scale - 9, -320), min(scale + 1, 307))
    way = decades(rng, (ndim,), rate - 9, rate) * (rng.random(ndim) < 0.8)
    at, pace = (float(x) for x in decades(rng, (2,), times - 2, times))
    return World(lo, hi, velocities, references), Course(low, low, way, at, pace)


def long_ago(rng: Random, ndim: int) -> tuple[World, Course]:
    """Times so far from zero that their last digits are ways: a ray that meets a box at rest in
    the end, beside boxes that came the same way and are beyond that box's face by then.
    """
    way = np.zeros(ndim)
    way[rng.integers(ndim)] = rng.choice([-1.0, 1.0])
    lo = rng.integers(2, 9, (3, ndim)) * (way == 0.0) + 0.5 * way - (way < 0.0)
    lo[0] = np.minimum(way, 0.0)
    ended, pace = float(rng.integers(1, 99)) / 64, float(rng.uniform(-2, 2))
    at = float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(8, 10))
    gone = 0.5 + rng.uniform(0.1, 0.9, (3, 1)) * ended
    velocities = way * gone / (ended * pace)
    velocities[0] = 0.0
    low = 0.5 * (way == 0.0) - ended * way
    world = World(lo, lo + 1.0, velocities, np.full(3, at + ended * pace))
    return world, Course(low, low, way, at, pace)


def ends_of_the_doubles(rng: Random, ndim: int) -> tuple[World, Course]:
    """The same as whole numbers of the smallest double, or of one near the largest."""
    world, course = whole_numbers(rng, ndim)
    unit = rng.choice([5e-324, 3e-320, 2e307])
    lo, hi, velocities = (array * unit for array in world[:3])
    ways = (array * unit for array in course[:3])
    return World(lo, hi, velocities, world.references), Course(*ways, course.at, course.pace)


KINDS = plain, whole_numbers, grazing, together, all_decades, ends_of_the_doubles, long_ago


def worlds(seed: int, count: int) -> Iterator[tuple[World, Course, Random]]:
    """So many of all kinds, in two and three dimensions."""
    rng = np.random.default_rng(seed)
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        with np.errstate(all='ignore'):
            yield *kind(rng, 2 + number // len(KINDS) % 2), rng


def stopping(seed: int, count: int) -> Iterator[tuple[World, Course, float, Random]]:
    """`worlds`, and how long boxes go on: often until one is met, but for the rounding of it."""
    for world, course, rng in worlds(seed, count):
        course = Course(*course[:4], abs(course.pace))
        with np.errstate(all='ignore'):
            ts = [float(hit.t) for hit in meetings(world, course) if hit.t <= LARGEST]
            then = course.at + course.pace * float(rng.choice([0.0, 0.5, 1.0, *ts]))
            left = then - float(rng.choice(world.references))
        left = float(rng.choice([left, np.nextafter(left, np.inf), 0.5 * left, 0.0]))
        yield world, course, max(left if math.isfinite(left) else 1.0, 0.0), rng
