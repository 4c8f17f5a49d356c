# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Between the slices of updates anything may be asked, told, removed or cleared.

The model is a box a name, and shadows: where it stood before the update moved it. While it ends
they go, and so do those that a replacement found and did not name; who of them is there is asked.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene.inside import store_of
from tree.reference import effort

from bvh_ros.scene import NodeScene, Numbered, Part, Shapes

NAMES, PLACES, SLICE = 10, 14, 3
HALF = 0.45


@pytest.fixture(autouse=True)
def small_slices(set_slices):
    set_slices(4, SLICE)


@dataclass(eq=False)
class Running:
    """An update in slices, as the model sees it."""

    source: str
    rows: list[tuple[int, int]]
    whole: bool
    work: Iterator[None]
    found: set[str] | None = None
    """What a replacement found when it began."""
    named: set[str] = field(default_factory=set)


class Model:
    """A scene beside what must be in it."""

    def __init__(self, planar, margin):
        self.scene = NodeScene(planar=planar, margin=margin)
        self.places, self.source, self.expires = {}, {}, {}
        self.shadows = []  # (name, place, expires, Running)
        self.running = []

    # ---- changes

    def part(self, source, rows, expires=0):
        position = np.zeros((len(rows), 3))
        position[:, 0] = [place for _, place in rows]
        shapes = Shapes.boxes(position, [2 * HALF] * 3)
        return Part(
            Numbered(f'{source}#', np.array([n for n, _ in rows], int)), shapes, 1, expires
        )

    def put(self, source, rows, expires, running=None):
        for n, place in rows:
            name = f'{source}#{n}'
            if running and name in self.places and self.places[name] != place:
                old = self.places[name], self.expires[name]
                self.shadows.append((name, *old, running))
            self.places[name], self.source[name], self.expires[name] = place, source, expires
            if running:
                running.named.add(name)

    def update(self, source, rows, expires):
        part = self.part(source, rows, expires)
        assert self.scene.update(source, *part[:2], stamp=1, expires=expires) == []
        self.put(source, rows, expires)

    def replace(self, source, rows):
        part = self.part(source, rows)
        assert self.scene.replace(source, '', *part[:2], stamp=1) == []
        named = {f'{source}#{n}' for n, _ in rows}
        self.forget({name for name in self.places if self.source[name] == source} - named)
        # It says all that there is.
        self.shadows = [one for one in self.shadows if self.source[one[0]] != source]
        self.put(source, rows, 0)

    def begin(self, source, rows, whole):
        part = self.part(source, rows)
        work = self.scene.in_slices(source, '', len(rows), part.cut, whole=whole)
        self.running.append(Running(source, rows, whole, work))

    def step(self, one):
        if one.found is None:
            mine = {name for name in self.places if self.source[name] == one.source}
            one.found = mine if one.whole else set()
        rows, one.rows = one.rows[:SLICE], one.rows[SLICE:]
        ended = next(one.work, 'ended') == 'ended'
        self.put(one.source, rows, 0, one)
        if not rows or ended:  # it is about to end
            leaving = one.found - one.named
            self.forget({name for name in leaving if name not in self.scene})
            self.shadows = [x for x in self.shadows if x[3] is not one or self.stands(x)]
        if ended:
            self.end(one)
            assert not leaving & set(self.places)

    def stands(self, shadow):
        """Whether a shadow is still there; its obstacle may be back where it was."""
        held = store_of(self.scene)
        slots = np.flatnonzero(held.columns.shadow).tolist()
        places = held.columns.geometry['position'][:, 0].tolist()
        return shadow[:2] in {(held.registry.name(slot), places[slot]) for slot in slots}

    def end(self, one):
        one.work.close()
        self.running.remove(one)
        self.shadows = [shadow for shadow in self.shadows if shadow[3] is not one]

    def remove(self, names):
        assert self.scene.remove('s', Numbered('s#', np.array(names, int))) == len(
            self.forget({f's#{n}' for n in names} & set(self.places))
        )

    def forget(self, names):
        for name in names:
            del self.places[name], self.source[name], self.expires[name]
            for one in self.running:
                (one.found or set()).discard(name)
                one.named.discard(name)
        self.shadows = [shadow for shadow in self.shadows if shadow[0] not in names]
        return names

    def expire(self, now):
        self.shadows = [shadow for shadow in self.shadows if not 0 < shadow[2] <= now]
        due = {name for name, when in self.expires.items() if 0 < when <= now}
        assert self.scene.expire(now) == len(self.forget(due))

    def clear(self):
        assert self.scene.clear() == len(self.places)
        self.forget(set(self.places))

    # ---- questions

    def check(self):
        scene = self.scene
        scene.validate()
        boxes = [*self.places.items(), *((name, place) for name, place, *_ in self.shadows)]
        assert len(scene) == len(self.places)
        assert {name for _, name in scene.names()} == set(self.places)
        stands = {name: sorted({p for n, p in boxes if n == name}) for name in self.places}

        def names(hits):
            found = [hit.name for hit in hits]
            assert len(set(found)) == len(found)
            return set(found)

        for place in range(PLACES):
            here = {name for name, places in stands.items() if place in places}
            assert names(scene.overlap([place, 0, 0], [place, 0, 0])) == here
        along = scene.raycast_all([-1, 0, 0], [PLACES, 0, 0])
        assert names(along) == set(stands)
        for hit in along:
            assert hit.t * (PLACES + 1) - 1 == pytest.approx(stands[hit.name][0] - HALF)
        first = scene.raycast([-1, 0, 0], [PLACES, 0, 0])
        assert (first and first.handle) == (along[0].handle if along else None)
        near = scene.nearest([3.3, 0, 0], 4)
        gaps = sorted(min(max(abs(p - 3.3) - HALF, 0) for p in stands[n]) for n in stands)[:4]
        assert [hit.t for hit in near] == pytest.approx(gaps)
        names(near)
        pairs = {tuple(sorted(pair)) for pair in scene.overlap_pairs()}
        assert len(pairs) == len(scene.overlap_pairs())
        assert pairs == {
            (a, b) for a in stands for b in stands if a < b and set(stands[a]) & set(stands[b])
        }
        for name in list(stands)[::3]:
            others = [p for other in stands if other != name for p in stands[other]]
            found = scene.clearance(name)
            if others:
                gap = min(max(abs(p - q) - 2 * HALF, 0) for p in others for q in stands[name])
                assert found.name != name
                assert found.distance == pytest.approx(gap)
            else:
                assert found is None


