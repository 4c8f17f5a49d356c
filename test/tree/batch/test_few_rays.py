# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A batch finds the same ray by ray and in lists, and in a snapshot that was patched."""

import numpy as np
import pytest
from tree.reference import Floats

from bvh_ros import DynamicBVH
from bvh_ros.tree.batch.snapshot import LOOSE_VISITS_PER_BOX
from bvh_ros.tree.nodes import RECENT_PLACES
from bvh_ros.tree.query import ray_queries as ray_batches
from bvh_ros.tree.results import RayHits

BOXES, RAYS = 300, 200


def world(ndim: int, margin: float = 0.0) -> tuple[DynamicBVH, Floats, Floats]:
    """Boxes on whole numbers, so that hits tie, and rays, of which some are for the binary tree:
    they begin too far away, or have no direction.
    """
    rng = np.random.default_rng(ndim)
    lo = rng.integers(-50, 50, (BOXES, ndim)).astype(float)
    hi = lo + rng.integers(0, 12, (BOXES, ndim))
    tree = DynamicBVH.from_boxes(lo, hi, margin=margin, mask=1 + np.arange(BOXES) % 3)
    ways = rng.integers(-9, 10, (RAYS, ndim)).astype(float)
    origins = rng.integers(-70, 70, (RAYS, ndim)).astype(float)
    origins[::50] *= 1e6
    ways[::31] = 0.0
    ways[::50] = -origins[::50]
    return tree, origins, ways


def both_ways(
    monkeypatch: pytest.MonkeyPatch, tree: DynamicBVH, *asked: object
) -> tuple[RayHits, int]:
    """The answer, and the least number of loose nodes that there were."""
    answers, loose = [], []
    for few in (0, 10**9):
        monkeypatch.setattr(ray_batches, 'FEW_RAYS', few)
        monkeypatch.setattr(ray_batches, 'FEW_TOGETHER', few)
        answers.append(tree.raycast_many(*asked))
        blocked = tree.occluded_many(*asked)
        assert (blocked == (answers[-1].ids >= 0)).all()
        snapshot = tree._wide[2]
        assert snapshot is not None
        loose.append(snapshot.loose)
    for one, other in zip(*answers, strict=True):
        assert np.array_equal(one, other)
    return answers[0], min(loose)


def check_one_by_one(tree: DynamicBVH, hits: RayHits, *asked: Floats) -> None:
    for row, ray in enumerate(zip(*asked, strict=True)):
        alone = tree.raycast(*ray[:3], mask=int(ray[3]))
        assert hits.ids[row] == (alone.id if alone else -1)
        assert hits.t[row] == (alone.t if alone else np.inf)
        assert hits.normals[row].tolist() == (alone.normal.tolist() if alone else [0] * tree.ndim)


@pytest.mark.parametrize('margin', [0.0, 0.5])
@pytest.mark.parametrize('ndim', [2, 3])
def test_after_changes_of_every_kind(
    monkeypatch: pytest.MonkeyPatch, ndim: int, margin: float
) -> None:
    tree, origins, ways = world(ndim, margin)
    rng = np.random.default_rng(9)
    asked = (
        *(origins, ways, np.where(np.arange(RAYS) % 3, np.inf, 2.5)),
        (np.arange(RAYS) % 4).astype(np.uint32),
    )
    tree.raycast_many(origins, ways)
    patched = 0
    for turn in range(12):
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
            tree.set_masks(handles[30:36], np.array([0, 1, 2, 3, 4, 0xFFFFFFFF]))
        hits, loose = both_ways(monkeypatch, tree, *asked)
        check_one_by_one(tree, hits, *asked)
        patched += loose > 0
    assert patched > 6  # else it was time for a new snapshot
    tree.validate()


def test_a_change_beyond_the_units_or_too_many_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    tree, origins, ways = world(3)
    everything = np.full(RAYS, np.inf), np.full(RAYS, 0xFFFFFFFF, np.uint32)
    handle = int(tree.ids()[0])
    for far in (150.0, -1e6):
        tree.raycast_many(origins, ways)
        tree.move(handle, np.full(3, far), np.full(3, far + 30.0))
        hits, loose = both_ways(monkeypatch, tree, origins, ways, *everything)
        assert loose == 0
        check_one_by_one(tree, hits, origins, ways, *everything)
    tree.move(handle, np.zeros(3), np.ones(3))
    tree.raycast_many(origins, ways)
    for turn in range(RECENT_PLACES + 1):
        tree.move(handle, np.full(3, turn % 7), np.full(3, turn % 7 + 1.0))
    hits, loose = both_ways(monkeypatch, tree, origins, ways, *everything)
    assert loose == 0
    check_one_by_one(tree, hits, origins, ways, *everything)


