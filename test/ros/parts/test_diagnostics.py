# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What /diagnostics tells, over ROS 2."""

import logging
import math

import numpy as np
import pytest
from ros.messages import cloud, marker

from bvh_ros import DynamicBVH
from bvh_ros.ros.parts import diagnostics
from bvh_ros.ros.texts import (
    LISTED,
    LONGEST_LINE,
    MOST,
    Refused,
    Seldom,
    Timings,
    as_line,
    shortened,
)
from bvh_ros.ros.world.large_changes import LargeChanges
from bvh_ros.ros.world.views import WHOLE
from bvh_ros.ros.world.world import IncompleteWorldError, World
from bvh_ros.scene import NodeScene, Refusal, Shapes

OK, WARN, ERROR = b'\x00', b'\x01', b'\x02'


@pytest.fixture(scope='module')
def busy(start_node):
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
    world.markers(marker(1), marker(2, lifetime=0.1), marker(3, size=(1, -1, 1)))
    world.publish('boxes', cloud({'x': range(10), 'y': [5] * 10, 'z': [0] * 10}))
    world.until(lambda: len(world.everything()) == 11)
    return world


def test_the_world(busy):
    def counted():
        told = busy.status('world').values
        return (told['obstacles of markers'], told['obstacles of boxes']) == ('1', '10')

    busy.until(counted)
    status = busy.status('world')
    told = status.values
    assert (status.level, status.message) == (OK, '11 obstacles')
    assert told['obstacles'] == '11'
    assert told['expired'] == '1'
    assert int(told['height']) >= 3
    assert float(told['cost']) > 1.0
    assert float(told['cost over that of the last build']) > 0.0  # by what was in it at the build
    assert int(told['bytes of the tree']) > 0
    assert int(told['bytes of the scene']) > 0
    assert int(told['bytes of the process']) > 10_000_000
    assert '2 views' in told['on']
    assert 'margin' in told['off']


def test_sources(busy):
    seen = busy.statuses()
    markers = seen['source markers'].values
    assert (markers['messages'], markers['refused']) == ('1', '1')
    assert 'negative' in markers['last reason']
    assert markers['refused rows'].startswith("'a/3': ")
    assert markers['refused rows not listed'] == '0'
    assert (markers['publishers'], markers['reliability']) == ('1', 'reliable')
    assert float(markers['longest slice of an update [ms]']) > 0.0
    assert seen['source boxes'].level == OK


def test_queries_and_views(busy):
    busy.until(lambda: busy.status('queries').values['obstacles seen'] == '11')
    seen = busy.statuses()
    few, none = seen['queries of few'], seen['queries of none']
    assert (few.values['obstacles seen'], few.message) == ('1', 'answering')
    assert (none.level, none.message) == (OK, 'no obstacle matches the view none')
    # Nobody asks the view `none`: no durations, rather than NaN.
    assert none.values['answers a second'] == '0.0'
    assert not {'p50 [ms]', 'p99 [ms]', 'longest [ms]'} & none.values.keys()
    assert 'nan' not in str(seen)

    def asked():
        busy.names('few/raycast', (-5, 0, 0), (5, 0, 0))
        few.values = busy.status('queries of few').values
        return float(few.values['answers a second']) > 0.0

    busy.until(asked)
    p50, p99, longest = (float(few.values[f'{of} [ms]']) for of in ('p50', 'p99', 'longest'))
    assert 0.0 < p50 <= p99 <= longest


def test_a_refused_query_is_a_warning_until_the_next_status(busy):
    told = []

    def warned():
        (pose,) = busy.plan('overlap', (0, 0, 0), (1, 1, 1), tolerance=-1.0).poses
        assert pose.header.frame_id.startswith('error: tolerance')
        told.append(busy.status('queries'))
        return told[-1].level == WARN

    busy.until(warned)
    assert 'refused 1: tolerance' in told[-1].message
    busy.until(lambda: busy.status('queries').level == OK)


@pytest.mark.slow
def test_a_missing_required_source_is_an_error(start_node):
    seen = start_node({'markers.required': True}).statuses()
    for part in ('world', 'source markers'):
        assert seen[part].level == ERROR
        assert seen[part].message == "required source 'markers' has not spoken yet"


@pytest.mark.slow
def test_publishers_that_are_gone_are_a_warning(start_node):
    world = start_node()
    world.show(marker(1))
    assert world.status('source markers').level == OK
    for publisher in world.publishers.values():
        world.node.destroy_publisher(publisher)
    world.publishers.clear()
    world.until(lambda: world.status('source markers').level == WARN)
    said = world.status('source markers').message
    assert said == 'its publishers are gone; what they said is kept'
    assert world.everything() == {'a/1'}


def test_validate_tells_figures(busy):
    reply = busy.trigger('validate')
    assert reply.success
    assert reply.message.startswith('valid: 11 obstacles, height ')


# ---- the parts


def test_what_is_refused_last_is_in_the_log(world):
    """Within two seconds of another refusal, and nothing comes after it."""
    world.markers(marker(1, type=0))
    world.until(lambda: 'marker type 0' in world.said())
    world.markers(marker(2, size=(1, -1, 1)))
    world.markers(marker(3, type=99))
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


# ---- texts in log lines and errors: how long they are, how often they come


def test_texts_of_others_fit_into_a_line():
    assert shortened('short') == 'short'
    assert shortened('x' * 80) == 'x' * 80
    assert shortened('x' * 81) == 'x' * 80 + '... (81 characters)'
    assert shortened('a\nb\x1b') == 'a\\nb\\x1b'
    assert as_line(ValueError('one\n two ' + 'x' * 10**6)).startswith('one two xxx')
    assert len(as_line(ValueError('x' * 10**6))) < LONGEST_LINE + 30


def test_a_line_every_two_seconds_and_none_is_left_out(monkeypatch):
    now, said = [10.0], []
    monkeypatch.setattr('time.monotonic', lambda: now[0])
    seldom = Seldom(said.append)
    seldom.log()
    for total in (2, 4, 6):
        seldom.add(f'{total} are lost', 2)
    assert said == ['2 are lost (1 more since the last report)']
    now[0] += 2.0
    for _ in range(2):
        seldom.log()
    assert said[1:] == ['6 are lost (3 more since the last report)']


def test_refused_rows_are_listed_up_to_a_limit():
    refused = Refused(logging.getLogger('test'), 'source')
    refused.add_rows([Refusal(row, f'a/{row}', f'reason {row}') for row in range(7)])
    rows = refused.rows()
    assert rows['refused rows'].splitlines() == [f"'a/{i}': reason {i}" for i in range(7)]
    assert rows['refused rows not listed'] == 0
    refused.add_rows([Refusal(row, f'b/{row}', 'no') for row in range(3 * LISTED)])
    rows = refused.rows()
    assert len(rows['refused rows'].splitlines()) == LISTED
    assert rows['refused rows not listed'] == 2 * LISTED + 7