def rows(least=1):
    numbers = st.lists(st.integers(0, NAMES - 1), min_size=least, max_size=NAMES, unique=True)
    return numbers.flatmap(
        lambda ns: st.lists(st.integers(0, PLACES - 1), min_size=len(ns), max_size=len(ns)).map(
            lambda places: list(zip(ns, places, strict=True))
        )
    )


SOURCES = st.sampled_from('sst')
STEPS = st.one_of(
    st.tuples(st.just('step'), st.integers(0, 2)),
    st.tuples(st.just('step'), st.integers(0, 2)),
    st.tuples(st.just('begin'), SOURCES, rows(4), st.booleans()),
    st.tuples(st.just('update'), SOURCES, rows(), st.sampled_from([0, 0, 5, 9])),
    st.tuples(st.just('replace'), SOURCES, rows()),
    st.tuples(st.just('remove'), st.lists(st.integers(0, NAMES - 1), max_size=4)),
    st.tuples(st.just('expire'), st.integers(1, 9)),
    st.tuples(st.just('close'), st.integers(0, 2)),
    st.just(('clear',)),
)


ALL = st.lists(st.integers(0, PLACES - 1), min_size=NAMES, max_size=NAMES).map(
    lambda places: list(enumerate(places))
)


@settings(max_examples=effort(60, 3000))
@given(
    *(st.booleans(), st.sampled_from([0.0, 0.2]), ALL, ALL, st.booleans()),
    st.lists(STEPS, min_size=4, max_size=16),
)
def test_whatever_happens_between_slices(planar, margin, there, moved, whole, steps):
    model = Model(planar, margin)
    model.update('s', there, 5)
    for kind, *what in [('begin', 's', moved, whole), ('step', 0), *steps]:
        if kind in ('step', 'close'):
            if model.running:
                one = model.running[what[0] % len(model.running)]
                model.step(one) if kind == 'step' else model.end(one)
        elif kind != 'begin' or len(model.running) < 3:
            getattr(model, kind)(*what)
        model.check()
    for one in list(model.running):
        while one in model.running:
            model.step(one)
            model.check()
    assert store_of(model.scene).columns.shadows == 0
