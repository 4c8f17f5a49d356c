# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The sides of boxes that move, all at once, against one after the other."""

import math
from fractions import Fraction

import numba
import numpy as np
import pytest

from bvh_ros.tree.motion.bounds import moving_dtype
from bvh_ros.tree.simd.moving_sides import (
    FRONTS,
    HALF,
    enter_sides,
    is_behind,
    is_beside,
    square_beside,
)


@numba.njit(error_model='numpy')
def at_once(nodes, node, fronts, ahead, pace):
    told = enter_sides(nodes, node, fronts, ahead, pace)
    beside = is_beside(nodes, node, fronts, ahead)
    behind = is_behind(nodes, node, fronts, ahead, nodes[node].loose)
    return (*told, beside, behind, square_beside(nodes, node, fronts, ahead))


def difference(number, rate, pace):
    """number - rate * pace, rounded once."""
    if not all(map(math.isfinite, (number, rate, pace))):
        return number - rate * pace
    exact = Fraction(number) - Fraction(rate) * Fraction(pace)
    try:
        return float(exact)
    except OverflowError:
        return math.inf if exact > 0 else -math.inf


def one_by_one(node, fronts, ahead, pace):
    missed, entry, leave, beside, behind, square = False, 0.0, math.inf, False, True, 0.0
    for axis in range(len(node['lower'])):
        larger = 0.0
        for half, name in enumerate(('lower', 'upper')):
            lane, rate = half * HALF + axis, float(node[f'{name}_rates'][axis])
            gap = float(node[name][axis]) + rate * ahead - fronts[lane]
            speed = difference(float(fronts[2 * HALF + lane]), rate, pace)
            behind &= bool(gap <= -node['loose'])
            if gap > 0.0:
                beside, larger, missed = True, max(larger, gap), missed or speed <= 0.0
                entry = max(entry, gap / speed) if speed > 0.0 else entry
            elif gap <= 0.0 and -math.inf < speed < 0.0:
                leave = min(leave, gap / speed)
        square += larger * larger
    return missed, entry, leave, beside, behind, square


@pytest.mark.parametrize('ndim', [2, 3])
def test_all_sides_at_once_are_as_one_by_one(ndim):
    rng, kind, told = np.random.default_rng(ndim), moving_dtype(ndim), set()
    behind = set()
    for _ in range(2000):
        nodes = np.frombuffer(bytearray(b'\xff' * 2 * kind.itemsize), kind)  # else NaN
        for name in ('lower', 'upper'):
            sides = rng.integers(-4, 5, (2, ndim)).astype(float)
            sides[rng.random(sides.shape) < 0.05] = -np.inf
            nodes[name], nodes[f'{name}_rates'] = sides, rng.integers(-2, 3, (2, ndim))
        nodes['loose'] = rng.choice([0.0, 0.5, 2.0, math.nan])
        fronts = np.repeat([math.inf, 0.0], FRONTS // 2)
        for first in (0, HALF):
            fronts[first : first + ndim] = rng.integers(-4, 5, ndim) * 0.75
            speeds = rng.choice([-1e308, -1.0, 0.0, 1.0, 3.0], ndim)
            fronts[2 * HALF + first : 2 * HALF + first + ndim] = speeds
        ahead, pace = float(rng.integers(0, 3)), float(rng.choice([0.0, 1.0, -2.0, 1e308]))
        with np.errstate(over='ignore', invalid='ignore'):
            wanted = one_by_one(nodes[1], fronts, ahead, pace)
        assert at_once(nodes, 1, fronts, ahead, pace) == wanted
        told.add((wanted[0], wanted[1] > 0.0, wanted[2] < math.inf))
        behind.add(wanted[4])
    assert len(told) == 8
    assert len(behind) == 2
