# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A planar scene of axis-aligned boxes is a 2D tree: the answers of 3D, and no footprint."""

import numpy as np
import pytest

from bvh_ros.scene import Numbered, Scene, Shapes

HEIGHT = 1.25
ABOUT_Z = [0.0, 0.0, 0.3, 0.9]


def standing(rng, count):
    """Boxes on the ground whose sides are multiples of 1/4 m, so that rays and boxes touch."""
    place, size = rng.integers(0, 60, (count, 3)) / 4, rng.integers(0, 8, (count, 3)) / 4
    place[:, 2], size[:, 2] = HEIGHT, 2.0
    return Shapes.boxes(place, size)


def same(flat, solid):
    assert [hit.name for hit in flat] == [hit.name for hit in solid]
    for one, other in zip(flat, solid, strict=True):
        assert (one.handle, one.t, one.stamp) == (other.handle, other.t, other.stamp)
        assert one.point.tolist() == other.point.tolist()
        assert one.normal.tolist() == other.normal.tolist()


@pytest.mark.parametrize('margin', [0.0, 0.3])
def test_boxes_on_the_ground_are_answered_as_in_space(margin):
    rng = np.random.default_rng(7)
    flat, solid = Scene(planar=True, margin=margin), Scene(margin=margin)
    for stamp in (1, 2):  # inserted, then moved
        boxes = standing(rng, 150)
        for scene in (flat, solid):
            scene.update('a', Numbered('o', np.arange(150)), boxes, stamp=stamp, categories=stamp)
    ends = rng.integers(0, 60, (2, 300, 3)) / 4
    ends[:, :, 2] = HEIGHT
    hits = 0
    for start, goal in zip(*ends, strict=True):
        asked = {'mask': 2, 'skip_inside': bool(hits % 2)}
        first = [scene.raycast(start, goal, **asked) for scene in (flat, solid)]
        assert (first[0] is None) == (first[1] is None)
        same(*([hit] if hit else [] for hit in first))
        every = [scene.raycast_all(start, goal, **asked) for scene in (flat, solid)]
        same(*every)
        hits += len(every[0])
        for tolerance in (0.0, 0.5):
            same(*(scene.overlap(start, goal, (0, 0, 0, 0), tolerance) for scene in (flat, solid)))
        same(*(scene.nearest(start, 3) for scene in (flat, solid)))
    assert hits > 300
    starts, ways = ends[0], ends[1] - ends[0]
    many = [scene.raycast_many(starts, ways, 1.0, 2) for scene in (flat, solid)]
    for one, other in zip(*many, strict=True):
        np.testing.assert_array_equal(one, other)
    singly = [solid.raycast(start, goal, 0.0, 2) for start, goal in zip(*ends, strict=True)]
    handles, ts, places, normals = many[0]
    for row, hit in enumerate(singly):
        assert handles[row] == (hit.handle if hit else 0xFFFFFFFF)
        assert ts[row] == (hit.t if hit else np.inf)
        assert places[row].tolist() == hit.point.tolist() if hit else np.isnan(places[row]).all()
        assert normals[row].tolist() == (hit.normal.tolist() if hit else [0, 0, 0])
    assert not flat._held.columns.footprint.view(np.uint8).any()  # in no memory either


def test_an_aligned_box_in_the_place_of_a_turned_one():
    scene = Scene(planar=True)
    turned = Shapes.boxes([[0, 0, 0], [9, 0, 0]], [4, 1, 1], [ABOUT_Z, ABOUT_Z])
    scene.update('a', ['gone', 'stays'], turned, stamp=1)
    slot = scene._held.registry.slot('gone')
    scene.remove('a', ['gone'])
    scene.update('a', ['new'], Shapes.boxes([[0, 0, 0]], [4, 1, 1]), stamp=2)
    assert scene._held.registry.slot('new') == slot
    assert scene.any_shaped
    for radius in (0.0, 0.25):
        hit = scene.raycast([-5, 0.5, 0], [5, 0.5, 0], radius)
        assert (hit.name, hit.t) == ('new', (3 - radius) / 10)
    assert [hit.name for hit in scene.overlap([1.5, 0.4, 0], [2, 0.5, 0])] == ['new']
