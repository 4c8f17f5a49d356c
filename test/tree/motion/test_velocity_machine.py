# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Any sequence of changes leaves every box with its own velocity, and answers at any time as exact
arithmetic over a plain dictionary does.
"""

from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from tree.motion.exact import Course, Floats, World, meetings, squared_distances
from tree.reference import effort, is_within_2_ulp, seen

from bvh_ros import DynamicBVH

# Few values, so that boxes touch, go together and rest; thirds and tenths, so that it rounds.
SIDES = st.sampled_from([0.0, 0.1, 1 / 3, 1.0, 2.0, -0.3, -1.0, -2.5, 1e6, 1e-9])
SPEEDS = st.sampled_from([0.0, 0.0, 1.0, -1.0, 1 / 3, 0.1, -2.0, 1e-9, 1e4])
TIMES = st.sampled_from([0.0, 0.0, 1.0, -1.0, 0.1, 1 / 3, 2.5])
CALM_SIDES = st.sampled_from([0.0, 0.1, 1 / 3, 1.0, 2.0, -0.3, -1.0, -2.5])
CALM_SPEEDS = st.sampled_from([0.0, 1.0, -1.0, 1 / 3, 0.1, 2.0])
PACES = st.sampled_from([0.0, 1.0, -1.0, 0.1, 1 / 3])


FAN = 5


class Told(NamedTuple):
    """One box."""

    lo: Floats
    hi: Floats
    velocity: Floats
    reference: float


class VelocityMachine(RuleBasedStateMachine):
    """A tree, and beside it what it was told."""

    @initialize(
        ndim=st.sampled_from([2, 3]), margin=st.sampled_from([0.0, 0.5]), calm=st.booleans()
    )
    def begin(self, ndim: int, margin: float, calm: bool) -> None:
        self.tree, self.told = DynamicBVH(ndim, margin=margin), dict[int, Told]()
        self.calm = calm  # such that boxes can be swept

    def row(self, data: Any, values: Any) -> Floats:
        if self.calm:
            values = CALM_SIDES if values is SIDES else CALM_SPEEDS
        return np.array(data.draw(st.tuples(*[values] * self.tree.ndim)))

    def box(self, data: Any) -> tuple[Floats, Floats]:
        one, other = self.row(data, SIDES), self.row(data, SIDES)
        return np.minimum(one, other), np.maximum(one, other)

    def some(self, data: Any) -> list[int]:
        if not self.told:
            return []
        return data.draw(st.lists(st.sampled_from(sorted(self.told)), unique=True, max_size=4))

    @rule(data=st.data())
    def insert(self, data: Any) -> None:
        lo, hi = self.box(data)
        self.told[self.tree.insert(lo, hi)] = Told(lo, hi, 0 * lo, 0.0)

    @rule(data=st.data())
    def move(self, data: Any) -> None:
        for handle in self.some(data):
            lo, hi = self.box(data)
            self.tree.move(handle, lo, hi)
            self.told[handle] = self.told[handle]._replace(lo=lo, hi=hi)

    @rule(data=st.data())
    def remove(self, data: Any) -> None:
        for handle in self.some(data):
            self.tree.remove(handle)
            del self.told[handle]

    @rule(data=st.data())
    def set_velocities(self, data: Any) -> None:
        handles = self.some(data)
        rows = np.array([self.row(data, SPEEDS) for _ in handles]).reshape(-1, self.tree.ndim)
        times = np.array([data.draw(TIMES) for _ in handles])
        self.tree.set_velocities(handles, rows, times)
        for handle, velocity, time in zip(handles, rows, times.tolist(), strict=True):
            self.told[handle] = self.told[handle]._replace(velocity=velocity, reference=time)

    @rule()
    def rebuild(self) -> None:
        self.tree.rebuild()

    @rule(data=st.data(), pace=PACES, at=TIMES, limit=st.sampled_from([1.0, 0.5, 3.0]))
    def cast(self, data: Any, pace: float, at: float, limit: float) -> None:
        origin, way, tree = self.row(data, SIDES), self.row(data, SPEEDS), self.tree
        course = Course(origin, origin, way, at, pace)
        exact, handles = self.exact(meetings, course), np.array(sorted(self.told), np.int64)
        right, times = seen(exact, handles, limit), {'at': at, 'pace': pace}
        ids = [int(handles[hit.row]) for hit in right]
        every = tree.raycast_all(origin, way, limit, **times)
        assert [hit.id for hit in every] == ids
        assert all(is_within_2_ulp(h.t, e.t) for h, e in zip(every, right, strict=True))
        hit = tree.raycast(origin, way, limit, **times)
        assert (hit.id if hit else None) == (ids[0] if ids else None)
        many = tree.raycast_many([origin] * 64, [way] * 64, limit, **times)
        assert (many.ids == (ids[0] if ids else -1)).all()

    @rule(data=st.data(), at=TIMES)
    def touch(self, data: Any, at: float) -> None:
        lo, hi = self.box(data)
        exact = self.exact(meetings, Course(lo, hi, 0 * lo, at, 0.0))
        handles = sorted(self.told)
        touched = sorted(handles[hit.row] for hit in exact)
        assert self.tree.overlap(lo, hi, at=at).tolist() == touched
        near, gaps = self.tree.nearest(np.array((lo, hi)), k=99, at=at)
        assert sorted(near.tolist()) == handles
        squares = self.exact(squared_distances, lo, hi, at)
        for handle, gap in zip(near.tolist(), gaps.tolist(), strict=True):
            square = float(squares[handles.index(handle)])
            assert gap == pytest.approx(square**0.5, rel=1e-15, abs=1e-160)

    def exact(self, ask: Any, *arguments: Any) -> Any:
        """What exact arithmetic says of the boxes in the order of their handles."""
        boxes = [self.told[handle] for handle in sorted(self.told)]
        if not boxes:
            return []
        return ask(World(*map(np.array, zip(*boxes, strict=True))), *arguments)

    @invariant()
    def the_same_rays_meet_what_is_there_now(self) -> None:
        """Again and again at the same times: what was swept for them before the last change says
        nothing any more.
        """
        if not (self.calm and self.told):
            return
        ndim, handles = self.tree.ndim, np.array(sorted(self.told), np.int64)
        origins = np.full((FAN, ndim), -3.0)
        ways = np.linspace([0.25] * ndim, [1.75, *[1.0] * (ndim - 1)], FAN)
        many = self.tree.raycast_many(
            np.tile(origins, (16, 1)), np.tile(ways, (16, 1)), 4.0, at=0.5, pace=0.25
        )
        for row, (origin, way) in enumerate(zip(origins, ways, strict=True)):
            exact = self.exact(meetings, Course(origin, origin, way, 0.5, 0.25))
            first = [int(handles[hit.row]) for hit in seen(exact, handles, 4.0)][:1]
            assert set(many.ids[row::FAN].tolist()) == set(first or [-1])

    @invariant()
    def velocities_are_kept(self) -> None:
        handles = sorted(self.told)
        rows, times = self.tree.velocities(handles)
        for handle, row, time in zip(handles, rows, times, strict=True):
            told = self.told[handle]
            assert (row == told.velocity).all()
            assert time == told.reference


TestVelocityMachine = pytest.mark.slow(VelocityMachine.TestCase)
TestVelocityMachine.settings = settings(
    max_examples=effort(60, 3000), stateful_step_count=25, suppress_health_check=list(HealthCheck)
)
