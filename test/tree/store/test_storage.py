# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A tree's arrays: new ones, and those that another thread is about to put in their place."""

import numpy as np
import pytest

from bvh_ros.tree.access import NONE, OpenTree
from bvh_ros.tree.nodes import CHANGES, TURN, WRITTEN
from bvh_ros.tree.store.storage import allocate, clear_entry, new_storage
from bvh_ros.tree.store.turns import CHANGING


@pytest.mark.parametrize('ndim', [2, 3])
def test_a_new_tree_is_as_a_cleared_one(ndim: int) -> None:
    """numpy fills the arrays of one, a kernel those of the other."""
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


def test_arrays_that_another_thread_fills_stay_hidden() -> None:
    """Handles are found in those of before; changes are refused."""
    lo = np.random.default_rng(1).uniform(0, 20, (300, 3))
    tree = OpenTree.from_boxes(lo, lo + 1)
    handles, old = tree.ids(), tree._storage
    heir = allocate(3, 600, False)
    heir.tree.handles.fill(NONE)
    heir.tree.state[TURN] = CHANGING
    old.tree.state[TURN] = 1  # as if it were queried
    old.heirs.append(heir)
    np.testing.assert_array_equal(tree.boxes(handles)[0], lo)
    assert handles[0] in tree
    for change in (
        lambda: tree.move_many(handles, lo, lo + 1),
        lambda: tree.remove(int(handles[0])),
        lambda: tree.insert_many(lo, lo + 1),
    ):
        with pytest.raises(RuntimeError, match='by another thread'):
            change()
