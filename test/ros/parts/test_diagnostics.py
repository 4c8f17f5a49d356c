# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What /diagnostics tells, over ROS 2."""

import math

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

from bvh_ros import DynamicBVH
from bvh_ros.ros.parts import diagnostics
from bvh_ros.ros.texts import MOST, Timings
from bvh_ros.ros.world.large_changes import LargeChanges
from bvh_ros.ros.world.views import WHOLE
from bvh_ros.ros.world.world import IncompleteWorldError, World
from bvh_ros.scene import NodeScene, Shapes

OK, WARN, ERROR = b'\x00', b'\x01', b'\x02'


def values(status):
    return {pair.key: pair.value for pair in status.values}


@pytest.fixture(scope='module')
def busy(start_node, messages):
    """Two sources, two views, a lifetime that ends, and a marker that is refused."""
    world = start_node(
        {
            'sources': ['markers', 'boxes'],
            'boxes.type': 'PointCloud2',
            'boxes.topic': 'boxes',
            'views': ['few', 'none'],
            'few.include': ['a/*'],
            'none.include': ['nothing is called so'],
        }
    )
    world.markers(
        messages.marker(1), messages.marker(2, lifetime=0.1), messages.marker(3, size=(1, -1, 1))
    )
    world.publish('boxes', messages.cloud({'x': range(10), 'y': [5] * 10, 'z': [0] * 10}))
    world.until(lambda: len(world.everything()) == 11)
    return world


def test_the_world(busy, diagnostics):
    seen = diagnostics(busy)
    busy.until(lambda: values(seen['world'])['obstacles'] == '11')
    told = values(seen['world'])
    assert seen['world'].level == OK
    assert (told['obstacles of markers'], told['obstacles of boxes']) == ('1', '10')
    assert told['expired'] == '1'
    assert int(told['height']) >= 3
    assert float(told['cost']) > 1.0
    assert float(told['cost over that of the last build']) > 0.0  # by what was in it at the build
    assert int(told['bytes of the tree']) > 0
    assert int(told['bytes of the scene']) > 0
    assert int(told['bytes of the process']) > 10_000_000
    assert '2 views' in told['on']
    assert 'margin' in told['off']


def test_sources(busy, diagnostics):
    seen = diagnostics(busy)
    markers = values(seen['source markers'])
    assert (markers['messages'], markers['refused']) == ('1', '1')
    assert 'negative' in markers['last reason']
    assert markers['refused rows'].startswith("'a/3': ")
    assert markers['refused rows not listed'] == '0'
    assert (markers['publishers'], markers['reliability']) == ('1', 'reliable')
    assert float(markers['longest slice of an update [ms]']) > 0.0
    assert seen['source boxes'].level == OK


def test_queries_and_views(busy, diagnostics):
    seen = diagnostics(busy)
    busy.until(lambda: values(seen['queries'])['obstacles seen'] == '11')
    assert values(seen['queries of few'])['obstacles seen'] == '1'
    assert seen['queries of few'].message == 'answering'
    assert seen['queries of none'].level == OK
    assert seen['queries of none'].message == 'no obstacle matches the view none'

    # Nobody asks the view `none`: no durations, rather than NaN.
    assert values(seen['queries of none'])['answers a second'] == '0.0'
    assert not {'p50 [ms]', 'p99 [ms]', 'longest [ms]'} & values(seen['queries of none']).keys()
    assert 'nan' not in str(seen)

    def asked():
        busy.names('few/raycast', (-5, 0, 0), (5, 0, 0))
        return float(values(seen['queries of few'])['answers a second']) > 0.0

    busy.until(asked)
    told = values(seen['queries of few'])
    assert 0.0 < float(told['p50 [ms]']) <= float(told['p99 [ms]']) <= float(told['longest [ms]'])


def test_a_refused_query_is_a_warning_for_a_second(busy, diagnostics):
    seen = diagnostics(busy)
    (pose,) = busy.plan('overlap', (0, 0, 0), (1, 1, 1), tolerance=-1.0).poses
    assert pose.header.frame_id.startswith('error: tolerance')
    busy.until(lambda: seen['queries'].level == WARN)
    assert 'refused 1: tolerance' in seen['queries'].message
    busy.until(lambda: seen['queries'].level == OK)


@pytest.mark.slow
def test_a_missing_required_source_is_an_error(start_node, diagnostics):
    world = start_node({'markers.required': True})
    seen = diagnostics(world)
    for part in ('world', 'source markers'):
        assert seen[part].level == ERROR
        assert seen[part].message == "required source 'markers' has not spoken yet"


