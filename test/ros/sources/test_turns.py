# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Large messages take turns; what takes longer than a turn runs in a helper thread."""

import itertools
import threading

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from ros.messages import cloud, marker
from ros.sources.generators import ended
from visualization_msgs.msg import MarkerArray

from bvh_ros.scene import NodeScene, Numbered, Scene, Shapes, slicing

PARAMETERS = {
    'sources': ['given', 'followed', 'markers'],
    'given.type': 'PointCloud2',
    'given.topic': '/given',
    'given.predict': 'given',
    'followed.type': 'PointCloud2',
    'followed.topic': '/followed',
    'followed.predict': 'constant_velocity',
    'footprint': [0.5],
}
BELOW = (-2.0, -2.0, -2.0), (-1.0, -1.0, -1.0)


@pytest.fixture
def server(configure, monkeypatch):
    """A server that counts as large what has some hundred rows."""
    monkeypatch.setattr(slicing, 'AT_ONCE', 300)
    return configure(PARAMETERS)


@pytest.fixture
def rows_in_main(monkeypatch):
    """How many rows each turn of this thread applies."""
    rows, here = [], threading.current_thread()
    move = slicing.Updates.apply

    def apply(self, source, group, part, **given):
        if threading.current_thread() is here:
            rows.append(len(part.shapes.kind))
        return move(self, source, group, part, **given)

    monkeypatch.setattr(slicing.Updates, 'apply', apply)
    return rows


