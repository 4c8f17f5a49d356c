# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lists of what has a bit, all at once, against one after the other."""

import numba
import numpy as np
import pytest

from bvh_ros.tree.simd.int32x8 import AT_ONCE, list_met8

LANES = 16
UNTOUCHED = -77


@numba.njit(error_model='numpy')
def listed(lists, start, count, met, bit, into):
    return list_met8(lists, start, count, met, bit, into)


@pytest.mark.parametrize('share', [0.0, 0.1, 0.5, 0.9, 1.0])
@pytest.mark.parametrize('count', [1, 2, 7, 8, 9, 15, 16, 17, 63, 100])
def test_what_has_the_bit_is_listed_in_its_order(count: int, share: float) -> None:
    rng = np.random.default_rng(count)
    start, into = 3, 3 + count
    for bit in range(LANES):
        lists = np.full(into + count + AT_ONCE, UNTOUCHED, np.int32)
        lists[start:into] = rng.integers(0, 2**31, count)
        before = lists[:into].copy()
        met = np.zeros(count + AT_ONCE, np.uint32)
        met[:count] = rng.integers(0, 2**LANES, count) & ~(1 << bit)
        wanted = rng.random(count) < share
        met[:count][wanted] |= np.uint32(1 << bit)
        end = listed(lists, start, count, met, bit, into)
        assert lists[into:end].tolist() == before[start:][wanted].tolist()
        assert lists[:into].tolist() == before.tolist()
        assert (lists[end + AT_ONCE :] == UNTOUCHED).all()


def test_each_choice_of_eight() -> None:
    numbers = np.arange(AT_ONCE, dtype=np.int32)
    for choice in range(1 << AT_ONCE):
        met = (choice >> numbers & 1).astype(np.uint32)
        lists = np.concatenate([numbers, np.zeros(2 * AT_ONCE, np.int32)])
        end = listed(lists, 0, AT_ONCE, met, 0, AT_ONCE)
        chosen = np.flatnonzero(met)
        assert lists[AT_ONCE:end].tolist() == chosen.tolist()
