# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A question that is asked in the middle of another one, as a signal handler does, changes no
answer: what is kept from one to the next is nobody else's meanwhile.
"""

import numpy as np
import pytest
from scene.reference import scene_of
from tree.interrupting import at_each_bytecode
from tree.reference import effort

from bvh_ros.scene import Shapes

HALF_A_SECOND = 500_000_000
QUESTIONS = {
    'overlap': lambda scene, at, x: scene.overlap(x - 1, x + 1, at=at),
    'overlap_shape': lambda scene, at, x: scene.overlap_shape(
        Shapes.boxes(x[None], np.ones((1, 3))), at=at
    ),
    'overlap_many': lambda scene, at, x: scene.overlap_many(x[None], (2, 2, 2), want='all', at=at),
    'nearest': lambda scene, at, x: scene.nearest(x, k=3, at=at),
    'nearest_many': lambda scene, at, x: scene.nearest_many(x[None], k=3, at=at),
    'clearance': lambda scene, at, x: scene.clearance(f'{int(x[0])}', at=at),
    'raycast': lambda scene, at, x: scene.raycast(x, x + 5, at=at),
    'swept ball': lambda scene, at, x: scene.raycast(x, x + 5, 0.25, at=at),
    'all of a swept ball': lambda scene, at, x: scene.raycast_all(x, x + 5, 0.25, at=at),
    'sweep_many': lambda scene, at, x: scene.sweep_many(x[None], x[None] + 5, 0.25, at=at),
}


def told(answer):
    """An answer that can be compared."""
    if isinstance(answer, (tuple, list)):
        return [told(part) for part in answer]
    return answer.tobytes() if isinstance(answer, np.ndarray) else answer


def asked_within(outer, inner):
    """What `outer` says, and how often `inner` was asked meanwhile: at each bytecode."""
    count = 0

    def ask(_):
        nonlocal count
        count += 1
        if count % effort(3, 1) == 0:
            inner()  # nothing is traced within a trace function

    with at_each_bytecode(('scene',), ask):
        return outer(), count


@pytest.mark.parametrize('at', [None, HALF_A_SECOND])
@pytest.mark.parametrize('kind', QUESTIONS)
def test_a_question_within_another(kind, at):
    rng = np.random.default_rng(8)
    boxes = Shapes.boxes(rng.uniform(0, 9, (200, 3)), rng.uniform(1, 2, (200, 3)))
    names = [str(i) for i in range(200)]
    scene = scene_of(boxes, names=names, stamp=0, velocities=rng.normal(size=(200, 3)))

    def ask(x):
        return told(QUESTIONS[kind](scene, at, np.full(3, x)))

    outer, inner = ask(2.0), ask(6.0)
    assert outer != inner
    answer, count = asked_within(lambda: ask(2.0), lambda: ask(6.0))
    assert answer == outer
    assert count > 9
