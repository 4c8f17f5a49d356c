# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The slabs of a box that moves, all axes at once, against one after the other."""

import math

import numba
import numpy as np
import pytest

from bvh_ros.tree.motion.sweep import leaf_dtype
from bvh_ros.tree.simd.moving_leaf import moving_slabs

SLOWEST = 0.75


@numba.njit(error_model='numpy')
def at_once(leaves, slot, origin, direction, since, pace, more):
    return moving_slabs(leaves, slot, origin, direction, since, pace, more, SLOWEST)


def one_by_one(leaf, origin, direction, since, pace, more):
    missed, doubt, negative, near, far, later = False, False, 0, [], [], []
    within = True
    loose = float(leaf['loose'])
    for axis in range(len(origin)):
        velocity = float(leaf['velocity'][axis])
        rate = float(direction[axis]) - velocity * pace
        below = float(leaf['lo'][axis]) - float(origin[axis]) + velocity * since - more
        above = float(leaf['hi'][axis]) - float(origin[axis]) + velocity * since + more
        within &= below < -loose and above > loose
        if abs(rate) < SLOWEST:
            missed |= rate == 0.0 and (below > 0.0 or above < 0.0)
            doubt |= not (rate == 0.0 and below < -loose and above > loose)
            ends, wrong = (-math.inf, math.inf), 0.0
        else:
            negative |= (rate < 0.0) << axis
            ends, wrong = sorted((below / rate, above / rate)), abs(loose / rate)
        near.append(ends[0])
        far.append(ends[1])
        later.append(wrong)
    entry = max(0.0, *near)
    latest = [end == entry > 0.0 for end in near]
    entered = [end + wrong for end, wrong in zip(near, later, strict=True)]
    by = max([0.0, *(end for end, last in zip(entered, latest, strict=True) if last)])
    others = max([0.0, *(end for end, last in zip(entered, latest, strict=True) if not last)])
    surely = min(end - wrong for end, wrong in zip(far, later, strict=True))
    lanes = sum(last << axis for axis, last in enumerate(latest))
    return missed, doubt, entry, min(far), by, others, surely, lanes, negative, within


@pytest.mark.parametrize('ndim', [2, 3])
def test_all_axes_at_once_are_as_one_by_one(ndim):
    rng, kind, told = np.random.default_rng(ndim), leaf_dtype(ndim), set()
    for _ in range(4000):
        leaves = np.frombuffer(bytearray(b'\xff' * 2 * kind.itemsize), kind)  # else NaN
        lo = rng.integers(-8, 8, ndim).astype(float)
        leaves[1]['lo'], leaves[1]['hi'] = lo, lo + rng.integers(0, 9, ndim)
        leaves[1]['velocity'], leaves[1]['loose'] = rng.integers(-2, 3, ndim), rng.choice([0.5, 4])
        origin = rng.integers(-8, 9, ndim).astype(float)
        direction = rng.choice([-4.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 4.0], ndim)
        # Powers of two, so that an inverse is as good as a quotient.
        asked = (
            float(rng.integers(0, 3)),
            float(rng.choice([0.0, 0.0, 0.0, 0.5])),
            float(rng.choice([0.0, 1.0])),
        )
        rates = direction - leaves[1]['velocity'] * asked[1]
        if not all(math.frexp(rate)[0] in (-0.5, 0.0, 0.5) for rate in rates):
            continue
        wanted = one_by_one(leaves[1], origin, direction, *asked)
        assert at_once(leaves, 1, origin, direction, *asked) == wanted
        told.add((*wanted[:2], wanted[2] > 0.0, wanted[2] <= wanted[3], wanted[7], wanted[9]))
    assert len(told) > 4 * ndim
