# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nearest obstacles by their true shapes, against the distances of all of them."""

import math

import numpy as np
import pytest
from scene.reference import changed, geometry_arrays, random_shapes, random_turns, scene_of

from bvh_ros.scene import Scene, Shapes


def distances_of(world, point, planar):
    return np.array(
        [(s.distances_from_above if planar else s.distances)(point[None])[0] for s in world]
    )


@pytest.mark.parametrize('planar', [False, True])
@pytest.mark.parametrize('margin', [0.0, 0.5])
def test_nearest_as_brute_force(planar, margin):
    rng = np.random.default_rng([3, planar])
    shapes = random_shapes(rng, 60)
    masks = rng.integers(1, 4, 60)
    world = geometry_arrays(shapes)
    scene = scene_of(shapes, planar=planar, categories=masks, margin=margin)
    inside = 0
    for _ in range(40):
        point = rng.uniform(-7, 7, 3) if rng.random() < 0.8 else world[rng.integers(60)].position
        k, mask = int(rng.integers(1, 9)), int(rng.integers(1, 4))
        reach = rng.choice([math.inf, 2.0, 0.3])
        every = np.where(masks & mask, distances_of(world, point, planar), math.inf)
        hits = scene.nearest(point, k, reach, mask)
        expected = np.sort(every[every <= reach])[:k]
        assert [hit.t for hit in hits] == pytest.approx(expected.tolist(), abs=1e-9)
        assert [(hit.t, hit.handle) for hit in hits] == sorted((hit.t, hit.handle) for hit in hits)
        for hit in hits:
            solid, seen = world[int(hit.name)], point.copy()
            assert every[int(hit.name)] == pytest.approx(hit.t, abs=1e-9)
            if planar:
                assert hit.point[2] == point[2]
            assert distances_of([solid], hit.point, planar)[0] < 1e-9
            assert np.linalg.norm(seen - hit.point) == pytest.approx(hit.t, abs=1e-9)
            assert hit.point + hit.t * hit.normal == pytest.approx(seen, abs=1e-9)
            inside += hit.t == 0.0
    assert inside


def test_a_loose_box_does_not_hide_what_is_nearer():
    """Many long bars lie askew: their boxes hold the point, their shapes are far."""
    count = 40
    turn = np.tile([0, 0, math.sin(math.pi / 8), math.cos(math.pi / 8)], (count, 1))
    places = np.stack([np.linspace(3, 4, count), np.linspace(-3, -4, count), np.zeros(count)], 1)
    bars = Shapes.boxes(places, [20, 0.1, 0.1], turn)
    scene = scene_of(bars, names=[f'bar{i}' for i in range(count)])
    scene.update('test', ['ball'], Shapes.boxes([[0, 2, 0]], [1, 1, 1]), stamp=1)
    assert [hit.name for hit in scene.nearest([0, 0, 0])] == ['ball']
    assert [hit.name for hit in scene.nearest([0, 0, 0], 2)] == ['ball', 'bar0']


def test_ties_go_to_the_older():
    shapes = Shapes.boxes([[2, 0, 0], [-2, 0, 0], [0, 2, 0], [0, 0, 2]], [1, 1, 1])
    scene = scene_of(shapes, names=['d', 'c', 'b', 'a'])
    for k in range(1, 5):
        assert [hit.name for hit in scene.nearest([0, 0, 0], k)] == ['d', 'c', 'b', 'a'][:k]
    assert [hit.t for hit in scene.nearest([0, 0, 0], 9, 1.5)] == [1.5] * 4
    assert scene.nearest([0, 0, 0], 9, math.nextafter(1.5, 0)) == []
    assert Scene().nearest([0, 0, 0]) == []


def test_far_from_the_origin_distances_keep_their_digits():
    """The same shapes 8 km away, by steps that round nothing."""
    rng = np.random.default_rng(12)
    shapes = random_shapes(rng, 40, 2.0)
    places = np.round(shapes.position * 2.0**36) * 2.0**-36
    turned = changed(shapes, position=places, orientation=random_turns(rng, 40))
    near, far = scene_of(turned), scene_of(changed(turned, position=places + 8192.0))
    for point in np.round(rng.uniform(-3, 3, (60, 3)) * 2.0**36) * 2.0**-36:
        here, there = near.nearest(point, 5), far.nearest(point + 8192.0, 5)
        assert [hit.name for hit in here] == [hit.name for hit in there]
        assert [hit.t for hit in here] == pytest.approx([hit.t for hit in there], abs=1e-14)
