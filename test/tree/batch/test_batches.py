# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of rays find what each ray finds alone: few and many, in lists and one by one, through
no snapshot, a new one and one that was patched. That single rays are right, `test_numerics` says.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from tree.reference import Floats

from bvh_ros import ALL, DynamicBVH, RayHits

INF = np.inf
# Rays of these signs along the axes; 0 is any sign.
OCTANTS: dict[str, tuple[int, ...]] = {
    'one octant': (1, 1, 1),
    'another': (-1, 1, -1),
    'all octants': (0, 0, 0),
    'along a face': (1, -1, 0),
}


class Rays:
    """Rays, a column each; as arguments of `raycast_many`."""

    def __init__(self, origins: Floats, ways: Floats, ends: Any = INF, masks: Any = ALL) -> None:
        count = len(origins)
        self.columns = (
            *(origins, ways, np.full(count, ends, float)),
            np.full(count, masks, np.uint32),
        )

    def rows(self, rows: Any) -> list[Any]:
        return [column[rows] for column in self.columns]


def boxes_and_rays(
    ndim: int, boxes: int, rays: int, signs: tuple[int, ...] = (0, 0, 0), margin: float = 0.0
) -> tuple[DynamicBVH, Rays]:
    """Boxes on whole numbers, so that hits tie; rays with ends and masks, of which some begin too
    far away for float32 or have no direction.
    """
    rng = np.random.default_rng([ndim, boxes])
    edge = max(50, round(boxes ** (1 / ndim)))
    lo = rng.integers(-edge, edge, (boxes, ndim)).astype(float)
    hi = lo + rng.integers(0, 12, (boxes, ndim))
    tree = DynamicBVH.from_boxes(lo, hi, margin=margin, mask=np.arange(boxes) % 4)
    ways = rng.integers(-9, 10, (rays, ndim)).astype(float)
    for axis, sign in enumerate(signs[:ndim]):
        if sign:
            ways[:, axis] = sign * np.abs(ways[:, axis])
    origins = rng.integers(-edge - 20, edge + 20, (rays, ndim)).astype(float)
    origins[::50] *= 1e6
    ways[::31] = 0.0
    ways[::50] = -origins[::50]
    numbers = np.arange(rays)
    return tree, Rays(origins, ways, np.where(numbers % 3, INF, 2.5), numbers % 5)


