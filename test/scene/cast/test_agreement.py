# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A ray or ball gets the same answer, bit for bit, in every form of the query.

Alone, in a batch, in threads, as the first of all hits; through the tree, a snapshot, a patched
one or a swept one; among all obstacles or past each of them alone. `test_certainty` and
`test_moments` check that the answer is right.
"""

from typing import NamedTuple

import numpy as np
import pytest
from scene.reference import changed, random_shapes

from bvh_ros.scene import NO_NODE, Scene, Shapes

SECOND = 10**9
NOW = 1_790_000_000 * SECOND
COUNT = 60
CORNER = np.array([400.0, 400.0, 400.0])  # of an obstacle far away, whose stamp is the epoch


class World(NamedTuple):
    """A kind of scene; lengths are multiplied by `scale`."""

    shaped: bool
    planar: bool
    moving: bool
    scale: float = 1.0
    growth: float = 0.0
    rests: float = np.inf


WORLDS = [
    pytest.param(World(shaped, planar, moving, *more), id=f'{name}-{more}')
    for shaped in (False, True)
    for planar in (False, True)
    for moving, many in (
        (False, [(), (1e-9,), (1e120,)]),
        (True, [(), (1.0, 0.4, 0.7), (1e-9, 0.0, 0.5), (1e9, 0.0, 0.5)]),
    )
    for more in many
    for name in [f'{"shapes" if shaped else "boxes"}{2 + (not planar)}{"at a time" * moving}']
]


def shapes_of(world: World, rng: np.random.Generator, count: int = COUNT) -> Shapes:
    shapes = random_shapes(rng, count)
    if not world.shaped:  # on whole numbers, so that hits tie
        places, sizes = rng.integers(-6, 7, (count, 3)), rng.integers(0, 4, (count, 3))
        shapes = Shapes.boxes(places * 1.0, sizes * 1.0)
    return changed(shapes, position=shapes.position * world.scale, size=shapes.size * world.scale)


def put(scene: Scene, world: World, rows: np.ndarray, shapes: Shapes, rng: np.random.Generator):
    told = {'stamp': NOW + np.asarray(rows) * 1000, 'categories': np.asarray(rows) % 3 + 1}
    if world.moving:
        told['velocities'] = rng.integers(-3, 4, (len(rows), 3)) * world.scale
    assert not scene.update('s', [f'o{row}' for row in rows], shapes, **told)


def scene_of(world: World) -> Scene:
    scene = Scene(planar=world.planar, uncertainty=world.growth, max_prediction=world.rests)
    if world.moving:
        far = Shapes.boxes([CORNER * world.scale], np.full(3, world.scale))
        speed = np.full((1, 3), world.scale)
        scene.update('s', ['far'], far, stamp=NOW, categories=4, velocities=speed)
    return scene


def segments(world: World, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Some are points, some go along an axis, some begin far away."""
    starts, goals = rng.integers(-18, 19, (2, count, 3)) / 2.0
    starts[2::3] += rng.uniform(-0.1, 0.1, starts[2::3].shape)
    goals[::9], goals[1::9, :2] = starts[::9], starts[1::9, :2]
    starts[7::40] *= 1e5
    return starts * world.scale, goals * world.scale


def same_hit(hits, row, hit):
    """A row of a batch is what `raycast` says."""
    if hit is None:
        assert (hits.handles[row], hits.t[row]) == (NO_NODE, np.inf)
        assert np.isnan(hits.points[row]).all()
        assert not hits.normals[row].any()
    else:
        assert (hits.handles[row], hits.t[row]) == (hit.handle, hit.t)
        assert hits.points[row].tolist() == hit.point.tolist()
        assert hits.normals[row].tolist() == hit.normal.tolist()


def same_rows(hits, others):
    for column, other in zip(hits, others, strict=True):
        np.testing.assert_array_equal(column, other)


def row_of(values, row):
    return int(values[row]) if isinstance(values, np.ndarray) else values


def times_of(world: World, rng: np.random.Generator, count: int) -> dict[str, object]:
    if not world.moving:
        return {}
    at = NOW + int(rng.integers(0, SECOND))
    choices = {'at': at}, {'at': at, 'until': at + SECOND}
    rows = NOW + rng.integers(0, SECOND, count)
    return [*choices, {'at': rows}, {'at': rows, 'until': rows + SECOND}][rng.integers(4)]


