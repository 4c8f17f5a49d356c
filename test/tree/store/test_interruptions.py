# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A change that is interrupted is done or was never begun, and the tree lives on.

A trace function raises at one bytecode after the other, in whatever the change runs of this
package: wherever a signal handler could raise, and wherever memory could be short. What kernels do
is not to be interrupted.
"""

import copy
import pickle
import random
import signal
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from tree.compiler.alone import run_alone
from tree.interrupting import InterruptError, interrupted
from tree.reference import LONG, effort, snapshot

from bvh_ros import DynamicBVH

RNG = np.random.default_rng(4)
LO = RNG.uniform(0, 20, (40, 3))
MORE = RNG.uniform(0, 20, (60, 3))
ORIGINS, WAYS = RNG.uniform(0, 20, (70, 3)), RNG.normal(size=(70, 3))


def some_tree(margin: float = 0.0) -> DynamicBVH:
    """Without room for one more box, with a wide snapshot."""
    tree = DynamicBVH(margin=margin, capacity=40)
    tree.insert_many(LO, LO + 1)
    tree.raycast_many(ORIGINS, WAYS)
    assert tree.stats()['capacity'] == 40
    assert tree.stats()['wide_snapshot']
    return tree


def handle(tree: DynamicBVH, row: int) -> int:
    return int(tree.ids()[row])


# The handles are those of a new tree: looked up beforehand, that nothing else is interrupted.
FIRST = handle(some_tree(), 3)
ALL = some_tree().ids()
OTHER = pickle.dumps(DynamicBVH.from_boxes(MORE, MORE + 2))

CHANGES: dict[str, Callable[[DynamicBVH], Any]] = {
    'insert': lambda tree: tree.insert(MORE[0], MORE[0] + 1, 6),
    'insert few': lambda tree: tree.insert_many(MORE[:5], MORE[:5] + 1),
    'insert many': lambda tree: tree.insert_many(MORE, MORE + 1),
    'remove': lambda tree: tree.remove(FIRST),
    'remove many': lambda tree: tree.remove_many(ALL[::2]),
    'move': lambda tree: tree.move(FIRST, MORE[0], MORE[0] + 1),
    'move ahead': lambda tree: tree.move(FIRST, MORE[0], MORE[0] + 1, [1, 2, 3]),
    'move few': lambda tree: tree.move_many(ALL[:1], MORE[:1], MORE[:1] + 1),
    'move many': lambda tree: tree.move_many(ALL, LO + 0.1, LO + 1.1),
    'move far': lambda tree: tree.move_many(ALL, MORE[:40], MORE[:40] + 1),
    'set masks': lambda tree: tree.set_masks(ALL[5:9], [4, 5, 6, 7]),
    'clear': lambda tree: tree.clear(),
    'rebuild': lambda tree: tree.rebuild(),
    'optimize': lambda tree: tree.optimize(),
    'set state': lambda tree: tree.__setstate__(pickle.loads(OTHER).__getstate__()),
    # No changes, but they build something or look at all of it.
    'cast': lambda tree: tree.raycast_many(ORIGINS, WAYS),
    'cast in threads': lambda tree: tree.raycast_many(ORIGINS, WAYS, threads=3),
    'ask': lambda tree: (
        tree.overlap_many(LO, LO + 1),
        tree.overlap_pairs(),
        tree.nearest_many(LO, 2),
        tree.raycast_all(ORIGINS[0], WAYS[0]),
        tree.stats(),
        pickle.dumps(tree),
    ),
}


def check(tree: DynamicBVH) -> None:
    """It is sound, its batches see what its single rays see, and it can be changed."""
    tree.validate()
    hits = tree.raycast_many(ORIGINS, WAYS).ids.tolist()
    singly = [tree.raycast(origin, way) for origin, way in zip(ORIGINS, WAYS, strict=True)]
    assert hits == [-1 if hit is None else hit.id for hit in singly]


def live_on(tree: DynamicBVH, newest: int) -> None:
    """Further changes, and a handle that nobody has had."""
    fresh = tree.insert([1, 2, 3], [4, 5, 6])
    assert fresh > newest
    tree.move(fresh, [2, 2, 3], [4, 5, 6])
    tree.insert_many(MORE[:9], MORE[:9] + 1)
    tree.remove_many(tree.ids()[::3])
    check(tree)
    assert tree.ids().tolist() == sorted(set(tree.ids().tolist()))


def copied(tree: DynamicBVH, *, wide: bool) -> DynamicBVH:
    """A tree that is the same, with or without a wide snapshot."""
    other = copy.copy(tree)
    if wide:
        other.raycast_many(ORIGINS, WAYS)
    return other


@pytest.mark.parametrize('name', CHANGES)
@pytest.mark.parametrize('margin', [0.0, 0.3])
def test_at_every_bytecode(name: str, margin: float) -> None:
    change = CHANGES[name]
    wide = name not in ('cast', 'cast in threads')
    if not wide:
        before = DynamicBVH(margin=margin, capacity=40)
        before.insert_many(LO, LO + 1)
    else:
        before = some_tree(margin)
    after = copied(before, wide=wide)
    change(after)
    old, new = snapshot(before), snapshot(after)
    step = 1 if LONG else 6 if margin == 0.0 else 15
    at, seen = 1, []
    while True:
        tree = copied(before, wide=wide)
        if not interrupted(lambda tree=tree: change(tree), at):
            break
        now = snapshot(tree)
        assert now in (old, new), at
        seen.append(now == new)
        newest = max(int(old_id) for old_id in [*before.ids(), *tree.ids()])
        if at % 5 == 0:
            check(tree)
        if at % 20 == 0:
            live_on(tree, newest)
        at += random.Random(at).randint(1, 2 * step - 1)
    # Neither is ever half way: first all are of before, then all are of afterwards.
    assert seen == sorted(seen)
    assert seen
    assert snapshot(before) == old


def test_again_and_again() -> None:
    """Changes, each interrupted several times in a row, against what must be there."""
    rng = random.Random(8)
    tree = some_tree()
    boxes = dict(zip(ALL.tolist(), LO.tolist(), strict=True))
    for _ in range(effort(150, 3000)):
        place = [rng.uniform(0, 20) for _ in range(3)]
        high = [x + 1 for x in place]
        kind = rng.choice(['insert', 'remove', 'move'])
        known = rng.choice(sorted(boxes)) if boxes else None
        if known is None or kind == 'insert':
            change = partial(tree.insert, place, high)
        elif kind == 'remove':
            change = partial(tree.remove, known)
        else:
            change = partial(tree.move, known, place, high, [0.1, 0, 0])
        for _ in range(rng.randint(1, 4)):
            if known is None or known in tree:
                interrupted(change, rng.randint(1, 250))
        ids = tree.ids().tolist()
        gone, come = set(boxes) - set(ids), set(ids) - set(boxes)
        assert gone <= {known}
        for h in gone:
            del boxes[h]
        for h in come:
            boxes[h] = place
        lo, _ = tree.boxes(ids)
        for h, low in zip(ids, lo.tolist(), strict=True):
            if h == known and low == place:
                boxes[h] = place
            assert low == boxes[h]
    check(tree)


def test_signals() -> None:
    """Handlers that raise at any time, in long changes, too."""
    rng = np.random.default_rng(6)
    count = 5000
    lo, other = rng.uniform(0, 100, (2, 4 * count, 3))
    half = count // 2  # a tree grows if only removing is interrupted

    def ring(*_: Any) -> None:
        raise InterruptError

    def changes(tree: DynamicBVH, ids: Any) -> list[Callable[[], Any]]:
        return [
            lambda: tree.move_many(ids, other[: len(ids)], other[: len(ids)] + 1),
            lambda: tree.remove_many(ids[:half]),
            lambda: tree.insert_many(lo[:half], lo[:half] + 1),
            lambda: tree.optimize(),
            lambda: tree.rebuild(),
            lambda: tree.set_masks(ids, 3),
        ]

    tree = DynamicBVH.from_boxes(lo[:count], lo[:count] + 1)
    for turn in range(6):  # kernels are loaded: numba does not bear being interrupted in that
        changes(tree, tree.ids())[turn]()
    before = signal.signal(signal.SIGALRM, ring)
    try:
        for round_ in range(effort(60, 1000)):
            ids = tree.ids()
            try:
                signal.setitimer(signal.ITIMER_REAL, float(rng.uniform(1e-5, 5e-3)))
                changes(tree, ids)[round_ % 6]()
                time.sleep(0.01)
            except InterruptError:
                pass
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0.0)
            assert len(tree) in (len(ids), len(ids) - half, len(ids) + half)
            tree.validate()
            if len(tree) > 3 * count:
                tree.remove_many(tree.ids()[count:])
        assert set(tree.masks(tree.ids()).tolist()) <= {1, 3}
    finally:
        signal.signal(signal.SIGALRM, before)


SHORT_OF_MEMORY = """
    import resource, sys
    import numpy as np
    from bvh_ros import DynamicBVH

    rng = np.random.default_rng(0)
    count, mib = 20_000, 2**20
    lo = rng.uniform(0, 1000, (count, 3))
    changes = {
        'insert': lambda t: t.insert([0, 0, 0], [1, 1, 1]),
        'few': lambda t: t.insert_many(lo[:9], lo[:9] + 1),
        'bulk': lambda t: t.insert_many(lo, lo + 1),
        'rebuild': lambda t: t.rebuild(),
        'optimize': lambda t: t.optimize(),
        'ahead': lambda t: t.move(int(t.ids()[0]), [0, 0, 0], [1, 1, 1], [1, 1, 1]),
        'move': lambda t: t.move_many(t.ids(), lo[::-1], lo[::-1] + 1),
        'remove': lambda t: t.remove_many(t.ids()[::2]),
        'cast': lambda t: t.raycast_many(lo, lo),
        'pairs': lambda t: t.overlap_pairs(),
        'save': lambda t: t.__getstate__(),
    }
    for margin in (0.0, 0.1):  # all is compiled, and loaded, before memory is short
        for change in changes.values():
            warm = DynamicBVH.from_boxes(lo[:200], lo[:200] + 1, margin=margin)
            lo, kept = lo[:200], lo
            change(warm), warm.validate(), warm.insert_many(lo, lo + 1)
            warm.raycast_many(*np.tile(lo, (2, 20, 1)))
            lo = kept

    def used():
        return int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()

    failed = 0
    for margin in (0.0, 0.1):
        for name, change in changes.items():
            for room in (0, 0.3, 1, 2.5, 6):
                tree = DynamicBVH.from_boxes(lo, lo + 1, margin=margin)
                before = tree.ids()
                resource.setrlimit(resource.RLIMIT_AS, (used() + int(room * mib), -1))
                try:
                    change(tree)
                except MemoryError:
                    failed += 1
                    done = False
                else:
                    done = True
                finally:
                    resource.setrlimit(resource.RLIMIT_AS, (-1, -1))
                tree.validate()
                if not done:
                    assert np.array_equal(tree.ids(), before), (name, room)
                tree.insert([0, 0, 0], [1, 1, 1])
                tree.insert_many(lo[:100], lo[:100] + 1)
                tree.validate()
    print('failed', failed)
"""


@pytest.mark.slow
def test_short_of_memory() -> None:
    """Limits of every size on every growth, in a process of its own, which gives all memory back
    to the system: what it had in store would not count.
    """
    limits = {'MALLOC_MMAP_THRESHOLD_': '8192', 'MALLOC_TRIM_THRESHOLD_': '0'}
    ended = run_alone(SHORT_OF_MEMORY, **limits)
    assert int(ended.stdout.split()[-1]) > 20
