# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Many threads may ask one tree while none changes it, also when the first question builds
something lazily.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from typing import Any

import numpy as np
import pytest
from tree.compiler.alone import run_alone

from bvh_ros import DynamicBVH

THREADS = 8
RNG = np.random.default_rng(11)
ORIGINS = RNG.uniform(0, 50, (300, 3))
WAYS = np.round(RNG.normal(size=(300, 3)) * 2)

QUESTIONS: list[Callable[[DynamicBVH], Any]] = [
    lambda tree: [column.tolist() for column in tree.raycast_many(ORIGINS, WAYS)],
    lambda tree: [column.tolist() for column in tree.raycast_many(ORIGINS, WAYS, threads=3)],
    lambda tree: tree.occluded_many(ORIGINS, WAYS).tolist(),
    lambda tree: [column.tolist() for column in tree.raycast_all_many(ORIGINS, WAYS)],
    lambda tree: [
        tree.raycast(o, w).id if tree.occluded(o, w) else None
        for o, w in zip(ORIGINS, WAYS, strict=True)
    ],
    lambda tree: [column.tolist() for column in tree.overlap_many(ORIGINS, ORIGINS + 3)],
    lambda tree: tree.overlap_pairs().tolist(),
    lambda tree: [column.tolist() for column in tree.nearest_many(ORIGINS, 4)],
    lambda tree: [column.tolist() for column in tree.boxes(tree.ids())],
    lambda tree: (tree.cost(), tree.height, len(tree), tree.stats()['boxes'], tree.validate()),
]


@pytest.mark.parametrize('margin', [0.0, 0.2])
def test_all_questions_at_once_after_each_change(margin: float) -> None:
    lo = np.random.default_rng(1).uniform(0, 50, (600, 3))
    tree, alone = (DynamicBVH(margin=margin) for _ in range(2))
    for each in (tree, alone):
        each.insert_many(lo, lo + 1)
    changes: list[Callable[[DynamicBVH], Any]] = [
        lambda t: t.move_many(t.ids(), lo + 5, lo + 6),
        lambda t: t.remove(int(t.ids()[5])),
        lambda t: t.move(int(t.ids()[9]), [0, 0, 0], [50, 50, 1]),
        lambda t: t.set_masks(t.ids()[:300], 2),
        lambda t: t.insert([20, 20, 20], [30, 30, 30]),
        lambda t: t.rebuild(),
        lambda t: t.clear(),
    ]
    with ThreadPoolExecutor(THREADS) as pool:
        for change in changes:
            change(tree)
            change(alone)
            expected = [question(alone) for question in QUESTIONS]
            for first in range(0, len(QUESTIONS), 3):
                assert ask(pool, tree, first) == [
                    expected[(first + k) % len(QUESTIONS)] for k in range(THREADS)
                ]


def ask(pool: ThreadPoolExecutor, tree: DynamicBVH, first: int) -> list[Any]:
    """Every thread waits for the others, then asks its own question."""
    barrier = Barrier(THREADS)

    def one(k: int) -> Any:
        barrier.wait()
        return QUESTIONS[(first + k) % len(QUESTIONS)](tree)

    return list(pool.map(one, range(THREADS)))


def test_a_handler_that_interrupts_the_asking_for_help() -> None:
    """It asks itself, with threads: the pool's locks are held by whom it interrupts."""
    run_alone(HANDLER)


HANDLER = """
    import faulthandler, signal
    from concurrent.futures import ThreadPoolExecutor
    import numpy as np
    from bvh_ros import DynamicBVH

    faulthandler.dump_traceback_later(2000, exit=True)
    lo = np.random.default_rng(0).uniform(0, 50, (400, 3))
    tree = DynamicBVH.from_boxes(lo, lo + 1)
    ask = lambda: tree.raycast_many(lo, lo[::-1], threads=3).ids.tolist()
    expected, answers = ask(), []
    signal.signal(signal.SIGALRM, lambda *_: answers.append(ask()))
    inside = ThreadPoolExecutor._adjust_thread_count

    def interrupted(pool):
        signal.raise_signal(signal.SIGALRM)
        inside(pool)

    ThreadPoolExecutor._adjust_thread_count = interrupted
    assert ask() == expected
    assert len(answers) == 2 and all(answer == expected for answer in answers)
    ThreadPoolExecutor._adjust_thread_count = inside
    assert ask() == expected
"""


def test_no_help_to_be_had(monkeypatch: pytest.MonkeyPatch) -> None:
    """No more threads can be started, or the process is ending: who asks does the work alone."""
    lo = np.random.default_rng(0).uniform(0, 50, (400, 3))
    tree = DynamicBVH.from_boxes(lo, lo + 1)
    expected = tree.raycast_many(lo, lo[::-1]).ids.tolist()

    def none(*_: Any) -> None:
        raise RuntimeError("can't start new thread")

    for where in ('_adjust_thread_count', 'submit'):
        with monkeypatch.context() as patch:
            patch.setattr(ThreadPoolExecutor, where, none)
            assert tree.raycast_many(lo, lo[::-1], threads=3).ids.tolist() == expected
