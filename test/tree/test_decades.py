# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every decade of the doubles, alone, mixed, and as one far box among ordinary ones: every query
and change, singly and in batches, against exact arithmetic.
"""

import numpy as np
import pytest
from tree.reference import (
    LARGEST,
    SMALLEST,
    Floats,
    Ids,
    effort,
    exact_hits,
    exact_sweeps,
    is_distance,
    overlapping_pairs,
    overlapping_rows,
    seen,
    squared_distance,
)

from bvh_ros import DynamicBVH

Rng = np.random.Generator

DECADES = range(-320, 309)
STRIDE = effort(5, 1)  # by turns: as many kinds and dimensions see all decades
BOXES = 18
RAYS = 70  # enough for a snapshot
EXACT = effort(2, RAYS)  # rays and points whose answers are computed exactly


def finite(values: Floats) -> Floats:
    return np.clip(values, -LARGEST, LARGEST)


def times(values: Floats, decade: int) -> Floats:
    """values * 10**decade, within the doubles."""
    with np.errstate(over='ignore', under='ignore'):
        return finite(values * 10.0 ** (decade // 2) * 10.0 ** (decade - decade // 2))


def boxes_of(rng: Rng, decade: int, ndim: int) -> tuple[Floats, Floats]:
    lo = rng.uniform(-1.7, 1.7, (BOXES, ndim))
    return times(lo, decade), times(lo + rng.uniform(0, 0.4, lo.shape), decade)


def one_far_box(rng: Rng, decade: int, ndim: int) -> tuple[Floats, Floats]:
    lo, hi = boxes_of(rng, 1, ndim)
    far = rng.choice([-1.0, 1.0], ndim)
    lo[0], hi[0] = times(np.sort([far, far * rng.choice([1.0, 1.5, 1.6])], axis=0), decade)
    return lo, hi


def any_decades(rng: Rng, decade: int, ndim: int) -> tuple[Floats, Floats]:
    """Of this decade and any others, in one box even."""
    a, b = (boxes_of(rng, 0, ndim)[0] for _ in range(2))
    decades = rng.choice([*DECADES, decade, decade], (2, BOXES, ndim))
    scale = np.vectorize(times, otypes=[float])
    a, b = scale(a, decades[0]), scale(b, decades[1])
    return np.minimum(a, b), np.maximum(a, b)


KINDS = {'alone': boxes_of, 'one far box': one_far_box, 'any': any_decades}


def rays_among(rng: Rng, lo: Floats, hi: Floats, count: int) -> tuple[Floats, Floats]:
    """From box to box, from the plane of a face, along an axis, from far away."""
    ends = np.where(
        rng.random((2, count, lo.shape[1])) < 0.5,
        *(box[rng.integers(0, len(lo), (2, count))] for box in (lo, hi)),
    )
    with np.errstate(over='ignore'):
        ways = finite(ends[1] - ends[0])
        ways[rng.random(ways.shape) < 0.2] = 0.0
        starts = np.where(rng.random((count, 1)) < 0.3, finite(ends[0] - ways), ends[0])
    return starts, ways


def check_rays(rng: Rng, tree: DynamicBVH, lo: Floats, hi: Floats, handles: Ids) -> None:
    starts, ways = rays_among(rng, lo, hi, RAYS)
    hits = tree.raycast_many(starts, ways)
    singly = [tree.raycast(*ray) for ray in zip(starts, ways, strict=True)]
    assert hits.ids.tolist() == [hit.id if hit else -1 for hit in singly]
    assert hits.t.tolist() == [hit.t if hit else np.inf for hit in singly]
    assert tree.occluded_many(starts, ways).tolist() == [hit is not None for hit in singly]
    exact = exact_hits(lo, hi, starts[:EXACT], ways[:EXACT])
    offsets, ids, _ = tree.raycast_all_many(starts, ways)
    for i, of_ray in enumerate(exact):
        wanted = handles[[hit.row for hit in seen(of_ray, handles)]].tolist()
        assert ids[offsets[i] : offsets[i + 1]].tolist() == wanted
        assert hits.ids[i] == (wanted[0] if wanted else -1)
    sweeps = exact_sweeps(lo, hi, lo[:2], hi[:2], ways[:2])
    for row, sweep in enumerate(sweeps):
        hit = tree.boxcast(lo[row], hi[row], ways[row])
        wanted = seen(sweep, handles)
        assert hit is not None
        assert hit.id == handles[wanted[0].row]


def check_boxes(rng: Rng, tree: DynamicBVH, lo: Floats, hi: Floats, handles: Ids) -> None:
    a, b = (np.where(rng.random(lo.shape) < 0.5, *rng.permuted([lo, hi], axis=1)) for _ in '12')
    low, high = np.minimum(a, b), np.maximum(a, b)
    offsets, ids = tree.overlap_many(low, high)
    wanted = [handles[overlapping_rows(lo, hi, *box)] for box in zip(low, high, strict=True)]
    assert offsets.tolist() == [0, *np.cumsum([len(w) for w in wanted])]
    assert ids.tolist() == np.concatenate(wanted).tolist()
    assert tree.overlap(low[0], high[0]).tolist() == wanted[0].tolist()
    pairs = overlapping_pairs(lo, hi)
    assert tree.overlap_pairs().tolist() == [[handles[i], handles[j]] for i, j in pairs]


def check_nearest(rng: Rng, tree: DynamicBVH, lo: Floats, hi: Floats, handles: Ids) -> None:
    points = rays_among(rng, lo, hi, RAYS)[0]
    ids, distances = tree.nearest_many(points, 3)
    for i, point in enumerate(points[:30]):
        for many, one in zip((ids, distances), tree.nearest(point, 3), strict=True):
            assert many[i].tolist() == one.tolist()
    row_of = {handle: row for row, handle in enumerate(handles.tolist())}
    for i in range(EXACT):
        squares = [squared_distance(*box, points[i]) for box in zip(lo, hi, strict=True)]
        in_order = sorted(squares)
        for rank, handle in enumerate(ids[i].tolist()):
            of_rank = in_order[rank]
            assert is_distance(float(distances[i, rank]), of_rank, 8)
            assert is_distance(float(distances[i, rank]), squares[row_of[handle]], 8)


def live(rng: Rng, lo: Floats, hi: Floats, margin: float) -> None:
    """A tree's life, with its answers checked after every kind of change."""
    tree = DynamicBVH(lo.shape[1], margin=margin, capacity=1)
    handles = np.append(
        tree.insert_many(lo[:-6], hi[:-6]),
        [tree.insert(*box) for box in zip(lo[-6:], hi[-6:], strict=True)],
    )
    checks = [check_rays, check_boxes, check_nearest]
    for check in checks:
        check(rng, tree, lo, hi, handles)
    tree.optimize()
    order = rng.permutation(len(lo))
    tree.move_many(handles[order], lo, hi)
    handles = handles[order]
    for row in range(3):
        tree.remove(handles[row])
    rest = slice(3, None)
    tree.move(handles[3], lo[3], hi[3], times(np.ones(lo.shape[1]), 300))
    tree.validate()
    by_handle = np.argsort(handles[rest])
    lo, hi, handles = lo[rest][by_handle], hi[rest][by_handle], handles[rest][by_handle]
    for check in checks:
        check(rng, tree, lo, hi, handles)
    assert 0.0 <= tree.cost() <= len(tree)
    low, high = tree.bounds
    assert (low.tolist(), high.tolist()) == (lo.min(axis=0).tolist(), hi.max(axis=0).tolist())


