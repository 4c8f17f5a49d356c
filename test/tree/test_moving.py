# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Moving: what changes the tree and what does not, fat boxes, prediction, all three ways to move
many, and the cost in the long run.
"""

import numpy as np
import pytest
from tree.reference import effort, overlapping_rows

from bvh_ros import DynamicBVH


def crate(margin: float) -> tuple[DynamicBVH, int]:
    """A unit box at the origin among a few others."""
    tree = DynamicBVH(2, margin=margin)
    handle = tree.insert([0, 0], [1, 1])
    tree.insert_many([[9, 9], [20, 3], [-8, 4]], [[10, 10], [21, 4], [-7, 5]])
    return tree, handle


def nodes_of(tree: DynamicBVH) -> list[object]:
    return [column.tolist() for column in tree.levels(0, 64, 10**6)]


STEPS = {
    # margin, displacement before, step, whether the tree changes
    'no margin, no step': (0.0, None, [0, 0], False),
    'no margin, one ulp': (0.0, None, [2.0**-53, 0], True),
    'within the margin': (0.25, None, [0.2, -0.2], False),
    'as far as the margin': (0.25, None, [0.25, 0.25], False),
    'beyond it': (0.25, None, [0.251, 0], True),
    'beyond it in y': (0.25, None, [0, -0.251], True),
    'where it was expected': (0.0, [2.0, 0.0], [1.5, 0], False),
    'there and a margin': (0.25, [2.0, 0.0], [2.25, 0.25], False),
    'elsewhere': (0.25, [2.0, 0.0], [-0.5, 0], True),
    'too far': (0.25, [2.0, 0.0], [2.5, 0], True),
    'backwards as expected': (0.25, [-2.0, -1.0], [-2.0, -1.0], False),
}


@pytest.mark.parametrize(('margin', 'ahead', 'step', 'changes'), STEPS.values(), ids=STEPS.keys())
@pytest.mark.parametrize('many', [False, True])
def test_what_changes_the_tree(
    margin: float, ahead: list[float] | None, step: list[float], changes: bool, many: bool
) -> None:
    tree, handle = crate(margin)
    zero, one = np.zeros(2), np.ones(2)
    tree.move(handle, zero - 5, one - 5)
    tree.move(handle, zero, one, ahead)
    before = nodes_of(tree)
    lo, hi = zero + step, one + step
    if many:
        assert tree.move_many([handle], [lo], [hi], None if ahead is None else [ahead]) == int(
            changes
        )
    else:
        assert tree.move(handle, lo, hi, ahead) is changes
    assert (nodes_of(tree) == before) is not changes
    # The answers are about the exact box in any case.
    tree.validate()
    assert [side.tolist() for side in tree.boxes([handle])] == [[lo.tolist()], [hi.tolist()]]
    assert tree.overlap(hi, hi + 3).tolist() == [handle]
    assert tree.overlap(np.nextafter(hi, 9), hi + 3).tolist() == []
    assert tree.raycast([lo[0] - 1, lo[1]], [1, 0]).point.tolist() == lo.tolist()


def extent(tree: DynamicBVH) -> float:
    """Longest edge of the fat box around all."""
    lo, hi, _ = tree.levels(0, 0, 1)
    return float((hi - lo).max())


@pytest.mark.parametrize('many', [False, True])
@pytest.mark.parametrize('margin', [0.0, 0.1])
def test_a_box_that_is_large_or_fast_for_one_tick_does_not_stay_large(
    margin: float, many: bool
) -> None:
    tree, handle = crate(margin)

    def move(lo: list[float], hi: list[float], ahead: list[float]) -> bool:
        if many:
            return tree.move_many([handle], [lo], [hi], [ahead]) == 1
        return tree.move(handle, lo, hi, ahead)

    still, unit = [0.0, 0.0], ([0.0, 0.0], [1.0, 1.0])
    for lo, hi, ahead in (
        ([-500.0, -500.0], [500.0, 500.0], still),
        ([3.0, 3.0], [4.0, 4.0], [1e4, 0.0]),
    ):
        assert move(lo, hi, ahead)
        assert extent(tree) >= 1000
        assert move(*unit, still)
        assert extent(tree) <= 29 + 2 * margin + 1e-12
        assert not move(*unit, still)
        tree.validate()


@pytest.mark.parametrize('ndim', [2, 3])
@pytest.mark.parametrize('margin', [0.0, 0.5])
@pytest.mark.parametrize('ahead', [False, True])
@pytest.mark.parametrize('share', [1 / 1000, 1 / 32, 1 / 6, 1 / 3, 0.6, 1.0])
def test_all_ways_to_move_many(ndim: int, margin: float, ahead: bool, share: float) -> None:
    """Few are inserted again, more are refitted, most built anew: the tree is sound and holds what
    it should each time.
    """
    rng = np.random.default_rng(int(1000 * share))
    count = 1000
    lo = rng.uniform(0, 100, (count, ndim))
    tree = DynamicBVH(ndim, margin=margin)
    handles = tree.insert_many(lo, lo + 1)
    for far in (True, False, True):
        rows = rng.permutation(count)[: max(1, round(share * count))]
        step = (
            rng.uniform(2, 50, (len(rows), ndim))
            if far
            else np.full((len(rows), ndim), margin / 4)
        )
        lo[rows] += step
        displacement = rng.normal(size=step.shape) if ahead else None
        moved = tree.move_many(handles[rows], lo[rows], lo[rows] + 1, displacement)
        if far:
            assert moved == len(rows)
        elif margin > 0 and not ahead:
            assert moved < len(rows) or moved == 0
        tree.validate()
        assert np.array_equal(tree.boxes(handles)[0], lo)
        assert np.array_equal(tree.ids(), handles)
        for query in rng.uniform(0, 150, (10, ndim)):
            rows_hit = overlapping_rows(lo, lo + 1, query, query + 9)
            assert tree.overlap(query, query + 9).tolist() == handles[rows_hit].tolist()


def test_moving_none_or_nowhere_changes_nothing() -> None:
    rng = np.random.default_rng(1)
    lo = rng.uniform(0, 9, (50, 3))
    tree = DynamicBVH.from_boxes(lo, lo + 1)
    before = nodes_of(tree)
    assert tree.move_many([], np.empty((0, 3)), np.empty((0, 3))) == 0
    assert tree.move_many(tree.ids(), lo, lo + 1) == 0
    assert tree.move_many(tree.ids()[::-1], lo[::-1], lo[::-1] + 1) == 0
    assert nodes_of(tree) == before


@pytest.mark.parametrize('search', ['greedy', 'branch_and_bound'])
@pytest.mark.parametrize('at_once', [1, 20, 500, 1500])
def test_cost_after_many_random_moves(search: str, at_once: int) -> None:
    """However many a call moves: at most 1.25 of a fresh build's cost, checked ten times."""
    rng = np.random.default_rng(at_once)
    lo = rng.uniform(0, 100, (2000, 3))
    size = rng.uniform(0.5, 3, lo.shape)
    tree = DynamicBVH(3, sibling_search=search)
    handles = tree.insert_many(lo, lo + size)
    total = effort(100_000, 1_000_000) // (4 if search == 'branch_and_bound' else 1)
    for step in range(total // at_once):
        rows = rng.choice(2000, at_once, replace=False) if at_once > 1 else [step * 7919 % 2000]
        lo[rows] = rng.uniform(0, 100, (at_once, 3))
        if at_once == 1:
            tree.move(handles[rows[0]], lo[rows[0]], lo[rows[0]] + size[rows[0]])
        else:
            tree.move_many(handles[rows], lo[rows], lo[rows] + size[rows])
        if (step + 1) % max(total // at_once // 10, 1) == 0:
            fresh = DynamicBVH.from_boxes(lo, lo + size).cost()
            assert tree.cost() <= 1.25 * fresh
            tree.validate()


def test_boxes_that_all_walk_are_refitted_until_the_cost_says_build() -> None:
    """Up to an edge a call, mostly in place, and at most 1.25 of a fresh build's cost at any
    time.
    """
    rng = np.random.default_rng(6)
    lo = rng.uniform(0, 100, (2000, 3))
    size = rng.uniform(0.5, 3, lo.shape)
    tree = DynamicBVH.from_boxes(lo, lo + size)
    for _ in range(100):
        lo += rng.uniform(-1, 1, lo.shape) * size
        lo = 100 - abs(100 - abs(lo))  # walls reflect
        assert tree.move_many(tree.ids(), lo, lo + size) == 2000
        assert tree.cost() <= 1.25 * DynamicBVH.from_boxes(lo, lo + size).cost()
    tree.validate()
    stats = tree.stats()
    assert stats['refitted'] == 100 * 2000
    assert 2 <= stats['rebuilds'] <= 70