def lattice(count, height):
    at = np.arange(float(count))
    columns = {'x': at % 50, 'y': at // 50, 'z': np.full(count, float(height))}
    return cloud(columns | dict.fromkeys(('vx', 'vy', 'vz'), np.zeros(count)))


def applying(server, name, count, height=0):
    """The steps of applying a cloud."""
    return source(server, name).applying([serialize_message(lattice(count, height))], 1)


def source(server, name):
    return next(one for one in server.world.sources if one.name == name)


def is_there(scene, height):
    return scene.raycast((0, 0, height + 1), (0, 0, height - 1)) is not None


@pytest.mark.parametrize('name', ['given', 'followed'])
def test_a_large_cloud_is_applied_by_a_helper_and_the_old_one_is_visible(
    server, rows_in_main, name
):
    world = server.world
    for height in (0, 10, 20):
        before = len(world.scene)
        pauses = 0
        for _ in applying(server, name, 1000, height):
            pauses += 1
            assert len(world.scene) == before
            assert is_there(world.scene, height - 10) == (height > 0)
            assert not is_there(world.scene, height)
            assert world.scene.raycast(*BELOW) is None
        assert pauses > 0
        assert world.changes.owner is None
        assert is_there(world.scene, height)
        assert not is_there(world.scene, height - 10)
    assert rows_in_main == []
    world.scene.validate()


def test_a_few_rows_of_a_large_scene_are_applied_in_small_slices(server, rows_in_main):
    ended(applying(server, 'given', 9000))
    assert rows_in_main == []
    markers = [marker(k, (k, 0, 50)) for k in range(1000)]
    message = serialize_message(MarkerArray(markers=markers))
    pauses = sum(1 for _ in source(server, 'markers').applying([message], 2))
    assert pauses >= 1000 // slicing.SLICE
    assert sum(rows_in_main) == 1000
    assert max(rows_in_main) <= slicing.SLICE
    assert len(server.world.scene) == 10_000


def test_other_sources_wait_for_a_large_change_and_then_apply_theirs(server):
    world, large, small = server.world, source(server, 'given'), source(server, 'markers')
    work = applying(server, 'given', 1000)
    next(work)
    assert world.changes.owner is large
    small.receive([serialize_message(MarkerArray(markers=[marker(0, (0, 0, 50))]))])
    assert len(world.scene) == 0
    for _ in work:
        assert not is_there(world.scene, 50)
    assert (len(world.scene), world.changes.owner) == (1000, None)
    small.finish()
    assert is_there(world.scene, 50)


def test_a_newer_cloud_replaces_those_that_wait(server):
    of = source(server, 'given')
    for height in (0, 10, 20, 30):
        of.receive([serialize_message(lattice(1000, height))])
    of.finish()
    assert [is_there(server.world.scene, height) for height in (0, 10, 20, 30)] == [False] * 3 + [
        True
    ]


def test_a_change_whose_message_is_dropped_ends_before_the_next(server):
    work = applying(server, 'given', 1000)
    next(work)
    assert server.world.changes.owner is source(server, 'given')
    work.close()
    assert server.world.changes.owner is None
    assert not server.world.scene.interrupted
    server.world.scene.validate()


def test_nothing_is_removed_while_the_scene_is_copied(server):
    world = server.world
    scene = world.scene
    source(server, 'markers').apply_now(
        serialize_message(MarkerArray(markers=[marker(0, lifetime=1)])), 0
    )
    work = applying(server, 'given', 1000, 9)
    next(work)
    if world.changes.copying:
        assert world.expire(10**12) is False
        assert len(scene) == 1
    ended(work)
    world.expire(10**12)
    assert len(world.scene) == 1000


class Clock:
    """A clock that a piece sets forward as its rows take."""

    def __init__(self):
        self.now = 0.0

    def perf_counter(self):
        return self.now


@pytest.mark.parametrize('row', [1e-7, 1e-6, 1e-5, 1e-4, 1e-3])
def test_a_piece_of_a_batch_takes_a_turn_whatever_a_row_takes(monkeypatch, row):
    from bvh_ros.ros.parts import batches

    clock, pieces = Clock(), []
    monkeypatch.setattr(batches.time, 'perf_counter', clock.perf_counter)

    def answer(piece):
        pieces.append(piece)
        clock.now += row * (piece.stop - piece.start)

    pace = batches.Pace()
    ended(pace.answer('rays', 50_000, answer))
    assert [pieces[0].start, pieces[-1].stop] == [0, 50_000]
    assert all(a.stop == b.start for a, b in itertools.pairwise(pieces))
    sizes = [piece.stop - piece.start for piece in pieces]
    most = min(max(1.01 * batches.PIECE_TIME / row, batches.SMALLEST_PIECE), batches.LARGEST_PIECE)
    assert max(sizes) <= most
    assert np.median(sizes) >= 0.25 * min(most, 50_000)
    pieces.clear()
    for kind in ('rays', 'points'):  # a question goes on as the last one of its kind
        next(pace.answer(kind, 50_000, answer))
    found, new = (piece.stop for piece in pieces)
    assert 0.5 * max(sizes) <= found <= most
    assert new == batches.SMALLEST_PIECE


def boxes_and_ends(count=3000):
    """A scene of boxes with velocities, and ends of rays."""
    random = np.random.default_rng(3)
    places, ends = random.uniform(0, 20, (2, count, 3))
    scene, names = NodeScene(), Numbered('b', np.arange(count))
    speeds = random.uniform(-1, 1, (count, 3))
    scene.update('s', names, Shapes.boxes(places, (0.5,) * 3), stamp=1, velocities=speeds)
    return scene, places, ends


@pytest.mark.parametrize('until', [None, 0, 10**8])
def test_a_scene_that_is_prepared_answers_a_batch_as_one_that_is_not(until):
    answers = []
    for prepared in (False, True):
        scene, places, ends = boxes_and_ends()
        at = None if until is None else np.linspace(2, 10**9, len(ends)).astype(np.int64)
        then = None if at is None else at + until
        if prepared:
            scene.prepare_rays(len(ends))
            if at is not None:
                assert not scene.is_prepared(at, then)
                scene.prepare_times(len(ends), at, then)
                assert scene.is_prepared(at, then)
        answers.append(scene.raycast_many(ends, ends - places, 1.0, at=at, until=then))
    for one, other in zip(*answers, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_scene_is_prepared_again_where_others_than_now_were_asked_for():
    scene = boxes_and_ends()[0]
    scene.refit()
    at = np.array([2])
    assert not scene.is_prepared(at, at)
    scene.raycast((0, 0, 0), (1, 0, 0), at=2)
    assert scene.is_prepared(at, at)
    scene.update(
        's', ['b0'], Shapes.boxes([(0, 0, 0)], (1, 1, 1)), stamp=2, velocities=[(1, 0, 0)]
    )
    assert not scene.is_prepared(at, at)
    scene.refit()
    assert scene.is_prepared(at, at)


def test_a_large_tree_is_built_anew_by_a_helper_and_a_copy_answers(server, monkeypatch):
    from bvh_ros.ros.parts import services

    monkeypatch.setattr(services, 'FEW', 300)
    ended(applying(server, 'given', 1000))
    threads = []
    rebuild = Scene.rebuild
    monkeypatch.setattr(
        Scene,
        'rebuild',
        lambda scene: threads.append(threading.current_thread()) or rebuild(scene),
    )
    triggers = services.TriggerServices(server.node, server.world)
    for _ in triggers.rebuild():
        assert is_there(server.world.scene, 0)
    assert server.world.changes.owner is None
    work = triggers.rebuild()
    next(work)
    server.world.finish_changes()
    assert server.world.changes.owner is None
    for _ in work:
        assert is_there(server.world.scene, 0)
    assert len(threads) == 2
    assert threading.current_thread() not in threads
    triggers.destroy()
