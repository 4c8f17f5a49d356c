# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated time over ROS 2: lifetimes and ages follow /clock, whatever it does."""

import itertools

import numpy as np
import pytest
from ros.messages import marker
from ros.simulation import REMAP, Simulation

from bvh_ros.scene import NodeScene, Shapes


@pytest.fixture
def simulate(start_node):
    started = []

    def start(**parameters):
        world = start_node({'use_sim_time': True, **parameters}, remap=REMAP)
        started.append(Simulation(world))
        return started[-1]

    yield start
    for simulation in started:
        simulation.destroy()


def answer(world):
    """Names met along x, or the reason why there is no answer."""
    return world.names('raycast_all', (-5, 0, 0), (50, 0, 0))


def test_lifetimes_and_ages_follow_the_clock(simulate):
    simulation = simulate(**{'markers.max_age': 20.0})
    world = simulation.world
    simulation.at(100.0)
    world.markers(
        marker(1, lifetime=5.0), marker(2, at=(3, 0, 0), lifetime=50.0), marker(3, at=(6, 0, 0))
    )
    world.until(lambda: answer(world) == ['a/1', 'a/2', 'a/3'])

    # A clock that stands still: no lifetime ends.
    for _ in range(3):
        world.executor.spin_once(0.1)
    assert answer(world) == ['a/1', 'a/2', 'a/3']

    simulation.at(104.999)
    assert answer(world) == ['a/1', 'a/2', 'a/3']
    simulation.at(105.0)
    assert answer(world) == ['a/2', 'a/3']

    # The simulation starts over, 5 s after the source spoke: 15 s are left until it is too old.
    simulation.at(3.0)
    assert answer(world) == ['a/2', 'a/3']
    assert 'the clock jumped by -102.000 s' in world.said()
    simulation.at(17.9)
    assert answer(world) == ['a/2', 'a/3']
    simulation.at(18.5)
    assert answer(world) == [
        "error: source 'markers' is silent for 20.5 s, longer than its max_age of 20 s"
    ]
    world.markers(marker(3, at=(6, 0, 0)))
    world.until(lambda: answer(world) == ['a/2', 'a/3'])
    # 45 s of the second's life were left at the jump, at 3 s.
    simulation.at(38.0)
    world.markers(marker(3, at=(6, 0, 0)))
    world.until(lambda: answer(world) == ['a/2', 'a/3'])
    simulation.at(47.999)
    assert answer(world) == ['a/2', 'a/3']
    simulation.at(48.0)
    assert answer(world) == ['a/3']

    # Told again in time, it stays.
    for number, seconds in ((5, 50.0), (6, 53.0)):
        simulation.at(seconds)
        renewed = marker(4, at=(9, 0, 0), lifetime=4.0)
        world.markers(renewed, marker(number, at=(3.0 * number, 0, 0)))
        world.until(lambda number=number: f'a/{number}' in answer(world))
    simulation.at(56.999)
    assert answer(world) == ['a/3', 'a/4', 'a/5', 'a/6']
    simulation.at(57.0)
    assert answer(world) == ['a/3', 'a/5', 'a/6']


@pytest.mark.slow
def test_a_clock_that_stands_still_is_said_in_diagnostics(simulate):
    simulation = simulate()
    simulation.at(10.0)
    world = simulation.world
    world.until(lambda: '/clock stands still' in world.status('world').message)
    assert world.status('world').level == b'\x01'
    times = itertools.count(11)

    def recovered():
        simulation.at(next(times))
        return world.status('world').level == b'\x00'

    world.until(recovered)


@pytest.mark.parametrize('by', [-(10**18), -7, 0, 5, 10**17])
def test_shifted_lifetimes(by):
    scene = NodeScene()
    begin = 2 * 10**18
    lives = np.array([0, 1, 10, 10**12])
    boxes = Shapes.boxes(np.arange(12.0).reshape(4, 3), [0.5, 0.5, 0.5])
    expires = np.where(lives > 0, begin + lives, 0)
    scene.update('s', list('abcd'), boxes, stamp=begin, expires=expires)
    scene.shift_expiries(by)
    left = {'a', 'b', 'c', 'd'}
    for life, name in ((1, 'b'), (10, 'c'), (10**12, 'd')):
        assert scene.expire(begin + by + life - 1) == 0
        assert scene.expire(begin + by + life) == 1
        left.remove(name)
        assert {name for _, name in scene.names()} == left
    assert scene.expired == 3
