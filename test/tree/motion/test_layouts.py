# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bounds and sweeps of nodes that are laid out for the times that are asked for: answers stay what
they were, and nodes are small again.
"""

import numpy as np
import pytest

from bvh_ros import DynamicBVH
from bvh_ros.tree.access import OpenTree


def fast_world(rng, ndim):
    """Boxes at whole places and speeds of tens of metres a second: sums are exact in doubles."""
    lo = rng.integers(0, 160, (2000, ndim)).astype(float)
    return lo, lo + 1.0, rng.integers(-40, 41, lo.shape).astype(float)


@pytest.mark.parametrize('ndim', [2, 3])
def test_many_rays_at_a_time_among_fast_boxes(ndim):
    rng = np.random.default_rng(ndim)
    lo, hi, velocities = fast_world(rng, ndim)
    tree = OpenTree.from_boxes(lo, hi, mask=rng.integers(1, 4, len(lo)))
    tree.set_velocities(tree.ids(), velocities, reference=-1.0)
    there = DynamicBVH.from_boxes(lo + 2.0 * velocities, hi + 2.0 * velocities)
    assert (there.ids() == tree.ids()).all()
    origins = rng.integers(-80, 240, (4000, ndim)).astype(float)
    directions = rng.normal(size=origins.shape)
    for _ in range(6):
        hits = tree.raycast_many(origins, directions, 30.0, mask=0xFFFFFFFF, at=1.0)
        exact = there.raycast_many(origins, directions, 30.0, mask=0xFFFFFFFF)
        assert (hits.ids == exact.ids).all()
        assert (hits.t == exact.t).all()
    sweep = tree.motion.swept_for(tree, tree.view(), len(origins), (1.0, 1.0))
    own = tree.snapshot_for(len(origins), tree.view())
    assert not np.array_equal(sweep.snapshot.children, own.children)
