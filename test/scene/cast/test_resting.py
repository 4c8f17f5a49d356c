# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Who comes to rest is found through the tree: as if every ray were asked of every obstacle."""

import numpy as np
import pytest

from bvh_ros.scene import Scene, Shapes
from bvh_ros.scene.cast.arguments import Rays
from bvh_ros.scene.cast.motion import Times
from bvh_ros.scene.cast.motion_batch import _of_pairs, cast_then, first_then
from bvh_ros.scene.geometry.shapes import along_axes

SECOND = 1_000_000_000
COUNT, WAYS = 80, 60


@pytest.mark.slow
@pytest.mark.parametrize('planar', [False, True])
def test_nobody_who_rests_is_overlooked(planar):
    met = 0
    for seed, (scale, growth) in enumerate([(1.0, 0.0), (1.0, 0.5), (1e-9, 0.0), (1e12, 0.0)]):
        rng = np.random.default_rng(seed)
        scene = Scene(planar=planar, max_prediction=0.7, uncertainty=growth)
        places, sizes = rng.uniform(-5, 5, (COUNT, 3)), rng.uniform(0.2, 2, (COUNT, 3))
        turns = rng.normal(size=(COUNT, 4)) * (np.arange(COUNT) % 2)[:, None]
        turns[:, :2] = 0.0
        speeds = rng.normal(size=(COUNT, 3)) * 6.0 * scale
        told = {'stamp': rng.integers(0, SECOND, COUNT), 'velocities': speeds}
        shapes = Shapes.boxes(places * scale, sizes * scale, turns)
        assert not scene.update('s', [f'o{i}' for i in range(COUNT)], shapes, **told)
        held = scene._held
        origins, directions = rng.uniform(-8, 8, (2, WAYS, 3)) * scale
        masks = np.full(WAYS, 0xFFFFFFFF, np.uint32)
        rays, radii = Rays(origins, directions, np.ones(WAYS), masks), np.arange(WAYS) % 3 * 0.2
        flat = Rays(*(along_axes(one, held.tree.ndim) for one in rays[:2]), *rays[2:])
        radii *= scale
        at = np.sort(rng.uniform(-0.5, 1.0, WAYS))
        times = Times(at, rng.uniform(0.0, 1.5, WAYS) * (np.arange(WAYS) % 4 > 0))
        slots = np.flatnonzero(held.columns.tree_handle >= 0)
        rows, every = np.repeat(np.arange(WAYS), len(slots)), np.tile(slots, WAYS)
        for skip in (False, True):
            wanted = _of_pairs(held, flat, radii, skip, times, rows, every)
            order = np.lexsort((held.columns.node_handle[wanted.slots], wanted.ts, wanted.rows))
            wanted = wanted.take(order)
            if planar:
                wanted.points[:, 2] = origins[wanted.rows, 2]
            found = cast_then(held, rays, radii, skip, times)
            for one, other in zip(found, wanted, strict=True):
                assert one.tolist() == other.tolist()
            met += len(found.rows)
            first = first_then(held, None, rays, radii, skip, times)
            some, places = np.unique(found.rows, return_index=True)
            assert np.flatnonzero(~np.isnan(first.points[:, 0])).tolist() == some.tolist()
            assert first.hits.ts[some].tolist() == found.ts[places].tolist()
            assert first.points[some].tolist() == found.points[places].tolist()
    assert met > 150