@pytest.mark.parametrize('ndim', [2, 3])
@pytest.mark.parametrize('kind', KINDS)
def test_every_decade(kind: str, ndim: int) -> None:
    first = DECADES.start + (3 * ndim + list(KINDS).index(kind)) % STRIDE
    for decade in range(first, DECADES.stop, STRIDE):
        rng = np.random.default_rng(decade + 1000)
        live(rng, *KINDS[kind](rng, decade, ndim), margin=rng.choice([0.0, 0.5, SMALLEST, 1e300]))


@pytest.mark.parametrize('ndim', [2, 3])
def test_one_far_box_makes_no_batch_slow(ndim: int) -> None:
    """Where float32 sees the whole scene as one place, it is not asked."""
    rng = np.random.default_rng(ndim)
    lo = rng.uniform(-100, 100, (1000, ndim))
    tree = DynamicBVH.from_boxes(lo, lo + 1)
    far = tree.insert(np.full(ndim, 1e12), np.full(ndim, 1e12))
    for there in (True, False):
        hits = tree.raycast_many(lo[::-1], lo)
        assert tree.stats()['wide_snapshot'] is not there
        singly = [tree.raycast(*ray) for ray in zip(lo[::-1], lo, strict=True)]
        assert hits.ids.tolist() == [hit.id if hit else -1 for hit in singly]
        if there:
            tree.remove(far)
