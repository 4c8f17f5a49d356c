# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Who comes to rest is found through trees: as if every ray were asked of every obstacle."""

import numpy as np
import pytest

from bvh_ros.scene import Scene, Shapes
from bvh_ros.scene.casting import resting
from bvh_ros.scene.casting.arguments import Rays
from bvh_ros.scene.casting.moving import _casts
from bvh_ros.scene.casting.seen import Times
from bvh_ros.scene.geometry.shapes import along_axes
from bvh_ros.scene.store.places import at_rest

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
        held, axes = scene._held, (2 if planar else 3)
        origins, directions = rng.uniform(-8, 8, (2, WAYS, 3)) * scale
        masks = np.full(WAYS, 0xFFFFFFFF, np.uint32)
        flat = along_axes(origins, axes), along_axes(directions, axes)
        rays, radii = Rays(*flat, np.ones(WAYS), masks), (np.arange(WAYS) % 3) * 0.2 * scale
        at = np.sort(rng.uniform(-0.5, 1.0, WAYS))
        times = Times(at, rng.uniform(0.0, 1.5, WAYS) * (np.arange(WAYS) % 4 > 0))
        still = at_rest(held, times.last(rays.t_max))
        rows, slots = np.repeat(np.arange(WAYS), len(still)), np.tile(still, WAYS)
        stops = resting.comes_to_rest(held, slots, times.ends(rays.t_max)[rows])
        pairs = rows[stops], slots[stops]
        for skip in (False, True):
            asked = held, rays, radii, skip, times
            wanted = resting._of_pairs(*asked, pairs)
            found = resting.met(*asked, still, _casts(held, rays, radii, times))
            for one, other in zip(found, wanted, strict=True):
                assert one.tolist() == other.tolist()
            met += len(found.rows)
    assert met > 100