def check(scene: Scene, world: World, rng: np.random.Generator, count: int) -> int:
    starts, goals = segments(world, rng, count)
    radii = np.where(np.arange(count) % 3, 0.0, 0.3) * world.scale
    when, skip = times_of(world, rng, count), bool(rng.integers(2))
    mask, found = int(rng.choice([0xFFFFFFFF, 1, 2])), 0
    for radius in (0.0, 0.3 * world.scale, radii):
        hits = scene.sweep_many(starts, goals, radius, mask, skip, **when)
        same_rows(hits, scene.sweep_many(starts, goals, radius, mask, skip, 2, **when))
        given = goals - starts, 1.0, mask, skip, 1, radius
        if not np.any(np.isinf(goals - starts)):
            same_rows(hits, scene.raycast_many(starts, *given, **when))
        for row in range(0, count, 1 + count // 20):
            times = {name: row_of(values, row) for name, values in when.items()}
            one = float(np.broadcast_to(radius, count)[row])
            asked = starts[row], goals[row], one, mask, skip
            hit = scene.raycast(*asked, **times)
            same_hit(hits, row, hit)
            every = scene.raycast_all(*asked, **times)
            assert [h.t for h in every] == sorted(h.t for h in every)
            assert (hit is None) == (not every)
            if one == 0.0:  # of a ball, it counts what it may touch
                assert len(scene.raycast_all(*asked, len(every), **times)) == len(every)
            if hit is not None:
                assert (hit.handle, hit.t) == (every[0].handle, every[0].t)
                assert hit.point.tolist() == every[0].point.tolist()
                found += 1
            if skip:
                inside = {h.name for h in scene.raycast_all(*asked[:4], **times) if h.t == 0.0}
                assert not {h.name for h in every if h.t == 0.0 and not h.normal.any()} & inside
    return found


@pytest.mark.slow
@pytest.mark.parametrize('world', WORLDS)
def test_every_way_to_ask_gives_the_same_answer(world: World):
    rng, found = np.random.default_rng([COUNT, *map(int, world[:3])]), 0
    scene, rows = scene_of(world), np.arange(COUNT)
    found += check(scene, world, rng, 2)  # of nothing, or an obstacle far away
    put(scene, world, rows, shapes_of(world, rng), rng)
    for count in (1, 20, 90, 400, 20):  # the last ones through a snapshot
        found += check(scene, world, rng, count)
    few = rng.choice(rows, 5, replace=False)
    put(scene, world, few, shapes_of(world, rng, 5), rng)
    found += check(scene, world, rng, 60)  # which is patched
    scene.remove('s', [f'o{row}' for row in rows[:9]])
    found += check(scene, world, rng, 60)
    assert found > 20


@pytest.mark.slow
@pytest.mark.parametrize('world', WORLDS)
def test_obstacles_do_not_hide_each_other(world: World):
    """All hits are those of scenes with one obstacle each: none is overlooked."""
    rng, count, met = np.random.default_rng(7), 24, 0
    shapes, rows = shapes_of(world, rng, count), np.arange(count)
    scene = scene_of(world)
    put(scene, world, rows, shapes, np.random.default_rng(1))
    alone = []
    for row in rows:
        one, speeds = scene_of(world), np.random.default_rng(1)
        put(one, world, rows, shapes, speeds)
        one.remove('s', [f'o{other}' for other in rows if other != row])
        alone.append(one)
    starts, goals = segments(world, rng, 60)
    for start, goal in zip(starts, goals, strict=True):
        radius, when = float(rng.choice([0.0, 0.3])) * world.scale, times_of(world, rng, 0)
        when = {name: at for name, at in when.items() if isinstance(at, int)}
        hits = scene.raycast_all(start, goal, radius, **when)
        each = [hit for one in alone for hit in one.raycast_all(start, goal, radius, **when)]
        assert {hit.name for hit in hits} == {hit.name for hit in each}
        by_name = {hit.name: hit for hit in each}
        for hit in hits:
            other = by_name[hit.name]
            assert hit.t == pytest.approx(other.t, rel=1e-12)  # it never falls along all hits
            if hit.t == other.t:
                assert hit.point.tolist() == other.point.tolist()
                assert hit.normal.tolist() == other.normal.tolist()
        met += len(hits)
    assert met > 5