@pytest.mark.slow
def test_publishers_that_are_gone_are_a_warning(start_node, messages, diagnostics):
    world = start_node()
    world.markers(messages.marker(1))
    world.until(lambda: world.everything() == {'a/1'})
    seen = diagnostics(world)
    assert seen['source markers'].level == OK
    for publisher in world.publishers.values():
        world.node.destroy_publisher(publisher)
    world.publishers.clear()
    world.until(lambda: seen['source markers'].level == WARN)
    assert seen['source markers'].message == 'its publishers are gone; what they said is kept'
    assert world.everything() == {'a/1'}


def test_validate_tells_figures(busy):
    reply = busy.trigger('validate')
    assert reply.success
    assert reply.message.startswith('valid: 11 obstacles, height ')


# ---- the parts


def test_what_is_refused_last_is_in_the_log(world, messages):
    """Within two seconds of another refusal, and nothing comes after it."""
    world.markers(messages.marker(1, type=0))
    world.until(lambda: 'marker type 0' in world.said())
    world.markers(messages.marker(2, size=(1, -1, 1)))
    world.markers(messages.marker(3, type=99))
    world.until(lambda: "'a/3': marker type 99" in world.said())
    # The one between is counted, or said where the machine had no time for two seconds.
    assert '(1 more since the last report)' in world.said() or "'a/2'" in world.said()


def test_durations(monkeypatch):
    now = [0, 0.0]
    monkeypatch.setattr('time.perf_counter_ns', lambda: now[0])
    monkeypatch.setattr('time.monotonic', lambda: now[1])
    timings = Timings()
    assert math.isnan(timings.look().median)
    for milliseconds in range(100, 0, -1):
        now[0] += milliseconds * 1_000_000
        timings.add(now[0] - milliseconds * 1_000_000)
    now[1] = 4.0
    assert timings.look() == (25.0, 50.0, 99.0, 100.0)
    now[1] = 5.0
    assert timings.look()[0] == 0.0
    for _ in range(3 * MOST):
        timings.add(now[0])
    assert len(timings.durations) == MOST
    now[1] = 6.0
    assert timings.look().rate == 3 * MOST


def test_a_survey_takes_a_hundredth_of_the_time(monkeypatch):
    """One look costs 40 ms: the next is due after 4 s."""
    now = [0.0]
    monkeypatch.setattr('time.monotonic', lambda: now[0])
    taken = []

    class SlowScene(NodeScene):
        def figures(self):
            now[0] += 0.04
            taken.append(now[0])
            return super().figures()

    class World:
        scene = SlowScene()
        views = (WHOLE,)

    looks = diagnostics.SceneStatistics(World())
    for _ in range(100):
        figures, _seen = looks.look()
        assert 'age of these figures' in figures
        now[0] += 1.0
    assert 19 <= len(taken) <= 26


@pytest.mark.slow
def test_a_world_whose_change_was_interrupted(monkeypatch):
    """Nothing is answered before it is cleared, and diagnostics say so."""
    scene = NodeScene()
    world = World(None, LargeChanges(scene), None, (), (WHOLE,))
    looks = diagnostics.SceneStatistics(world)

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(DynamicBVH, 'insert_many', interrupt)
    with pytest.raises(KeyboardInterrupt):
        scene.update('s', ['a'], Shapes.boxes([(0, 0, 0)], (1, 1, 1)), stamp=1)
    assert '~/clear' in world.problem(0)
    with pytest.raises(IncompleteWorldError):
        world.at(0, thin_ray=True)
    _, seen = looks.look()
    assert seen == {WHOLE.name: 0}
    scene.clear()
    assert world.problem(0) == ''
    assert world.at(0) is scene


def test_the_cost_of_a_large_tree_is_not_counted_between_answers(monkeypatch):
    """That of 10^6 boxes would silence the node for 55 ms."""
    scene = NodeScene()
    lo = np.random.default_rng(0).uniform(0, 50, (100, 3))
    scene.update('s', [str(k) for k in range(100)], Shapes.boxes(lo, [1, 1, 1]))
    assert scene.figures() == scene.stats()

    def fail(_):
        raise AssertionError('it was counted')

    monkeypatch.setattr('bvh_ros.scene.inspection.MOST_COUNTED', 99)
    monkeypatch.setattr(DynamicBVH, 'cost', fail)
    world = World(None, LargeChanges(scene), None, (), (WHOLE,))
    figures, _ = diagnostics.SceneStatistics(world).look()
    assert '~/validate' in figures['cost']
    assert figures['height'] == scene.figures()['height']
