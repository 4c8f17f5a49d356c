# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Updates, replacements, removals and lifetimes, step by step against a dictionary."""

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from scene.reference import changed

from bvh_ros.scene import Numbered, Scene, Shapes

SOURCES = ['camera', 'lidar']
# Given as strings or as prefix and number; 'a1' + 5 and 'a' + 15 are one name, 'a05' is another.
PLAIN = ('a0', 'a1', 'a15', 'a05', 'b', 'a', '', 'error: x', 'a-1', '7')
WITH_SLASH = ('a1/2', 'a1/3', 'a1/b/2', '/4')
texts = st.sampled_from(PLAIN + WITH_SLASH)
names = st.lists(texts, max_size=6)
numbered = st.tuples(
    st.sampled_from(['a', 'a1', 'a1/', 'a1/b/', '', 'a-', 'error: ', 'c']),
    st.lists(st.integers(-1, 20), max_size=8),
)
coordinates = st.sampled_from([0.0, 1.0, 2.5, float('nan'), 1e308])


def spelled(names):
    if isinstance(names, Numbered):
        return [f'{names.prefix}{number}' for number in names.numbers]
    return names


class Model(RuleBasedStateMachine):
    """The scene, and a dictionary: name -> (source, group, x, expires, node handle)."""

    def __init__(self):
        super().__init__()
        self.scene = Scene(max_obstacles=25)
        self.known = {}
        self.last_handle = 0
        self.newest = 0

    def apply(self, source, group, names, x, expires, whole, moving=False):
        written = spelled(names)
        x = (x * len(written))[: len(written)]
        places = np.stack([x, np.zeros(len(x)), np.zeros(len(x))], axis=1)
        shapes = changed(Shapes.boxes(np.zeros_like(places), [1.0, 1.0, 1.0]), position=places)
        arguments = (names, shapes)
        told = {'stamp': self.newest + 1, 'expires': expires}
        if moving:  # what is at 2.5 has no velocity that is one
            told['velocities'] = np.where(places == 2.5, np.nan, places / 1e300)
        if whole:
            refusals = self.scene.replace(source, group, *arguments, **told)
        else:
            refusals = self.scene.update(source, *arguments, **told)
        refused = {
            row for row, name in enumerate(written) if self.is_bad(source, name, x[row], moving)
        }
        if whole:
            gone = [
                n
                for n, o in self.known.items()
                if o[0] == source and group in ('', o[1]) and n not in written
            ]
            for name in gone:
                del self.known[name]
        last = {name: row for row, name in enumerate(written) if row not in refused}
        for row in sorted(last.values()):
            name = written[row]
            if name not in self.known and len(self.known) >= 25:
                refused.add(row)
                continue
            handle = self.known[name][4] if name in self.known else None
            self.known[name] = (source, group if whole else '', x[row], expires, handle)
        for name in (written[row] for row in sorted(last.values())):
            if name in self.known and self.known[name][4] is None:
                self.last_handle += 1
                self.known[name] = (*self.known[name][:4], self.last_handle)
        assert [refusal.row for refusal in refusals] == sorted(refused)
        assert all(refusal.name == written[refusal.row] and refusal.reason for refusal in refusals)
        if whole or last:
            self.newest += 1

    def is_bad(self, source, name, x, moving):
        return (
            np.isnan(x)
            or (moving and x == 2.5)
            or not name
            or name.startswith('error: ')
            or (name in self.known and self.known[name][0] != source)
        )

    sources = st.sampled_from(SOURCES)
    groups = st.sampled_from(['', 'g', 'h'])
    places = st.lists(coordinates, min_size=1, max_size=4)
    lives = st.sampled_from([0, 5, 9])

    @rule(source=sources, names=names, x=places, expires=lives, moving=st.booleans())
    def update_texts(self, source, names, x, expires, moving):
        self.apply(source, '', names, x, expires, False, moving)

    @rule(
        source=sources, names=numbered, x=places, expires=lives, whole=st.booleans(), group=groups
    )
    def numbered_names(self, source, names, x, expires, whole, group):
        numbers = Numbered(names[0], np.array(names[1], int))
        self.apply(source, group if whole else '', numbers, x, expires, whole)

    @rule(source=sources, names=names, x=places, group=groups, moving=st.booleans())
    def replace_texts(self, source, names, x, group, moving):
        self.apply(source, group, names, x, 0, True, moving)

    @rule(source=sources, names=st.lists(texts, max_size=4))
    def remove(self, source, names):
        gone = {n for n in names if n in self.known and self.known[n][0] == source}
        assert self.scene.remove(source, names) == len(gone)
        self.forget(gone)

    @rule(source=sources, group=groups)
    def remove_group(self, source, group):
        gone = {n for n, o in self.known.items() if o[0] == source and group in ('', o[1])}
        assert self.scene.remove_group(source, group) == len(gone)
        self.forget(gone)

    @rule(source=sources, namespace=st.sampled_from([None, 'a1', 'a1/b', 'a', '', 'b']))
    def remove_namespace(self, source, namespace):
        gone = {
            n
            for n, o in self.known.items()
            if o[0] == source
            and (namespace is None or ('/' in n and n.rpartition('/')[0] == namespace))
        }
        assert self.scene.remove_namespace(source, namespace) == len(gone)
        self.forget(gone)

    @rule(now=st.integers(0, 10))
    def expire(self, now):
        gone = {n for n, o in self.known.items() if 0 < o[3] <= now}
        assert self.scene.expire(now) == len(gone)
        self.forget(gone)

    @rule()
    def clear(self):
        assert self.scene.clear() == len(self.known)
        self.known.clear()
        self.newest = 0

    def forget(self, names):
        for name in names:
            del self.known[name]

    @invariant()
    def same(self):
        scene = self.scene
        scene.validate()
        assert len(scene) == len(self.known)
        assert dict(scene.names()) == {o[4]: n for n, o in self.known.items()}
        assert scene.newest == self.newest
        for name, (source, group, x, expires, handle) in self.known.items():
            obstacle = scene.get(name)
            assert (obstacle.source, obstacle.group) == (source, group)
            assert (obstacle.expires, obstacle.handle) == (expires, handle)
            assert obstacle.position.tolist() == [x, 0, 0]
            assert scene.name_of(handle) == name
            assert name in scene
        counts = scene.stats()['sources']
        assert all(
            counts.get(s, 0) == sum(o[0] == s for o in self.known.values()) for s in SOURCES
        )
        near = scene.overlap([2.4, 0, 0], [2.6, 0, 0])
        assert [hit.name for hit in near] == [
            n for n, o in sorted(self.known.items(), key=lambda item: item[1][4]) if o[2] == 2.5
        ]


Model.TestCase.settings = settings(max_examples=30, stateful_step_count=25)
TestModel = Model.TestCase
