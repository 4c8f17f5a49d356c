# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Any sequence of changes leaves a sound tree that answers at any time as exact arithmetic over a
plain dictionary of boxes does.
"""

import math
import pickle
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from tree.motion.exact import Course, World, meetings, squared_distances
from tree.reference import (
    LONG,
    Floats,
    Ids,
    effort,
    exact_hits,
    exact_sweeps,
    is_within_2_ulp,
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
# Among these boxes that move can be swept.
CALM_SIDES = st.sampled_from([0.0, 0.1, 1 / 3, 1.0, 2.0, -0.3, -1.0, -2.5])
SOME_SIDES = st.sampled_from([0.0, 0.1, 1 / 3, 1.0, 2.0, -0.3, -1.0, -2.5, 1e6, 1e-9])
CALM_SPEEDS = st.sampled_from([0.0, 1.0, -1.0, 1 / 3, 0.1, 2.0])
SPEEDS = st.sampled_from([0.0, 0.0, 1.0, -1.0, 1 / 3, 0.1, -2.0, 1e-9, 1e4])
TIMES = st.sampled_from([0.0, 0.0, 1.0, -1.0, 0.1, 1 / 3, 2.5])
FAN = 5


class Box(NamedTuple):
    lo: list[float]
    hi: list[float]
    mask: int
    velocity: list[float]
    reference: float = 0.0

    def changed(self, **fields: Any) -> 'Box':
        return self._replace(**fields)


class TreeMachine(RuleBasedStateMachine):
    """A tree, and beside it the boxes that it was given."""

    moving = False
    sides = SIDES

    @initialize(
        ndim=st.sampled_from([2, 3]),
        margin=st.sampled_from([0.0, 0.0, 0.2, 1e9]),
        search=st.sampled_from(['greedy', 'branch_and_bound']),
    )
    def start(self, ndim: int, margin: float, search: str) -> None:
        self.tree = DynamicBVH(ndim, margin=margin, sibling_search=search, capacity=1)
        self.model: dict[int, Box] = {}
        self.stale: list[int] = []
        self.newest = -1

    # ---- drawing

    def draw_box(self, data: st.DataObject) -> tuple[list[float], list[float]]:
        corners = [
            sorted(data.draw(st.tuples(self.sides, self.sides))) for _ in range(self.tree.ndim)
        ]
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
            self.model[handle] = Box(list(low), list(high), int(mask), [0.0] * self.tree.ndim)
            self.newest = handle

    def change(self, handle: int, **fields: Any) -> None:
        self.model[handle] = self.model[handle].changed(**fields)

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
        self.change(handle, lo=lo, hi=hi)

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
            self.change(handle, lo=low, hi=high)

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
            self.change(handle, mask=mask)

    @precondition(lambda self: self.moving and self.model)
    @rule(data=st.data())
    def set_velocities(self, data: st.DataObject) -> None:
        handles, ndim = self.some_handles(data)[:4], self.tree.ndim
        speeds = CALM_SPEEDS if self.sides is CALM_SIDES else SPEEDS
        rows = [list(data.draw(st.tuples(*[speeds] * ndim))) for _ in handles]
        times = [data.draw(TIMES) for _ in handles]
        self.tree.set_velocities(handles, np.array(rows).reshape(-1, ndim), np.array(times))
        for handle, velocity, time in zip(handles, rows, times, strict=True):
            self.change(handle, velocity=velocity, reference=time)

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

    # ---- questions about boxes as they were given, also where some move

    @rule(
        data=st.data(),
        mask=MASKS,
        t_max=st.sampled_from([math.inf, 0.0, 1.0, 2.5]),
        skip=st.booleans(),
    )
    def cast_a_ray(self, data: st.DataObject, mask: int, t_max: float, skip: bool) -> None:
        axes = [SIDES] * self.tree.ndim
        origin, direction = (np.array(data.draw(st.tuples(*axes))) for _ in range(2))
        handles, lo, hi, masks = self.arrays()
        hits = exact_hits(lo, hi, origin[None], direction[None])[0]
        expected = [
            handles[hit.row] for hit in seen(hits, handles, t_max, skip, masks & mask != 0)
        ]
        got = self.tree.raycast_all(origin, direction, t_max, mask, skip, at=None)
        assert [hit.id for hit in got] == expected
        first = self.tree.raycast(origin, direction, t_max, mask, skip, at=None)
        assert (first.id if first else None) == (expected[0] if expected else None)
        assert self.tree.occluded(origin, direction, t_max, mask, skip, at=None) == bool(expected)
        batch = self.tree.raycast_many([origin] * 64, [direction] * 64, t_max, mask, skip, at=None)
        assert set(batch.ids.tolist()) == {expected[0] if expected else -1}

    @rule(data=st.data(), mask=MASKS)
    def sweep_a_box(self, data: st.DataObject, mask: int) -> None:
        low, high = self.draw_box(data)
        way = np.array(data.draw(st.tuples(*[SIDES] * self.tree.ndim)))
        handles, lo, hi, masks = self.arrays()
        met = exact_sweeps(lo, hi, np.array([low]), np.array([high]), way[None])[0]
        expected = [handles[hit.row] for hit in seen(met, handles, visible=masks & mask != 0)]
        hit = self.tree.boxcast(low, high, way, mask, at=None)
        assert (hit.id if hit else None) == (expected[0] if expected else None)

    @rule(data=st.data(), mask=MASKS)
    def ask_for_overlaps(self, data: st.DataObject, mask: int) -> None:
        low, high = self.draw_box(data)
        handles, lo, hi, masks = self.arrays()
        rows = overlapping_rows(lo, hi, np.array(low), np.array(high))
        expected = [handles[row] for row in rows if masks[row] & mask]
        assert self.tree.overlap(low, high, mask, at=None).tolist() == expected

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
        ids, got = self.tree.nearest(point, k, mask=mask, at=None)
        assert len(ids) == min(k, len(kept))
        assert got.tolist() == pytest.approx(sorted(distances.tolist())[:k], rel=1e-15, abs=1e-322)
        own = {int(handles[row]): float(d) for row, d in zip(kept, distances, strict=True)}
        assert got.tolist() == pytest.approx([own[h] for h in ids.tolist()], rel=1e-15, abs=1e-322)

    # ---- questions about boxes that move

    def world(self) -> tuple[Ids, World]:
        """The boxes that any mask sees."""
        handles, lo, hi, masks = self.arrays()
        boxes = [self.model[handle] for handle in sorted(self.model)]
        velocities = np.array([box.velocity for box in boxes], float).reshape(lo.shape)
        world = World(lo, hi, velocities, np.array([box.reference for box in boxes], float))
        return handles[masks != 0], World(*(column[masks != 0] for column in world))

    def exact_hits_at(self, course: Course, limit: float) -> tuple[Ids, list[Any]]:
        handles, world = self.world()
        return handles, seen(meetings(world, course), handles, limit) if len(handles) else []

    @precondition(lambda self: self.moving)
    @rule(data=st.data(), pace=TIMES, at=TIMES, limit=st.sampled_from([1.0, 0.5, 3.0]))
    def cast_a_ray_at(self, data: st.DataObject, pace: float, at: float, limit: float) -> None:
        rows = (
            data.draw(st.tuples(*[values] * self.tree.ndim)) for values in (self.sides, SPEEDS)
        )
        origin, way = map(np.array, rows)
        handles, right = self.exact_hits_at(Course(origin, origin, way, at, pace), limit)
        ids, times = [int(handles[hit.row]) for hit in right], {'at': at, 'pace': pace}
        every = self.tree.raycast_all(origin, way, limit, **times)
        assert [hit.id for hit in every] == ids
        assert all(is_within_2_ulp(h.t, e.t) for h, e in zip(every, right, strict=True))
        hit = self.tree.raycast(origin, way, limit, **times)
        assert (hit.id if hit else None) == (ids[0] if ids else None)
        many = self.tree.raycast_many([origin] * 64, [way] * 64, limit, **times)
        assert (many.ids == (ids[0] if ids else -1)).all()

    @precondition(lambda self: self.moving and self.model)
    @rule(data=st.data(), at=TIMES)
    def ask_for_boxes_at(self, data: st.DataObject, at: float) -> None:
        lo, hi = map(np.array, self.draw_box(data))
        handles, world = self.world()
        met = meetings(world, Course(lo, hi, 0 * lo, at, 0.0)) if len(handles) else []
        assert self.tree.overlap(lo, hi, at=at).tolist() == sorted(handles[[h.row for h in met]])
        near, gaps = self.tree.nearest(np.array((lo, hi)), k=999, at=at)
        assert sorted(near.tolist()) == handles.tolist()
        squares = squared_distances(world, lo, hi, at)
        for handle, gap in zip(near.tolist(), gaps.tolist(), strict=True):
            exact = math.sqrt(squares[handles.tolist().index(handle)])
            assert gap == pytest.approx(exact, rel=1e-15, abs=1e-160)

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
            for side, extreme in zip(self.tree.bounds, (lo.min(0), hi.max(0)), strict=True):
                assert side.tolist() == extreme.tolist()
            assert self.tree.height <= 4 * math.log2(len(handles)) + 4
        else:
            assert self.tree.bounds is None


class MovingTreeMachine(TreeMachine):
    """With velocities."""

    moving = True

    @initialize(calm=st.booleans())
    def choose(self, calm: bool) -> None:
        self.sides = CALM_SIDES if calm else SOME_SIDES

    @invariant()
    def the_same_rays_meet_what_is_there_now(self) -> None:
        """Again and again at the same times: what was swept for them before the last change says
        nothing any more.
        """
        if self.sides is not CALM_SIDES or not self.model:
            return
        ndim = self.tree.ndim
        origins = np.full((FAN, ndim), -3.0)
        ways = np.linspace([0.25] * ndim, [1.75, *[1.0] * (ndim - 1)], FAN)
        many = self.tree.raycast_many(
            np.tile(origins, (16, 1)), np.tile(ways, (16, 1)), 4.0, at=0.5, pace=0.25
        )
        for row, (origin, way) in enumerate(zip(origins, ways, strict=True)):
            handles, exact = self.exact_hits_at(Course(origin, origin, way, 0.5, 0.25), 4.0)
            first = [int(handles[hit.row]) for hit in exact][:1]
            assert set(many.ids[row::FAN].tolist()) == set(first or [-1])

    @invariant()
    def velocities_are_kept(self) -> None:
        handles, world = self.world()
        velocities, times = self.tree.velocities(handles)
        assert velocities.tolist() == world.velocities.tolist()
        assert times.tolist() == world.references.tolist()


TestMovingTree = pytest.mark.slow(MovingTreeMachine.TestCase)
TestMovingTree.settings = settings(
    max_examples=effort(40, 2000), stateful_step_count=25, suppress_health_check=list(HealthCheck)
)
TestTree = TreeMachine.TestCase
TestTree.settings = settings(
    max_examples=effort(40, 2000),
    stateful_step_count=effort(40, 100),
    derandomize=not LONG,
    suppress_health_check=list(HealthCheck),
)
