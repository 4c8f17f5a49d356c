# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches at other times through a swept snapshot: as every way of them alone, which walks through
the tree's own nodes (`test_then` says that those are right).
"""

import numpy as np
import pytest

from bvh_ros.scene import NO_NODE, Scene, Shapes
from bvh_ros.scene.geometry.shapes import BOX, CYLINDER, SPHERE

SECOND = 1_000_000_000
NOW = 1_790_000_000 * SECOND
COUNT, WAYS, GROUPS = 150, 120, 9


def obstacles(rng, shaped):
    kinds = np.full(COUNT, BOX, np.uint8)
    sizes, turns = rng.uniform(0.2, 3, (COUNT, 3)), np.zeros((COUNT, 4))
    if shaped:
        kinds[1::4], kinds[2::4] = SPHERE, CYLINDER
        sizes[1::4], sizes[2::4, 1] = sizes[1::4, :1], sizes[2::4, 0]
        turns[3::4] = rng.normal(size=turns[3::4].shape)
    return Shapes(kinds, rng.uniform(-9, 9, (COUNT, 3)), turns, sizes)


def ways(rng, scale):
    """Some that go nowhere, along an axis, or begin far away."""
    starts, goals = rng.uniform(-12, 12, (2, WAYS, 3))
    goals[:4] = starts[:4]
    goals[4:12, :2] = starts[4:12, :2]
    starts[-4:] *= 1e5
    return starts * scale, goals * scale


def same(found, row, hit):
    if hit is None:
        assert (found.handles[row], found.t[row]) == (NO_NODE, np.inf)
        return
    assert (found.handles[row], found.t[row]) == (hit.handle, hit.t)
    assert found.points[row].tolist() == hit.point.tolist()
    assert found.normals[row].tolist() == hit.normal.tolist()


@pytest.mark.slow
@pytest.mark.parametrize('planar', [False, True])
@pytest.mark.parametrize('shaped', [False, True])
def test_a_batch_is_as_its_ways_one_by_one(planar, shaped):
    for seed, (scale, speed, growth) in enumerate(
        [(1.0, 3.0, 0.0), (1.0, 3.0, 0.4), (1e-9, 1e-7, 0.0), (1e9, 1e4, 0.0), (1.0, 1e-9, 0.0)]
    ):
        rng = np.random.default_rng(seed)
        shapes, names = obstacles(rng, shaped), [f'o{i}' for i in range(COUNT)]
        shapes = shapes._replace(position=shapes.position * scale, size=shapes.size * scale)
        speeds = rng.normal(size=(COUNT, 3)) * (rng.random((COUNT, 1)) < 0.8) * speed
        scene = Scene(planar=planar, uncertainty=growth)
        told = {'stamp': NOW - rng.integers(0, SECOND, COUNT), 'velocities': speeds}
        masks = (np.arange(COUNT) % 3 + 1).astype(np.uint32)
        assert not scene.update('s', names, shapes, categories=masks, **told)
        times = {'at': NOW + SECOND // 3, 'until': NOW + SECOND}
        radii = np.where(np.arange(WAYS) % 3, 0.4, 0.0) * scale
        for turn in range(2):
            starts, goals = ways(rng, scale)
            mask, skip = (2, True) if turn else (0xFFFFFFFF, False)
            asked = starts, goals, radii, mask, skip
            found = scene.sweep_many(*asked, **times, threads=1 + turn)
            # More than go together.
            every = *(np.tile(rows, (GROUPS, 1)) for rows in asked[:2]), np.tile(radii, GROUPS)
            again = scene.sweep_many(*every, mask, skip, **times)
            for column, rows in zip(again, found, strict=True):
                np.testing.assert_array_equal(column.reshape(GROUPS, *rows.shape), [rows] * GROUPS)
            for row in range(WAYS):
                one = starts[row], goals[row], float(radii[row]), mask, skip
                same(found, row, scene.raycast(*one, **times))
            assert scene._held.tree.motion._wanted.sweep is not None
            # The next time some obstacles have been written since: the snapshot is patched.
            few = slice(0, 9)
            moved = shapes.take(np.arange(9))._replace(position=shapes.position[9:18])
            scene.update('s', names[few], moved, stamp=NOW, velocities=-speeds[few])
