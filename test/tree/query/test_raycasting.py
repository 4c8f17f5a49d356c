# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a ray query means: closed boxes, inside, parallel, ties, masks, limits, and the same answer
in every form.
"""

import itertools
import math

import numpy as np
import pytest

from bvh_ros import ALL, DynamicBVH, RayHit, RayHits

INF = math.inf


def unit_cube(mask: int = 1) -> tuple[DynamicBVH, int]:
    """A cube from (1, 1, 1) to (2, 2, 2)."""
    tree = DynamicBVH()
    return tree, tree.insert([1, 1, 1], [2, 2, 2], mask)


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
        assert (many.ids.tolist(), many.t.tolist(), many.normals.tolist()) == (
            [-1],
            [INF],
            [[0.0] * 3],
        )
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


@pytest.mark.parametrize('order', list(itertools.permutations(range(3))))
def test_ties_go_to_the_smaller_handle(order: tuple[int, ...]) -> None:
    """Three boxes with one front face between a nearer and a farther one, in any order."""
    fronts = {0: ([1, 0], [2, 1]), 1: ([1, 0.25], [5, 0.75]), 2: ([1, -3], [1, 3])}
    tree = DynamicBVH(2)
    far = tree.insert([3, 0], [4, 1])
    tied = [tree.insert(*fronts[k]) for k in order]
    assert tree.raycast([0, 0.5], [1, 0]).id == tied[0]
    near = tree.insert([0.5, 0], [0.75, 1])
    assert [hit.id for hit in tree.raycast_all([0, 0.5], [1, 0])] == [near, *tied, far]
    assert tree.raycast_many([[0, 0.5]], [[1, 0]], t_max=1.0, skip_inside=True).ids.tolist() == [
        near
    ]
    tree.remove(near)
    assert tree.raycast_many([[0, 0.5]] * 99, [[1, 0]] * 99).ids.tolist() == [tied[0]] * 99
    tree.rebuild()
    assert tree.raycast([0, 0.5], [1, 0]).id == tied[0]


def test_inside_several_boxes_the_smallest_handle_is_first() -> None:
    tree = DynamicBVH()
    handles = [tree.insert([-size] * 3, [size] * 3) for size in (3, 1, 2, 5, 4)]
    hits = tree.raycast_all([0, 0, 0], [1, 0, 0])
    assert [hit.id for hit in hits] == handles
    assert {hit.t for hit in hits} == {0.0}
    assert tree.raycast([0, 0, 0], [1, 0, 0]).id == handles[0]
    assert tree.raycast_all([0, 0, 0], [1, 0, 0], skip_inside=True) == []
    wall = tree.insert([10, -1, -1], [11, 1, 1])
    assert tree.raycast([0, 0, 0], [1, 0, 0], skip_inside=True).id == wall


MASKS = [
    # of the box, of the query, seen
    (1, ALL, True),
    (1, 1, True),
    (1, 2, False),
    (3, 2, True),
    (0x80000000, 0x80000000, True),
    (0x80000000, 0x7FFFFFFF, False),
    (ALL, 4, True),
    (0, ALL, False),
    (ALL, 0, False),
]


@pytest.mark.parametrize(('box_mask', 'query_mask', 'is_seen'), MASKS)
@pytest.mark.parametrize('others', [0, 30])
def test_masks(box_mask: int, query_mask: int, is_seen: bool, others: int) -> None:
    """Alone, and among boxes of all the other bits, which the masks of inner nodes must prune."""
    tree, cube = unit_cube(box_mask)
    lo = np.random.default_rng(3).uniform(3, 9, (others, 3))
    tree.insert_many(lo, lo + 1, np.full(others, ALL & ~query_mask, np.uint32))
    ray = [0, 1.5, 1.5], [1, 0, 0]
    expected = [cube] if is_seen else []
    assert [hit.id for hit in tree.raycast_all(*ray, mask=query_mask)] == expected
    assert tree.occluded(*ray, mask=query_mask) == is_seen
    assert (
        tree.raycast_many([ray[0]] * 9, [ray[1]] * 9, mask=query_mask).ids.tolist()
        == (expected or [-1]) * 9
    )
    assert tree.overlap([0] * 3, [9] * 3, query_mask).tolist() == expected
    assert tree.nearest([0] * 3, 50, mask=query_mask)[0].tolist() == expected
    tree.set_masks([cube], 0)
    assert tree.raycast_all(*ray, mask=query_mask) == []
    tree.set_masks([cube], query_mask)
    assert [hit.id for hit in tree.raycast_all(*ray, mask=query_mask)] == (
        [cube] if query_mask else []
    )


def test_limits_row_by_row() -> None:
    """t_max and mask, one for all or one a ray."""
    tree, cube = unit_cube(mask=2)
    origins, directions = [[0, 1.5, 1.5]] * 4, [[1, 0, 0]] * 4
    t_max, masks = [0.5, 1.0, INF, INF], [ALL, 2, 3, 1]
    expected = [-1, cube, cube, -1]
    assert tree.raycast_many(origins, directions, t_max, masks).ids.tolist() == expected
    assert tree.occluded_many(origins, directions, t_max, masks).tolist() == [
        id_ >= 0 for id_ in expected
    ]
    assert tree.raycast_all_many(origins, directions, t_max, masks)[0].tolist() == [0, 0, 1, 2, 2]
    assert tree.raycast_many(origins, directions, t_max=0.5).ids.tolist() == [-1] * 4
