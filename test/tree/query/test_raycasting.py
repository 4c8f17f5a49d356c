# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a ray query means: closed boxes, inside, parallel, limits; the same answer in every form.

For ties, masks and limits row by row see test_numerics.
"""

import math

import numpy as np
import pytest

from bvh_ros import DynamicBVH, RayHit, RayHits

INF = math.inf


def unit_cube() -> tuple[DynamicBVH, int]:
    """A cube from (1, 1, 1) to (2, 2, 2)."""
    tree = DynamicBVH()
    return tree, tree.insert([1, 1, 1], [2, 2, 2])


# origin, direction, t_max, skip_inside -> t and normal, or None for a miss
RAYS = {
    'from the left': ([0, 1.5, 1.5], [1, 0, 0], INF, False, 1, [-1, 0, 0]),
    'from the right': ([4, 1.5, 1.5], [-1, 0, 0], INF, False, 2, [1, 0, 0]),
    'from below': ([1.5, 1.5, -1], [0, 0, 4], INF, False, 0.5, [0, 0, -1]),
    'from above': ([1.5, 1.5, 3], [0, 0, -0.5], INF, False, 2, [0, 0, 1]),
    'along y': ([1.5, 0, 1.5], [0, 1, 0], INF, False, 1, [0, -1, 0]),
    'behind': ([0, 1.5, 1.5], [-1, 0, 0], INF, False, None, None),
    'beside': ([0, 2.5, 1.5], [1, 0, 0], INF, False, None, None),
    'just reaches': ([0, 1.5, 1.5], [1, 0, 0], 1.0, False, 1, [-1, 0, 0]),
    'just does not reach': ([0, 1.5, 1.5], [1, 0, 0], math.nextafter(1, 0), False, None, None),
    'a segment given by its end': ([0, 1.5, 1.5], [8, 0, 0], 1.0, False, 0.125, [-1, 0, 0]),
    'oblique, x last': ([0, 1.5, 1.5], [1, 0.25, 0.125], INF, False, 1, [-1, 0, 0]),
    'oblique, z last': ([0.5, 1.25, -1], [0.5, 0.25, 1], INF, False, 2, [0, 0, -1]),
    'tie of x and y: the lowest': ([0, 0, 1.5], [1, 1, 0], INF, False, 1, [-1, 0, 0]),
    'tie of y and z: the lowest': ([1.5, 0, 0], [0, 1, 1], INF, False, 1, [0, -1, 0]),
    'tie of all, backwards': ([3, 3, 3], [-1, -1, -1], INF, False, 1, [1, 0, 0]),
    'in the plane of a face': ([0, 1, 1.5], [1, 0, 0], INF, False, 1, [-1, 0, 0]),
    'along an edge': ([0, 1, 2], [1, 0, 0], INF, False, 1, [-1, 0, 0]),
    'along an edge, minus zero': ([0, 1, 2], [1, -0.0, -0.0], INF, False, 1, [-1, 0, 0]),
    'touches a corner only': ([0, 2, 1], [1, -1, 0], INF, False, 1, [-1, 0, 0]),
    'inside': ([1.5, 1.5, 1.5], [1, 0, 0], INF, False, 0, [0, 0, 0]),
    'inside, t_max 0': ([1.5, 1.5, 1.5], [1, 0, 0], 0.0, False, 0, [0, 0, 0]),
    'inside, skipped': ([1.5, 1.5, 1.5], [1, 0, 0], INF, True, None, None),
    'on the near face': ([1, 1.5, 1.5], [1, 0, 0], INF, False, 0, [0, 0, 0]),
    'on the near face, skipped': ([1, 1.5, 1.5], [1, 0, 0], INF, True, None, None),
    'on a corner, leaving': ([2, 2, 2], [1, 1, 1], INF, False, 0, [0, 0, 0]),
    'outside, skip_inside does not matter': ([0, 1.5, 1.5], [1, 0, 0], INF, True, 1, [-1, 0, 0]),
    'a point inside': ([1.5, 1.5, 1.5], [0, 0, 0], INF, False, 0, [0, 0, 0]),
    'a point on a face': ([1, 1.5, 1.5], [0, -0.0, 0], INF, False, 0, [0, 0, 0]),
    'a point inside, skipped': ([1.5, 1.5, 1.5], [0, 0, 0], INF, True, None, None),
    'a point outside': ([0, 1.5, 1.5], [0, 0, 0], INF, False, None, None),
}


@pytest.mark.parametrize(
    ('origin', 'direction', 't_max', 'skip_inside', 't', 'normal'), RAYS.values(), ids=RAYS.keys()
)
def test_one_ray_and_one_box(
    origin: list[float],
    direction: list[float],
    t_max: float,
    skip_inside: bool,
    t: float | None,
    normal: list[float] | None,
) -> None:
    tree, cube = unit_cube()
    options = {'t_max': t_max, 'skip_inside': skip_inside}
    hit = tree.raycast(origin, direction, **options)
    every = tree.raycast_all(origin, direction, **options)
    many = tree.raycast_many([origin], [direction], **options)
    offsets, ids, ts = tree.raycast_all_many([origin], [direction], **options)
    assert tree.occluded(origin, direction, **options) == (t is not None)
    assert tree.occluded_many([origin], [direction], **options).tolist() == [t is not None]
    if t is None:
        assert hit is None
        assert every == []
        assert (many.ids.tolist(), many.t.tolist()) == ([-1], [INF])
        assert many.normals.tolist() == [[0.0] * 3]
        assert (offsets.tolist(), ids.tolist(), ts.tolist()) == ([0, 0], [], [])
        return
    assert (hit.id, hit.t, hit.normal.tolist()) == (cube, t, normal)
    assert hit.point.tolist() == [o + t * d for o, d in zip(origin, direction, strict=True)]
    assert [(h.id, h.t, h.point.tolist(), h.normal.tolist()) for h in every] == [
        (cube, t, hit.point.tolist(), normal)
    ]
    assert (many.ids.tolist(), many.t.tolist(), many.normals.tolist()) == ([cube], [t], [normal])
    assert (offsets.tolist(), ids.tolist(), ts.tolist()) == ([0, 1], [cube], [t])


def test_types_of_the_answers() -> None:
    tree, _ = unit_cube()
    hit = tree.raycast([0, 1.5, 1.5], [1, 0, 0])
    assert isinstance(hit, RayHit)
    assert type(hit.id) is int
    assert type(hit.t) is float
    assert (hit.point.dtype, hit.point.shape) == (np.float64, (3,))
    assert (hit.normal.dtype, hit.normal.shape) == (np.float64, (3,))
    many = tree.raycast_many(np.zeros((5, 3)), np.ones((5, 3)))
    assert isinstance(many, RayHits)
    assert (many.ids.dtype, many.ids.shape) == (np.int64, (5,))
    assert (many.t.dtype, many.t.shape) == (np.float64, (5,))
    assert (many.normals.dtype, many.normals.shape) == (np.float64, (5, 3))
    offsets, ids, ts = tree.raycast_all_many(np.zeros((5, 3)), np.ones((5, 3)))
    assert [array.dtype for array in (offsets, ids, ts)] == [np.int64, np.int64, np.float64]
    assert offsets.shape == (6,)
    assert tree.occluded_many(np.zeros((5, 3)), np.ones((5, 3))).dtype == np.bool_
    assert type(tree.occluded([0, 0, 0], [1, 1, 1])) is bool
    assert tree.raycast_all([0, 1.5, 1.5], [-1, 0, 0]) == []


@pytest.mark.parametrize('ndim', [2, 3])
def test_no_rays_and_no_boxes(ndim: int) -> None:
    none, one = np.empty((0, ndim)), np.ones((1, ndim))
    for tree in (DynamicBVH(ndim), DynamicBVH.from_boxes(-one, one)):
        assert tree.raycast_many(none, none).ids.shape == (0,)
        assert tree.raycast_many(none, none).normals.shape == (0, ndim)
        assert tree.occluded_many(none, none, threads=2).shape == (0,)
        assert [a.tolist() for a in tree.raycast_all_many(none, none)] == [[0], [], []]
    empty = DynamicBVH(ndim)
    assert empty.raycast(one[0], one[0]) is None
    assert empty.raycast_all(one[0], one[0]) == []
    assert empty.raycast_many(one, one).ids.tolist() == [-1]
    assert [a.tolist() for a in empty.raycast_all_many(one, one)] == [[0, 0], [], []]
    assert not empty.occluded(one[0], one[0])