def assert_same_hits(
    tree: DynamicBVH, rays: Rays, skip_inside: bool = False, step: int = 7
) -> RayHits:
    """All at once, a few at a time, in threads, and each `step`th ray alone."""
    every = rays.rows(slice(None))
    hits = tree.raycast_many(*every, skip_inside)
    occluded = tree.occluded_many(*every, skip_inside)
    assert np.array_equal(occluded, hits.ids >= 0)
    for one, other in zip(hits, tree.raycast_many(*every, skip_inside, 2), strict=True):
        assert np.array_equal(one, other)
    count = len(every[0])
    for start in range(0, count, max(count // 20, 11)):
        part = slice(start, start + 11)
        for one, other in zip(tree.raycast_many(*rays.rows(part), skip_inside), hits, strict=True):
            assert np.array_equal(one, other[part])
    for row in range(0, count, step):
        origin, way, end, mask = rays.rows(row)
        alone = tree.raycast(origin, way, end, int(mask), skip_inside)
        assert hits.ids[row] == (alone.id if alone else -1)
        assert hits.t[row] == (alone.t if alone else INF)
        assert hits.normals[row].tolist() == (alone.normal.tolist() if alone else [0] * tree.ndim)
    return hits


@pytest.mark.parametrize('ndim', [2, 3])
@pytest.mark.parametrize('signs', OCTANTS.values(), ids=OCTANTS)
@pytest.mark.parametrize('rays', [500, 2 * 4096 + 77], ids=['mixed', 'piled by octant'])
def test_as_one_by_one(ndim: int, signs: tuple[int, ...], rays: int) -> None:
    tree, some = boxes_and_rays(ndim, 300, rays, signs)
    tree.raycast_many(*some.columns)
    for skip_inside in (False, True):
        hits = assert_same_hits(tree, some, skip_inside, 29)
        assert tree.stats()['wide_snapshot']
        assert 0 < (hits.ids >= 0).sum() < rays


@pytest.mark.parametrize('margin', [0.0, 0.5])
@pytest.mark.parametrize('ndim', [2, 3])
def test_after_changes_of_every_kind(ndim: int, margin: float) -> None:
    """Snapshots are patched: after few changes, by what is far outside, and after many."""
    tree, rays = boxes_and_rays(ndim, 300, 200, margin=margin)
    rng = np.random.default_rng(9)
    assert_same_hits(tree, rays)
    for turn in range(16):
        handles = tree.ids()
        low = rng.integers(-40, 40, (6, ndim)).astype(float)
        if turn % 4 == 0:
            tree.move_many(handles[:6], low, low + rng.integers(0, 9, (6, ndim)))
        elif turn % 4 == 1:
            tree.remove_many(handles[10:13])
            tree.remove(int(handles[20]))
        elif turn % 4 == 2:
            tree.insert_many(low, low + 5.0, np.full(6, 2))
            tree.insert(low[0], low[0] + 1.0, 4)
        else:
            tree.set_masks(handles[30:36], np.array([0, 1, 2, 3, 4, ALL]))
        assert_same_hits(tree, rays, step=3)
    handle = int(tree.ids()[0])
    for far in (150.0, -1e6, 0.0):
        tree.move(handle, np.full(ndim, far), np.full(ndim, far + 30.0))
        assert_same_hits(tree, rays)
    for turn in range(129):  # one more than are noted
        tree.move(handle, np.full(ndim, turn % 7), np.full(ndim, turn % 7 + 1.0))
    for _ in range(12):  # so many visits of what was moved are worth a new snapshot
        assert_same_hits(tree, rays)
    tree.validate()


@pytest.mark.parametrize('ndim', [2, 3])
def test_few_rays_among_very_many_boxes(ndim: int) -> None:
    """They take turns; rays from one place and rays that end go in lists already where others do
    not. Also among boxes that were moved since.
    """
    tree, rays = boxes_and_rays(ndim, 50_000, 600)
    tree.raycast_many(*np.random.default_rng(1).normal(size=(2, 30_000, ndim)))
    for turn in range(3):
        for count in (1, 7, 8, 9, 71, 72, 600):
            some = Rays(*rays.rows(slice(count)))
            assert_same_hits(tree, some, step=1 + count // 20)
            origins, ways, _, masks = some.columns
            assert_same_hits(tree, Rays(origins, ways, masks=masks), step=1 + count // 20)
            assert_same_hits(tree, Rays(0.0 * origins + 0.5, ways), step=1 + count // 20)
        assert tree.stats()['wide_snapshot']
        place = np.full((2, ndim), float(turn))
        tree.move_many(tree.ids()[:2], place, place + 1.0)


@pytest.mark.parametrize('ndim', [2, 3])
@pytest.mark.parametrize('changed', [False, True])
def test_rays_at_the_faces_of_the_whole(ndim: int, changed: bool) -> None:
    """They begin on a face of the box around all, a rounding beyond it or within, or far away, and
    fly away, along it or back: rays that fly away end at once.
    """
    tree, rays = boxes_and_rays(ndim, 300, 200)
    tree.raycast_many(*rays.columns)
    if changed:
        low, high = tree.boxes(tree.ids()[:3])
        tree.move_many(tree.ids()[:3], low - 30.0, high - 30.0)
    rng, count = np.random.default_rng(4), 200
    assert tree.bounds is not None
    faces = np.array(tree.bounds)
    near = [np.nextafter(faces, -INF), faces, np.nextafter(faces, INF), faces * 1e9]
    origins = rng.uniform(*faces, (count, ndim))
    axes, sides, steps = rng.integers(ndim, size=count), rng.integers(2, size=count), range(count)
    origins[steps, axes] = [near[i % 4][sides[i], axes[i]] for i in steps]
    ways = rng.integers(-1, 2, (count, ndim)) * rng.choice([-1.0, 1.0], (count, ndim))
    hits = assert_same_hits(tree, Rays(origins, ways, masks=rng.integers(1, 4, count)), step=1)
    assert 5 < np.count_nonzero(hits.ids >= 0) < count // 2


def deep_tree() -> DynamicBVH:
    """Boxes of ever larger scales: wide nodes have few children, level after level."""
    size = 2.0 ** (np.arange(200) / 8)[:, None]
    tree = DynamicBVH.from_boxes(size * [1.0, -1, -1], size * [1.5, 1, 1])
    assert tree.height > 15
    return tree


def test_a_deep_tree_and_more_rays_than_are_sorted_together() -> None:
    ways = np.c_[np.ones(500), np.linspace(-2, 2, 500), np.zeros(500)]
    assert_same_hits(deep_tree(), Rays(np.zeros((500, 3)), ways))
    assert_same_hits(*boxes_and_rays(3, 50, 8 * 4096 + 2000), step=997)


def test_scratch_is_large_enough_for_all() -> None:
    """Batches of any size among trees of any depth and dimension take turns, in several threads:
    none reads what another one left behind.
    """
    solid, rays = boxes_and_rays(3, 300, 2048)
    every = [boxes_and_rays(2, 300, 2048), (solid, rays), (deep_tree(), rays)]
    whole = [tree.raycast_many(*rays.columns) for tree, rays in every]

    def ask(seed: int) -> bool:
        rng, same = np.random.default_rng(seed), True
        for _ in range(60):
            which, count = rng.integers(3), rng.integers(72, 1124)
            tree, rays = every[which]
            rows = rng.permutation(2048)[:count]
            for part, all_ in zip(tree.raycast_many(*rays.rows(rows)), whole[which], strict=True):
                same &= bool((part == all_[rows]).all())
        return same

    with ThreadPoolExecutor(3) as pool:
        assert all(pool.map(ask, range(4)))


@pytest.mark.parametrize('boxes', [40, 20_000], ids=['snapshot', 'binary tree'])
@pytest.mark.parametrize('argument', ['origins', 'directions'])
@pytest.mark.parametrize('ndim', [2, 3])
def test_the_first_row_that_is_not_finite_is_named(ndim: int, boxes: int, argument: str) -> None:
    tree, rays = boxes_and_rays(ndim, boxes, 200)
    given = dict(zip(('origins', 'directions'), rays.columns, strict=False))
    given['origins'][7], given['directions'][7] = 1e3, 1.0  # it flies away from all
    tree.raycast_many(**given)
    assert tree.stats()['wide_snapshot'] == (boxes < 200)
    before = tree.stats()
    for axis in range(ndim):
        for bad in (np.nan, INF, -INF):
            spoilt = given[argument].copy()
            spoilt[[7, 150], [axis, 0]] = bad
            for ask in (tree.raycast_many, tree.occluded_many):
                for rows in (slice(10), slice(None)):
                    some = {name: column[rows] for name, column in given.items()}
                    with pytest.raises(ValueError, match=f'^{argument} must be finite: row 7 '):
                        ask(**{**some, argument: spoilt[rows]}, threads=1 + axis % 2)
    assert tree.stats() == before


@pytest.mark.parametrize('boxes', [40, 20_000], ids=['snapshot', 'binary tree'])
def test_one_limit_for_all_is_the_same_for_each(boxes: int) -> None:
    tree, rays = boxes_and_rays(3, boxes, 200)
    origins, ways = rays.columns[:2]
    for mask in (1, 2, np.uint32(2)):
        for t_max in (0, 5.0, np.float64(9.5)):
            one = tree.raycast_many(origins, ways, t_max, mask)
            each = tree.raycast_many(*Rays(origins, ways, t_max, mask).columns)
            for a, b in zip(one, each, strict=True):
                assert (a == b).all()
            assert (tree.occluded_many(origins, ways, t_max, mask) == (one.ids >= 0)).all()


@pytest.mark.parametrize('ndim', [2, 3])
def test_one_origin_or_direction_serves_for_all_rays(ndim: int) -> None:
    rng = np.random.default_rng(8)
    lo = rng.uniform(-5, 5, (80, ndim))
    tree = DynamicBVH.from_boxes(lo, lo + 0.5)
    one, many = rng.uniform(-1, 1, ndim), rng.normal(size=(300, ndim))
    every = np.tile(one, (300, 1))
    for row in (one, one.tolist(), tuple(one)):
        for got, right in (
            (tree.raycast_many(row, many), tree.raycast_many(every, many)),
            (tree.raycast_many(many, row), tree.raycast_many(many, every)),
            (tree.raycast_all_many(row, many), tree.raycast_all_many(every, many)),
            ([tree.occluded_many(row, many)], [tree.occluded_many(every, many)]),
        ):
            assert len(right[0])
            for column, other in zip(got, right, strict=True):
                assert np.array_equal(column, other)
    with pytest.raises(ValueError, match='directions must have shape'):
        tree.raycast_many(one, one)
