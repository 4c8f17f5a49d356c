# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Many rays together find what each finds alone: lists of one ray and of thousands, with and
without masks, in few octants and many.
"""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from tree.reference import Floats, Ids, exact_hits, seen

from bvh_ros import DynamicBVH
from bvh_ros.tree.batch.snapshot import LEAST_RAYS
from bvh_ros.tree.batch.streams import KEPT_RAYS, MIXED_RAYS, RAYS_SORTED, Scratch, make_scratch
from bvh_ros.tree.query import ray_queries as ray_batches
from bvh_ros.tree.query.ray_queries import FEW_TOGETHER

OCTANTS: dict[str, tuple[int, ...]] = {
    'one octant': (1, 1, 1),
    'another': (-1, 1, -1),
    'all octants': (0, 0, 0),
    'along a face': (1, -1, 0),
}


def scene(ndim: int, boxes: int, rays: int, signs: tuple[int, ...]) -> tuple[DynamicBVH, ...]:
    """A tree of boxes on whole numbers, so that many hits tie, and rays of these signs."""
    rng = np.random.default_rng(ndim * boxes)
    lo = rng.integers(-50, 50, (boxes, ndim)).astype(float)
    tree = DynamicBVH.from_boxes(lo, lo + rng.integers(0, 12, (boxes, ndim)))
    ways = rng.integers(-9, 10, (rays, ndim)).astype(float)
    for axis, sign in enumerate(signs[:ndim]):
        if sign:
            ways[:, axis] = sign * np.abs(ways[:, axis])
    return tree, rng.integers(-70, 70, (rays, ndim)).astype(float), ways


@pytest.mark.parametrize('ndim', [2, 3])
@pytest.mark.parametrize('signs', OCTANTS.values(), ids=OCTANTS)
@pytest.mark.parametrize('masked', [False, True], ids=['all seen', 'masks'])
@pytest.mark.parametrize('rays', [500, MIXED_RAYS + 77], ids=['mixed', 'piled by octant'])
def test_as_one_by_one(ndim: int, signs: tuple[int, ...], masked: bool, rays: int) -> None:
    tree, origins, ways = scene(ndim, 300, rays, signs)
    masks = np.full(len(ways), 0xFFFFFFFF, np.uint32)
    if masked:
        tree.set_masks(tree.ids(), np.arange(300) % 4)
        masks = np.arange(len(ways), dtype=np.uint32) % 5
    t_max = np.where(np.arange(len(ways)) % 3, np.inf, 2.5)
    tree.raycast_many(origins, ways)
    for skip_inside in (False, True):
        hits = tree.raycast_many(origins, ways, t_max, masks, skip_inside)
        free = tree.occluded_many(origins, ways, t_max, masks, skip_inside)
        assert tree.stats()['wide_snapshot']
        assert (free == (hits.ids >= 0)).all()
        assert 0 < free.sum() < len(free)
        for row in range(0, len(ways), 7):
            alone = tree.raycast(origins[row], ways[row], t_max[row], int(masks[row]), skip_inside)
            assert hits.ids[row] == (alone.id if alone else -1)
            assert hits.t[row] == (alone.t if alone else np.inf)
            assert hits.normals[row].tolist() == (alone.normal.tolist() if alone else [0] * ndim)


def test_more_rays_than_are_sorted_together() -> None:
    tree, origins, ways = scene(3, 50, RAYS_SORTED + 2000, OCTANTS['all octants'])
    hits = tree.raycast_many(origins, ways)
    for part in (slice(0, 1000), slice(RAYS_SORTED - 500, RAYS_SORTED + 500), slice(-1000, None)):
        few = tree.raycast_many(origins[part], ways[part])
        for all_, some in zip(hits, few, strict=True):
            assert (all_[part] == some).all()


SMALL = st.integers(-4, 4).map(float)


@given(
    arrays(np.float64, st.tuples(st.integers(2, 40), st.just(3)), elements=SMALL),
    arrays(np.float64, (LEAST_RAYS, 3), elements=SMALL),
    arrays(np.float64, (LEAST_RAYS, 3), elements=SMALL | st.just(-0.0)),
)
def test_exactly(lo: Floats, origins: Floats, ways: Floats) -> None:
    tree = DynamicBVH.from_boxes(lo, lo + 1)
    handles = tree.ids()
    ids = tree.raycast_many(origins, ways).ids
    for row, hits in enumerate(exact_hits(lo, lo + 1, origins, ways)):
        first = seen(hits, handles)
        assert ids[row] == (handles[first[0].row] if first else -1)


def test_a_deep_tree() -> None:
    """Boxes of ever larger scales: wide nodes have few children, level after level. No more of
    them than `MOST_BLURRED` lie together for a float32.
    """
    size = 2.0 ** (np.arange(200) / 8)[:, None]
    lo, hi = size * [1.0, -1, -1], size * [1.5, 1, 1]
    tree = DynamicBVH.from_boxes(lo, hi)
    origins = np.tile([[0.0, 0, 0]], (500, 1))
    ways = np.c_[np.ones(500), np.linspace(-2, 2, 500), np.zeros(500)]
    assert tree.height > 15
    hits = tree.raycast_many(origins, ways)
    assert tree.stats()['wide_snapshot']
    for row in range(500):
        alone = tree.raycast(origins[row], ways[row])
        assert hits.ids[row] == (alone.id if alone else -1)


def test_what_is_noted_stays_in_its_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """All rays hit, and some find a nearer box when all have been noted as hitting."""
    tree, origins, ways = scene(3, 300, 40_000, OCTANTS['one octant'])
    hit = tree.raycast_many(origins, ways).ids >= 0
    fence: list[Ids] = []

    def fenced(count: int, ndim: int, depth: int) -> Scratch:
        scratch = make_scratch(count, ndim, depth)
        fence.append(np.full(len(scratch.found) + 1, 77, np.int32))
        return scratch._replace(found=fence[-1][:-1])

    monkeypatch.setattr(ray_batches, 'scratch_for', fenced)
    monkeypatch.setattr(ray_batches, 'FEW_RAYS', 0)
    for start in range(0, int(hit.sum()) - 64, 64):
        rows = np.flatnonzero(hit)[start : start + 64]
        assert (tree.raycast_many(origins[rows], ways[rows]).ids >= 0).all()
    assert len(fence) > 50
    assert all(room[-1] == 77 for room in fence)


def test_kept_scratch_is_large_enough_for_all() -> None:
    """Batches of any size among trees of any depth and dimension take turns, in several threads:
    what one leaves behind is nothing to the next.
    """
    size = 2.0 ** (np.arange(200) / 8)[:, None]
    deep = DynamicBVH.from_boxes(size * [1.0, -1, -1], size * [1.5, 1, 1])
    flat = scene(2, 300, 2 * KEPT_RAYS, OCTANTS['all octants'])
    solid = scene(3, 300, 2 * KEPT_RAYS, OCTANTS['all octants'])
    every = [flat, solid, (deep, *solid[1:])]
    whole = [tree.raycast_many(origins, ways) for tree, origins, ways in every]

    def ask(seed: int) -> bool:
        rng, same = np.random.default_rng(seed), True
        for _ in range(60):
            which, count = rng.integers(3), rng.integers(FEW_TOGETHER, KEPT_RAYS + 100)
            tree, origins, ways = every[which]
            rows = rng.permutation(len(origins))[:count]
            hits = tree.raycast_many(origins[rows], ways[rows], 1e9)
            for part, all_ in zip(hits, whole[which], strict=True):
                same &= bool((part == all_[rows]).all())
        return same

    with ThreadPoolExecutor(3) as pool:
        assert all(pool.map(ask, range(4)))
