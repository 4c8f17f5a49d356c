# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A change of a scene that is interrupted is done, or not begun, or every later call says so until
the scene is cleared. Nothing that is occupied looks free.
"""

import signal
import time

import numpy as np
import pytest
from scene.inside import store_of
from tree.interrupting import InterruptError, interrupted
from tree.reference import effort

from bvh_ros.scene import NodeScene, Numbered, Part, ShapeKind, Shapes

COUNT = 12
RNG = np.random.default_rng(3)
PLACES, OTHERS = RNG.uniform(0, 20, (2, COUNT, 3))
ROOMS = 'scene', 'tree'


def rows(positions, numbers):
    """Boxes, turned boxes and balls."""
    kinds = np.resize([ShapeKind.BOX, ShapeKind.BOX, ShapeKind.SPHERE], len(positions))
    turns = np.resize([[0.0, 0, 0, 1], [0.1, 0.3, 0.3, 0.9]], (len(positions), 4))
    shapes = Shapes(kinds.astype(np.uint8), positions, turns, np.ones((len(positions), 3)))
    return Numbered('c#', np.array(numbers)), shapes


def some_scene(planar=False):
    scene = NodeScene(planar=planar)
    scene.update('s', *rows(PLACES, range(COUNT)), stamp=1, expires=np.arange(COUNT) * 10)
    scene.update('t', ['a', 'b'], Shapes.boxes(PLACES[:2], [2, 2, 2]), stamp=2)
    return scene


PART = Part(*rows(OTHERS, range(6, 6 + COUNT)), 3)
CHANGES = {
    'add': lambda scene: scene.update('s', *rows(OTHERS, range(COUNT, 2 * COUNT)), stamp=3),
    'add one': lambda scene: scene.update('u', *rows(OTHERS[:1], [99]), stamp=3),
    'move': lambda scene: scene.update('s', *rows(OTHERS, range(COUNT)), stamp=3),
    'move one': lambda scene: scene.update('s', *rows(OTHERS[:1], [4]), stamp=3, categories=6),
    'replace': lambda scene: scene.replace('s', 'g', *rows(OTHERS, range(6, 18)), stamp=3),
    'replace all': lambda scene: scene.replace('s', '', *rows(OTHERS, range(6, 18)), stamp=3),
    'remove': lambda scene: scene.remove('s', Numbered('c#', np.arange(5))),
    'remove group': lambda scene: scene.remove_group('s', ''),
    'expire': lambda scene: scene.expire(50),
    'shift': lambda scene: scene.shift_expiries(1000),
    'clear': lambda scene: scene.clear(),
    'rebuild': lambda scene: scene.rebuild(),
}
QUESTIONS = [
    lambda scene: scene.raycast([0, 0, 0], [9, 9, 9]),
    lambda scene: scene.raycast_all([0, 0, 0], [9, 9, 9], 0.5),
    lambda scene: scene.raycast_many([[0, 0, 0]], [[9, 9, 9]]),
    lambda scene: scene.overlap([0, 0, 0], [9, 9, 9]),
    lambda scene: scene.overlap_shape(Shapes.boxes([[0, 0, 0]], [1, 1, 1])),
    lambda scene: scene.overlap_pairs(),
    lambda scene: scene.nearest([0, 0, 0]),
    lambda scene: scene.clearance('a'),
    lambda scene: 'a' in scene,
    lambda scene: scene.get('a'),
    lambda scene: scene.names(),
    lambda scene: scene.stats(),
    lambda scene: scene.validate(),
    lambda scene: next(scene.in_slices('s', '', 12, PART.cut, whole=True)),
    *(change for name, change in CHANGES.items() if name != 'clear'),
]


def state(scene):
    """All that can be asked, in the order of node handles, but for these numbers themselves."""
    scene.validate()
    known = [scene.get(name) for _, name in scene.names()]
    hits = scene.overlap([-1, -1, -1], [30, 30, 30])
    assert {hit.name for hit in hits} == {one.name for one in known}
    return (
        [(one.name, one.position.tolist(), one.stamp, one.expires, one.group) for one in known],
        [scene.count(mask) for mask in (1, 2, 4)],
        sorted(map(sorted, scene.overlap_pairs())),
        [(hit.name, hit.t) for hit in scene.raycast_all([0, 0, 0], [20, 20, 20], 2.0)],
        (scene.newest, scene.stats()['sources'].get('s'), scene.any_shaped),
    )


def check_refusal(scene):
    """Whatever is asked or told is refused in words, until the scene is cleared."""
    for ask in QUESTIONS:
        with pytest.raises(RuntimeError, match='interrupted'):
            ask(scene)
    scene.clear()
    assert not scene.interrupted
    assert state(scene)[0] == []
    scene.update('s', *rows(PLACES, range(COUNT)), stamp=5)
    assert len(state(scene)[0]) == COUNT


# What a plane changes is in kernels, which are not interrupted.
@pytest.mark.parametrize('planar', [False, pytest.param(True, marks=pytest.mark.slow)])
def test_at_every_bytecode(planar):
    old = state(some_scene(planar))
    for name, change in CHANGES.items():
        after = some_scene(planar)
        change(after)
        new = state(after)
        outcomes = {'old': 0, 'new': 0, 'refused': 0}
        at, step = 1, effort(23, 3)
        while True:
            scene = some_scene(planar)
            error = (InterruptError, MemoryError)[at % 2]
            if not interrupted(lambda scene=scene: change(scene), at, ROOMS, error):  # noqa: B023
                break
            if scene.interrupted:
                outcomes['refused'] += 1
                if outcomes['refused'] % 5 == 1:
                    check_refusal(scene)
            else:
                now = state(scene)
                assert now in (old, new), (name, at)
                outcomes['new' if now == new else 'old'] += 1
            at += step
        if new != old:
            assert name == 'clear' or outcomes['old'] > 0, (name, outcomes)
            assert outcomes['refused'] > 0, (name, outcomes)


def test_clearing_again_and_again():
    """Also clearing may be interrupted; the next one begins anew."""
    for at in range(1, 400, effort(7, 1)):
        scene = some_scene()
        interrupted(lambda scene=scene: CHANGES['move'](scene), 2000, ROOMS)
        interrupted(scene.clear, at, ROOMS)
        interrupted(scene.clear, at // 2 + 1, ROOMS)
        scene.clear()
        assert len(scene) == 0
        scene.update('s', *rows(PLACES, range(COUNT)), stamp=5)
        assert len(state(scene)[0]) == COUNT


def test_slices(set_slices):
    """What is interrupted in slices is half applied: the world holds what either message says.
    Nothing stays behind for ever.
    """
    set_slices(2, 3)
    at, refused = 1, 0
    while True:
        scene = some_scene()
        work = scene.in_slices('s', '', COUNT, PART.cut, whole=True)
        if not interrupted(lambda work=work: list(work), at, ROOMS):
            break
        del work
        if scene.interrupted:
            refused += 1
            check_refusal(scene)
        else:
            scene.validate()
            for n in range(6, COUNT):  # they are in both messages
                one = scene.get(f'c#{n}')
                assert one.position.tolist() in (PLACES[n].tolist(), OTHERS[n - 6].tolist())
                assert one.name in {hit.name for hit in scene.overlap(*[one.position] * 2)}
            scene.update('s', *rows(PLACES, range(COUNT)), stamp=4)
            scene.remove('s', Numbered('c#', np.arange(COUNT, 30)))
            assert len(scene.overlap([-1, -1, -1], [30, 30, 30])) == COUNT + 2
            assert len(store_of(scene).tree) == COUNT + 2
        at += effort(61, 5)
    assert refused > 5


def test_signals():
    """Handlers that raise at any time, in long changes; who asks in one is refused or right."""
    count = 20_000
    lo, other = np.random.default_rng(6).uniform(0, 300, (2, count, 3))
    numbers = Numbered('n#', np.arange(count))
    boxes, moved = Shapes.boxes(lo, [1, 1, 1]), Shapes.boxes(other, [1, 1, 1])

    def slices(scene):
        list(scene.in_slices('s', '', count, Part(numbers, moved, 2).cut, whole=True))

    changes = [
        lambda scene: scene.update('s', numbers, moved, stamp=2),
        lambda scene: scene.replace('s', '', Numbered('m#', np.arange(count)), moved, stamp=2),
        lambda scene: scene.remove('s', Numbered('n#', np.arange(0, count, 2))),
        lambda scene: scene.update('t', Numbered('m#', np.arange(count)), moved, stamp=2),
        slices,
        lambda scene: scene.clear(),
    ]
    scene, asked, refused = NodeScene(), 0, 0
    for change in changes:  # kernels are loaded: numba does not bear being interrupted in that
        scene.clear()
        scene.update('s', numbers, boxes, stamp=1)
        change(scene)
        scene.overlap(lo[0], lo[0])

    def ring(*_):
        nonlocal asked
        asked += 1
        try:
            scene.overlap(lo[0], lo[0])
        except RuntimeError as error:
            assert 'is under way' in str(error) or 'being changed' in str(error)  # noqa: PT017
        raise InterruptError

    rng, before = np.random.default_rng(8), signal.signal(signal.SIGALRM, ring)
    try:
        for turn in range(effort(40, 1000)):
            scene.clear()
            scene.update('s', numbers, boxes, stamp=1)
            try:
                signal.setitimer(signal.ITIMER_REAL, float(rng.uniform(1e-5, 4e-2)))
                changes[turn % len(changes)](scene)
                time.sleep(0.05)
            except InterruptError:
                pass
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0.0)
            if scene.interrupted:
                refused += 1
            else:
                scene.validate()
                assert len(scene) in (count, 2 * count, count // 2, 0)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert asked > effort(30, 30)