def test_many_visits_of_loose_boxes_are_worth_a_new_snapshot() -> None:
    tree, origins, ways = world(3)
    tree.raycast_many(origins, ways)
    tree.move(int(tree.ids()[0]), np.zeros(3), np.ones(3))
    seen = []
    for _ in range(LOOSE_VISITS_PER_BOX * BOXES // RAYS + 1):
        tree.raycast_many(origins, ways)
        seen.append(tree._wide[2].loose)
    assert seen[0] == 1
    assert seen[-1] == 0


def test_slots() -> None:
    tree, _, _ = world(2)
    handles = tree.ids()
    slots = tree.slots(handles.reshape(-1, 2))
    assert slots.shape == (BOXES // 2, 2)
    assert sorted(slots.ravel()) == list(range(BOXES))
    assert tree.slots(handles[3]) == tree.slot(int(handles[3])) == slots[1, 1]
    tree.remove(int(handles[5]))
    for stale in (handles[5], -1, 7):
        with pytest.raises(KeyError):
            tree.slots([handles[4], stale])
        with pytest.raises(KeyError):
            tree.slot(int(stale))


def test_a_scan_and_segments_go_in_lists(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rays from one place, and those that end, do, already where others would not; the answer is
    the same.
    """
    tree, _, ways = world(3)
    tree.raycast_many(ways, ways)  # from then on there is a snapshot
    count, lists = ray_batches.FEW_TOGETHER, []
    monkeypatch.setattr(ray_batches, 'BOXES_A_RAY', 1)  # among so few boxes, no others are few
    make = ray_batches.scratch_for
    monkeypatch.setattr(
        ray_batches, 'scratch_for', lambda *sizes: lists.append(sizes) or make(*sizes)
    )
    ways = np.tile(ways, (3, 1))[:count]
    origins = np.full((count, 3), 0.5)
    masks = np.full(count, 0xFFFFFFFF)
    scan = tree.raycast_many(origins, ways)
    assert len(lists) == 1
    check_one_by_one(tree, scan, origins, ways, np.full(count, np.inf), masks)
    tree.raycast_many(origins[1:], ways[1:])
    for other in (0, count // 2, -1):
        moved = origins.copy()
        moved[other, 1] = 3.0
        tree.raycast_many(moved, ways)
    assert len(lists) == 1
    ends = np.full(count, 3.0)
    segments = tree.raycast_many(moved, ways, ends)
    assert len(lists) == 2
    check_one_by_one(tree, segments, moved, ways, ends, masks)


@pytest.mark.parametrize('ndim', [2, 3])
@pytest.mark.parametrize('changed', [False, True])
def test_rays_at_the_faces_of_the_whole(
    monkeypatch: pytest.MonkeyPatch, ndim: int, changed: bool
) -> None:
    """They begin on a face of the box around all, a rounding beyond it or within, or far away, and
    fly away, along it or back: what flies away is not looked at.
    """
    tree, _, _ = world(ndim)
    tree.raycast_many(np.zeros((RAYS, ndim)), np.ones((RAYS, ndim)))  # from then on a snapshot
    if changed:
        low, high = tree.boxes(tree.ids()[:3])
        tree.move_many(tree.ids()[:3], low - 30.0, high - 30.0)
    rng = np.random.default_rng(4)
    assert tree.bounds is not None
    faces = np.array(tree.bounds)
    near = [np.nextafter(faces, -np.inf), faces, np.nextafter(faces, np.inf), faces * 1e9]
    origins = rng.uniform(*faces, (RAYS, ndim))
    axes, sides, steps = rng.integers(ndim, size=RAYS), rng.integers(2, size=RAYS), range(RAYS)
    origins[steps, axes] = [near[i % 4][sides[i], axes[i]] for i in steps]
    ways = rng.integers(-1, 2, (RAYS, ndim)) * rng.choice([-1.0, 1.0], (RAYS, ndim))
    masks = rng.integers(1, 4, RAYS)
    ends = np.full(RAYS, np.inf)
    hits, _ = both_ways(monkeypatch, tree, origins, ways, ends, masks)
    check_one_by_one(tree, hits, origins, ways, ends, masks)
    assert 5 < np.count_nonzero(hits.ids >= 0) < RAYS // 2
    for bad in (np.nan, np.inf, -np.inf):
        origins[7], ways[7] = faces[1] + 1.0, 1.0
        ways[7, 0] = bad
        for some in (slice(10), slice(None)):
            with pytest.raises(ValueError, match='directions must be finite: row 7'):
                tree.raycast_many(origins[some], ways[some])
