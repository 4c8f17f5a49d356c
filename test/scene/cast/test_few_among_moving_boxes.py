# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of few rays among boxes that move: the same as single ones, through what is swept."""

import numpy as np
import pytest

from bvh_ros.scene import NO_NODE, Scene, Shapes

pytestmark = pytest.mark.slow  # kernels of its own
BOXES, SECOND = 200, 10**9


def put(scene: Scene, rows: np.ndarray, rng: np.random.Generator, turned: bool = False) -> None:
    turns = rng.normal(size=(len(rows), 4)) if turned else None
    places = rng.uniform(-9, 9, (len(rows), 3))
    shapes = Shapes.boxes(places, rng.uniform(0.3, 2, (len(rows), 3)), turns)
    speeds = rng.normal(size=(len(rows), 3)) * 3
    assert not scene.update('s', [f'b{i}' for i in rows], shapes, stamp=0, velocities=speeds)


@pytest.mark.parametrize(('turned', 'radius'), [(False, 0.0), (False, 0.2), (True, 0.0)])
@pytest.mark.parametrize('bad', [np.nan, np.inf, 1.7e308])
def test_bad_ways_are_refused(bad: float, turned: bool, radius: float):
    """Where boxes are swept, as elsewhere."""
    scene, rng = Scene(), np.random.default_rng(2)
    put(scene, np.arange(BOXES), rng, turned)
    starts, goals, times = np.zeros((40, 3)), np.ones((40, 3)), {'at': 0, 'until': SECOND}
    for _ in range(20):  # as many are worth it
        scene.sweep_many(starts, goals, radius, **times)
    assert scene._held.tree.motion._wanted.sweep is not None
    goals[3, 1], starts[3, 1] = bad, -1e308
    with pytest.raises(ValueError, match='row 3'):
        scene.sweep_many(starts, goals, radius, **times)
    if not np.isfinite(bad):
        with pytest.raises(ValueError, match=r'directions .*row 3'):
            scene.raycast_many(starts, goals, 1.0, **times)


@pytest.mark.parametrize(('turned', 'radius'), [(False, 0.0), (False, 0.2), (True, 0.0)])
@pytest.mark.parametrize('count', [20, 40, 100])
def test_rows_that_tell_their_times(turned: bool, radius: float, count: int):
    """As arrays, lists, or a number and an array, near and farther away than doubles count ns."""
    scene, rng = Scene(), np.random.default_rng(count)
    put(scene, np.arange(BOXES), rng, turned)
    far = 300 * 86_400 * SECOND
    for turn in range(24):
        starts, goals = rng.uniform(-12, 12, (2, count, 3))
        at = rng.integers(0, SECOND // 2, count)
        until = rng.integers(SECOND // 2, SECOND, count)
        if turn % 4 == 1:
            at[0], until[-1] = 0, SECOND
        when = {'at': at, 'until': None if turn % 6 == 5 else until}
        if turn % 8 == 6:
            when['at'] = 0
        if turn % 8 == 7:
            when['at'] = at.tolist()
        if turn % 12 == 11:
            until[0] = far
        many = scene.sweep_many(starts, goals, radius, **when)
        last = at if when['until'] is None else until
        first = np.broadcast_to(when['at'], count)
        for i in range(count):
            times = {'at': int(first[i]), 'until': int(last[i])}
            hit = scene.raycast(starts[i], goals[i], radius, **times)
            if hit is None:
                assert (many.handles[i], many.t[i]) == (NO_NODE, np.inf)
                continue
            assert (hit.handle, hit.t) == (many.handles[i], many.t[i])
            assert hit.point.tolist() == many.points[i].tolist()
    assert scene._held.tree.motion._wanted.sweep is not None
    early = np.full(count, SECOND)
    early[-1] = -1
    with pytest.raises(ValueError, match=f'row {count - 1}'):
        scene.sweep_many(starts, goals, radius, at=np.zeros(count, np.int64), until=early)
    with pytest.raises(ValueError, match='at must be an integer'):
        scene.sweep_many(starts, goals, radius, at=np.zeros(count), until=early)
    if not radius:
        endless = scene.raycast_many(starts, goals, np.inf, at=at, until=until)
        for i in range(count):
            one = slice(i, i + 1)
            alone = scene.raycast_many(
                starts[one], goals[one], np.inf, at=int(at[i]), until=int(until[i])
            )
            assert (alone.handles[0], alone.t[0]) == (endless.handles[i], endless.t[i])
