# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Any sequence of changes leaves a sound tree that answers as brute force over a plain dictionary
of boxes does.
"""

import math
import pickle
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from tree.reference import (
    LONG,
    Floats,
    Ids,
    effort,
    exact_hits,
    exact_sweeps,
    overlapping_pairs,
    overlapping_rows,
    seen,
)

from bvh_ros import ALL, DynamicBVH

# Few values, so that boxes touch, coincide and are flat; thirds and tenths, so that arithmetic
# rounds; a few far out.
SIDES = st.sampled_from(
    [0.0, 0.1, 1 / 3, 0.5, 1.0, 2.0, 1e9, -0.0, -0.3, -1.0, -2.5, 5e-324, 1e300]
)
MASKS = st.sampled_from([0, 1, 2, 3, 0x80000000, ALL])
SEEDS = st.integers(0, 2**32 - 1)


class TreeMachine(RuleBasedStateMachine):
    @initialize(
        ndim=st.sampled_from([2, 3]),
        margin=st.sampled_from([0.0, 0.0, 0.2, 1e9]),
        search=st.sampled_from(['greedy', 'branch_and_bound']),
    )
    def start(self, ndim: int, margin: float, search: str) -> None:
        self.tree = DynamicBVH(ndim, margin=margin, sibling_search=search, capacity=1)
        self.model: dict[int, tuple[list[float], list[float], int]] = {}
        self.stale: list[int] = []
        self.newest = -1

    # ---- drawing

    def draw_box(self, data: st.DataObject) -> tuple[list[float], list[float]]:
        corners = [sorted(data.draw(st.tuples(SIDES, SIDES))) for _ in range(self.tree.ndim)]
        return [low for low, _ in corners], [high for _, high in corners]

    def random_boxes(self, seed: int, count: int) -> tuple[Floats, Floats]:
        """Too many to draw side by side."""
        rng = np.random.default_rng(seed)
        lo = rng.integers(-8, 8, (count, self.tree.ndim)) / rng.choice([1.0, 2.0, 3.0, 10.0])
        return lo, lo + rng.integers(0, 4, lo.shape) / rng.choice([1.0, 3.0])

    def some_handles(self, data: st.DataObject) -> list[int]:
        return data.draw(st.lists(st.sampled_from(sorted(self.model)), unique=True))

    def arrays(self) -> tuple[Ids, Floats, Floats, np.ndarray[Any, Any]]:
        handles = sorted(self.model)
        rows = [self.model[handle] for handle in handles]
        shape = (len(rows), self.tree.ndim)
        lo, hi = (np.array([row[side] for row in rows], float).reshape(shape) for side in (0, 1))
        return np.array(handles, np.int64), lo, hi, np.array([row[2] for row in rows], np.uint32)

    def admit(self, handles: list[int], lo: Any, hi: Any, masks: Any) -> None:
        assert handles == sorted(set(handles))
        assert not handles or handles[0] > self.newest
        for handle, low, high, mask in zip(handles, lo, hi, masks, strict=True):
            self.model[handle] = list(low), list(high), int(mask)
            self.newest = handle

    def forget(self, handles: list[int]) -> None:
        for handle in handles:
            del self.model[handle]
        self.stale += handles

    # ---- changes

    @rule(data=st.data(), mask=MASKS)
    def insert(self, data: st.DataObject, mask: int) -> None:
        lo, hi = self.draw_box(data)
        self.admit([self.tree.insert(lo, hi, mask)], [lo], [hi], [mask])

    @rule(seed=SEEDS, count=st.sampled_from([0, 1, 2, 5, 20]), masked=st.booleans())
    def insert_many(self, seed: int, count: int, masked: bool) -> None:
        lo, hi = self.random_boxes(seed, count)
        masks = np.random.default_rng(seed).integers(0, 8, count)
        handles = self.tree.insert_many(lo, hi, masks if masked else None)
        self.admit(handles.tolist(), lo, hi, masks if masked else np.ones(count))

    @precondition(lambda self: self.model)
    @rule(data=st.data(), ahead=st.sampled_from([None, 0.0, 0.7, -3.0]))
    def move(self, data: st.DataObject, ahead: float | None) -> None:
        handle = data.draw(st.sampled_from(sorted(self.model)))
        lo, hi = self.draw_box(data)
        if data.draw(st.booleans()):  # a small step
            lo, hi = ((np.array(side) + 0.05).tolist() for side in self.model[handle][:2])
        displacement = None if ahead is None else np.full(self.tree.ndim, ahead)
        same = (lo, hi) == self.model[handle][:2]
        changed = self.tree.move(handle, lo, hi, displacement)
        assert isinstance(changed, bool)
        if self.tree.margin == 0.0 and not self.tree.stats()['exact_boxes_beside_nodes']:
            assert changed != same
        self.model[handle] = lo, hi, self.model[handle][2]

    @precondition(lambda self: self.model)
    @rule(data=st.data(), seed=SEEDS, ahead=st.booleans(), small=st.booleans())
    def move_many(self, data: st.DataObject, seed: int, ahead: bool, small: bool) -> None:
        handles = self.some_handles(data)
        lo, hi = self.random_boxes(seed, len(handles))
        if small and handles:
            lo, hi = (np.array([self.model[h][side] for h in handles]) + 0.05 for side in (0, 1))
        displacement = np.random.default_rng(seed).normal(size=lo.shape) if ahead else None
        count = self.tree.move_many(handles, lo, hi, displacement)
        assert 0 <= count <= len(handles)
        for handle, low, high in zip(handles, lo.tolist(), hi.tolist(), strict=True):
            self.model[handle] = low, high, self.model[handle][2]

    @precondition(lambda self: self.model)
    @rule(data=st.data())
    def remove(self, data: st.DataObject) -> None:
        handle = data.draw(st.sampled_from(sorted(self.model)))
        self.tree.remove(handle)
        self.forget([handle])

    @precondition(lambda self: self.model)
    @rule(data=st.data())
    def remove_many(self, data: st.DataObject) -> None:
        handles = self.some_handles(data)
        self.tree.remove_many(handles)
        self.forget(handles)

    @precondition(lambda self: self.model)
    @rule(data=st.data(), mask=MASKS)
    def set_masks(self, data: st.DataObject, mask: int) -> None:
        handles = self.some_handles(data)
        self.tree.set_masks(handles, mask)
        for handle in handles:
            self.model[handle] = *self.model[handle][:2], mask

    @rule(how=st.sampled_from(['rebuild', 'optimize']))
    def improve(self, how: str) -> None:
        getattr(self.tree, how)()

    @rule()
    def clear(self) -> None:
        self.tree.clear()
        self.forget(list(self.model))

    @rule(through_file=st.booleans())
    def keep_and_come_back(self, through_file: bool) -> None:
        if not through_file:
            self.tree = pickle.loads(pickle.dumps(self.tree))
            return
        with tempfile.TemporaryDirectory() as folder:
            self.tree.save(Path(folder) / 'tree.npz')
            self.tree = DynamicBVH.load(Path(folder) / 'tree.npz')

    # ---- mistakes change nothing: the invariants below look

    @precondition(lambda self: self.stale)
    @rule(data=st.data())
    def use_a_stale_handle(self, data: st.DataObject) -> None:
        handle = data.draw(st.sampled_from(self.stale))
        zero = [0.0] * self.tree.ndim
        mixed = [*self.model, handle]
        assert handle not in self.tree
        for attempt in (
            lambda: self.tree.remove(handle),
            lambda: self.tree.move(handle, zero, zero),
            lambda: self.tree.remove_many(mixed),
            lambda: self.tree.move_many(mixed, [zero] * len(mixed), [zero] * len(mixed)),
            lambda: self.tree.set_masks(mixed, 7),
            lambda: self.tree.boxes([handle]),
        ):
            with pytest.raises(KeyError):
                attempt()

    # ---- questions

    @rule(
        data=st.data(),
        mask=MASKS,
        t_max=st.sampled_from([math.inf, 0.0, 1.0, 2.5]),
        skip=st.booleans(),
    )
    def cast_a_ray(self, data: st.DataObject, mask: int, t_max: float, skip: bool) -> None:
        axes = [SIDES] * self.tree.ndim
        origin, direction = (
            np.array(data.draw(st.tuples(*axes))),
            np.array(data.draw(st.tuples(*axes))),
        )
        handles, lo, hi, masks = self.arrays()
        hits = exact_hits(lo, hi, origin[None], direction[None])[0]
        expected = [
            handles[hit.row] for hit in seen(hits, handles, t_max, skip, masks & mask != 0)
        ]
        got = self.tree.raycast_all(origin, direction, t_max, mask, skip)
        assert [hit.id for hit in got] == expected
        first = self.tree.raycast(origin, direction, t_max, mask, skip)
        assert (first.id if first else None) == (expected[0] if expected else None)
        assert self.tree.occluded(origin, direction, t_max, mask, skip) == bool(expected)
        batch = self.tree.raycast_many([origin] * 64, [direction] * 64, t_max, mask, skip)
        assert set(batch.ids.tolist()) == {expected[0] if expected else -1}

    @rule(data=st.data(), mask=MASKS)
    def sweep_a_box(self, data: st.DataObject, mask: int) -> None:
        low, high = self.draw_box(data)
        way = np.array(data.draw(st.tuples(*[SIDES] * self.tree.ndim)))
        handles, lo, hi, masks = self.arrays()
        met = exact_sweeps(lo, hi, np.array([low]), np.array([high]), way[None])[0]
        expected = [handles[hit.row] for hit in seen(met, handles, visible=masks & mask != 0)]
        hit = self.tree.boxcast(low, high, way, mask)
        assert (hit.id if hit else None) == (expected[0] if expected else None)

    @rule(data=st.data(), mask=MASKS)
    def ask_for_overlaps(self, data: st.DataObject, mask: int) -> None:
        low, high = self.draw_box(data)
        handles, lo, hi, masks = self.arrays()
        rows = overlapping_rows(lo, hi, np.array(low), np.array(high))
        expected = [handles[row] for row in rows if masks[row] & mask]
        assert self.tree.overlap(low, high, mask).tolist() == expected

    @rule(mask=MASKS)
    def ask_for_pairs(self, mask: int) -> None:
        handles, lo, hi, masks = self.arrays()
        kept = np.flatnonzero(masks & mask)
        pairs = overlapping_pairs(lo[kept], hi[kept])
        expected = [[handles[kept[a]], handles[kept[b]]] for a, b in pairs]
        assert self.tree.overlap_pairs(mask).tolist() == expected

    @rule(data=st.data(), mask=MASKS, k=st.integers(1, 5))
    def ask_for_the_nearest(self, data: st.DataObject, mask: int, k: int) -> None:
        point = np.array(data.draw(st.tuples(*[SIDES] * self.tree.ndim)))
        handles, lo, hi, masks = self.arrays()
        kept = np.flatnonzero(masks & mask)
        gaps = np.maximum(np.maximum(lo - point, point - hi), 0.0)[kept]
        distances = np.array([math.hypot(*gap) for gap in gaps.tolist()])
        ids, got = self.tree.nearest(point, k, mask=mask)
        assert len(ids) == min(k, len(kept))
        assert got.tolist() == pytest.approx(sorted(distances.tolist())[:k], rel=1e-15, abs=1e-322)
        own = {int(handles[row]): float(d) for row, d in zip(kept, distances, strict=True)}
        assert got.tolist() == pytest.approx([own[h] for h in ids.tolist()], rel=1e-15, abs=1e-322)

    # ---- what holds always

    @invariant()
    def tree_is_sound(self) -> None:
        self.tree.validate()

    @invariant()
    def tree_holds_the_boxes(self) -> None:
        handles, lo, hi, masks = self.arrays()
        assert len(self.tree) == len(handles)
        assert self.tree.ids().tolist() == handles.tolist()
        low, high = self.tree.boxes(handles)
        assert (low.tolist(), high.tolist()) == (lo.tolist(), hi.tolist())
        assert self.tree.masks(handles).tolist() == masks.tolist()
        if len(handles):
            assert [side.tolist() for side in self.tree.bounds] == [
                lo.min(0).tolist(),
                hi.max(0).tolist(),
            ]
            assert self.tree.height <= 4 * math.log2(len(handles)) + 4
        else:
            assert self.tree.bounds is None


TestTree = TreeMachine.TestCase
TestTree.settings = settings(
    max_examples=effort(40, 2000),
    stateful_step_count=effort(40, 100),
    derandomize=not LONG,
    suppress_health_check=list(HealthCheck),
)
