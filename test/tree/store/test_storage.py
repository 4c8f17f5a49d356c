# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A new tree's arrays, which numpy fills, are those that the kernel leaves which clears a tree."""

import numpy as np
import pytest

from bvh_ros.tree.nodes import CHANGES, WRITTEN
from bvh_ros.tree.store.storage import clear_entry, new_storage


@pytest.mark.parametrize('ndim', [2, 3])
def test_a_new_tree_is_as_a_cleared_one(ndim: int) -> None:
    for capacity, fat in ((1, True), (2, False), (5, True)):
        tree = new_storage(ndim, capacity, fat).tree
        before = [tree.nodes['parent'].copy(), *(a.copy() for a in (tree.handles, tree.state))]
        assert clear_entry(ndim)(tree) == 0
        tree.state[CHANGES] -= 1
        tree.state[WRITTEN] = before[2][WRITTEN]
        for then, now in zip(before, (tree.nodes['parent'], *tree[3:]), strict=True):
            np.testing.assert_array_equal(then, now)
        assert not tree.heights.any()
        assert len(tree.tight) == capacity * fat
