# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a tree of moving boxes must answer: brute force over all boxes, in exact arithmetic.

Doubles are whole numbers of one small power of two. In its square every gap and every rate is a
Python integer, and a distance along a ray is a `Fraction` of two of them.
"""

from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tree.reference import INSIDE, ExactHit, finest, latest_entry, whole

Floats = NDArray[np.float64]


class World(NamedTuple):
    """Boxes that move."""

    lo: Floats
    hi: Floats
    velocities: Floats
    references: Floats


class Course(NamedTuple):
    """What is swept, and when."""

    low: Floats
    high: Floats
    direction: Floats
    at: float
    pace: float

    def as_ray(self) -> 'Course':
        """Of its lower corner alone."""
        return self._replace(high=self.low)

    def standing(self, at: float) -> 'Course':
        """What it does from a time on where nothing moves any more."""
        return self._replace(at=at, pace=0.0)


def meetings(world: World, course: Course) -> list[ExactHit]:
    """All boxes that a course meets, by exact t, then row."""
    bits = finest((*world, *course))
    low, high, way = (whole(x, bits) for x in course[:3])
    (at,), (pace,) = whole(course.at, bits), whole(course.pace, bits)
    hits = []
    rows = zip(*([whole(x, bits) for x in array] for array in world), strict=True)
    for row, (lo, hi, velocity, (reference,)) in enumerate(rows):
        gaps = [
            (
                ((lo[k] - high[k]) << bits) + velocity[k] * (at - reference),
                ((hi[k] - low[k]) << bits) + velocity[k] * (at - reference),
                (way[k] << bits) - velocity[k] * pace,
            )
            for k in range(len(lo))
        ]
        found = latest_entry(gaps)
        if found is not None:
            t, axis = found
            face = INSIDE if axis == INSIDE else 2 * axis + (gaps[axis][2] < 0)
            hits.append(ExactHit(t, row, face))
    return sorted(hits)


def meetings_until(world: World, course: Course, left: float) -> list[ExactHit]:
    """`meetings` of boxes that go on for so long, s, and then stand; faces only name the sides."""
    hits, at, pace = [], Fraction(course.at), Fraction(course.pace)
    for row, velocity in enumerate(world.velocities):
        one, end = World(*(array[row : row + 1] for array in world)), np.inf
        if velocity.any():
            end = float(world.references[row] + left)
        standing = course.standing(end)
        met = meetings(one, course) if course.at <= end else []
        if end < np.inf:
            met = [hit for hit in met if hit.axis == INSIDE or at + pace * hit.t <= Fraction(end)]
        if not met and end < course.at:
            met = meetings(one, standing)
        elif not met and end < np.inf and pace > 0:
            met = [hit for hit in meetings(one, standing) if hit.axis != INSIDE]
            met = [hit for hit in met if at + pace * hit.t >= Fraction(end)]
        hits += [ExactHit(hit.t, row, hit.axis) for hit in met]
    return sorted(hits)


def squared_distances(world: World, low: Floats, high: Floats, at: float) -> list[Fraction]:
    """Exact squares of the distances of the boxes at a time from the one from low to high."""
    squares = []
    for lo, hi, velocity, reference in zip(*(array.tolist() for array in world), strict=True):
        since, total = Fraction(at) - Fraction(reference), Fraction(0)
        for k, speed in enumerate(velocity):
            way = Fraction(speed) * since
            below = Fraction(lo[k]) + way - Fraction(float(high[k]))
            above = Fraction(float(low[k])) - Fraction(hi[k]) - way
            total += max(below, above, Fraction(0)) ** 2
        squares.append(total)
    return squares
