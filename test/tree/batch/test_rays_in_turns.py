# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Few rays among so many boxes that they take turns, against rays alone."""

import numpy as np
import pytest
from tree.batch.test_few_rays import check_one_by_one

from bvh_ros import DynamicBVH
from bvh_ros.tree.batch.single import FAR_NODES

BOXES, RAYS = 50_000, 71


@pytest.mark.parametrize('ndim', [2, 3])
def test_rays_are_those_alone(ndim: int) -> None:
    """Boxes on whole numbers, so that hits tie; rays that begin in them, end, or are not suited;
    then among boxes that were written since.
    """
    rng, edge = np.random.default_rng(ndim), {2: 400, 3: 60}[ndim]
    lo = rng.integers(-edge, edge, (BOXES, ndim)).astype(float)
    masks = rng.integers(1, 4, BOXES).astype(np.uint32)
    tree = DynamicBVH.from_boxes(lo, lo + rng.integers(0, 3, (BOXES, ndim)), mask=masks)
    tree.raycast_many(lo, lo + 0.5)  # from then on there is a snapshot
    met = 0
    for turn in range(16):
        snapshot = tree._wide[2]
        assert snapshot is not None
        assert snapshot.size >= FAR_NODES
        origins = rng.integers(-edge, edge, (RAYS, ndim)).astype(float)
        ways = rng.integers(-9, 10, (RAYS, ndim)).astype(float)
        origins[3], ways[5], ways[7] = 1e9, 0.0, 1e-250
        ends = np.where(np.arange(RAYS) % 3, np.inf, 2.5)
        seen = rng.integers(0, 4, RAYS).astype(np.uint32)
        count = (RAYS, 1, 7, 8, 9)[turn % 5]
        asked = origins[:count], ways[:count], ends[:count], seen[:count]
        hits = tree.raycast_many(*asked)
        check_one_by_one(tree, hits, *asked)
        assert np.array_equal(tree.occluded_many(*asked), hits.ids >= 0)
        met += np.count_nonzero(hits.ids >= 0)
        if turn > 7:
            place = np.full((2, ndim), float(turn))
            tree.move_many(tree.ids()[:2], place, place + 1.0)
    assert snapshot.loose > 0
    assert 100 < met < 400
