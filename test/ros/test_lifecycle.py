# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The managed node, driven over its lifecycle services as Nav2's manager does it."""

import re

import pytest
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from ros.messages import marker
from ros.patience import COMPILING

OFFERED = {'raycast', 'raycast_all', 'overlap', 'nearest', 'clear', 'rebuild', 'validate'}
EVERY_MANAGED_NODE = {'change_state', 'get_state', 'get_available_states'}


class Managed:
    """A node and who manages it."""

    def __init__(self, world):
        self.world = world

    def change(self, transition):
        """Ask for a transition and return whether it succeeded."""
        request = ChangeState.Request(transition=Transition(id=transition))
        return self.world.call('change_state', request, ChangeState, COMPILING).success

    def state(self):
        request = GetState.Request()
        return self.world.call('get_state', request, GetState).current_state.id

    def services(self):
        """Names of the node's own services, without those that every managed node has."""
        self.world.until(lambda: self.world.offered() >= EVERY_MANAGED_NODE)
        return self.world.offered() & OFFERED

    def subscribed(self):
        return self.world.node.count_subscribers(f'{self.world.name}/obstacles') > 0

    def until_services(self, expected):
        self.world.until(lambda: self.services() == expected)
        self.world.until(lambda: self.subscribed() == bool(expected))


@pytest.fixture
def manage(start_node):
    def start(**parameters):
        world = start_node(parameters, wait=False, module='lifecycle_node')
        managed = Managed(world)
        world.until(lambda: managed.state() == State.PRIMARY_STATE_UNCONFIGURED)
        return managed

    return start


def test_a_life(manage):
    managed = manage(**{'markers.required': True})
    world = managed.world
    assert managed.services() == set()
    assert not managed.subscribed()

    assert managed.change(Transition.TRANSITION_CONFIGURE)
    assert managed.state() == State.PRIMARY_STATE_INACTIVE
    assert managed.services() == set()
    assert not managed.subscribed()

    assert managed.change(Transition.TRANSITION_ACTIVATE)
    assert managed.state() == State.PRIMARY_STATE_ACTIVE
    managed.until_services(OFFERED)
    world.show(marker(1), marker(2, at=(3, 0, 0)))

    # Paused: a required source has to speak again.
    assert managed.change(Transition.TRANSITION_DEACTIVATE)
    assert managed.state() == State.PRIMARY_STATE_INACTIVE
    managed.until_services(set())
    assert managed.change(Transition.TRANSITION_ACTIVATE)
    managed.until_services(OFFERED)
    assert world.names('raycast', (-5, 0, 0), (5, 0, 0)) == [
        "error: required source 'markers' has not spoken yet"
    ]
    world.markers(marker(3, at=(6, 0, 0)))  # what else was told while it was paused?
    world.until(lambda: 'has to tell all again' in world.names('raycast', (0, 0, 0), (1, 0, 0))[0])
    everything = marker(0, ns='', action=3), marker(1), marker(3)
    world.markers(*everything)
    world.holds('a/1', 'a/3')

    # Cleaned up: the world is forgotten.
    assert managed.change(Transition.TRANSITION_DEACTIVATE)
    assert managed.change(Transition.TRANSITION_CLEANUP)
    assert managed.state() == State.PRIMARY_STATE_UNCONFIGURED
    assert managed.change(Transition.TRANSITION_CONFIGURE)
    assert managed.change(Transition.TRANSITION_ACTIVATE)
    managed.until_services(OFFERED)
    world.markers(everything[0], marker(4))
    world.holds('a/4')

    assert managed.change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert managed.state() == State.PRIMARY_STATE_FINALIZED
    managed.until_services(set())
    steps = r'\]: (configured|activated|deactivated|cleaned up|shut down)'
    done = re.findall(steps, world.said())
    once = ['configured', 'activated', 'deactivated']
    assert done == [*once, 'activated', *once[2:], 'cleaned up', *once[:2], 'shut down']
    assert 'parameters are read-only: to change them, start the node anew' in world.said()
    assert world.end() == 0


@pytest.mark.slow
def test_transitions_that_the_state_does_not_have_are_refused(manage):
    managed = manage()
    assert not managed.change(Transition.TRANSITION_ACTIVATE)
    assert not managed.change(Transition.TRANSITION_DEACTIVATE)
    assert not managed.change(99)
    assert managed.change(Transition.TRANSITION_CONFIGURE)
    assert not managed.change(Transition.TRANSITION_CONFIGURE)
    assert managed.change(Transition.TRANSITION_ACTIVATE)
    assert not managed.change(Transition.TRANSITION_ACTIVATE)
    assert managed.state() == State.PRIMARY_STATE_ACTIVE
    assert managed.world.names('raycast', (0, 0, 0), (1, 0, 0)) == []
    assert managed.change(Transition.TRANSITION_DEACTIVATE)
    assert not managed.change(Transition.TRANSITION_DEACTIVATE)
    assert managed.state() == State.PRIMARY_STATE_INACTIVE
    assert managed.world.end() == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ('parameters', 'complaint'),
    [
        ({'margin': -1.0}, "parameter 'margin' must be at least 0"),
        ({'sources': ['boxes']}, "parameter 'boxes.type' must be one of"),
        ({'views': ['overlap']}, "'overlap' is the name of another parameter"),
        ({'markers.topic': 'no topic'}, "source 'markers'"),
    ],
)
def test_a_configuration_that_cannot_be_used_leaves_the_node_unconfigured(
    manage, parameters, complaint
):
    managed = manage(**parameters)
    for _ in range(2):
        assert not managed.change(Transition.TRANSITION_CONFIGURE)
        assert managed.state() == State.PRIMARY_STATE_UNCONFIGURED
    managed.world.until(lambda: managed.world.said().count(complaint) == 2)
    assert managed.world.end() == 0


@pytest.mark.slow
def test_a_qos_override_that_makes_no_sense_keeps_the_node_unconfigured(manage):
    topic = 'qos_overrides./x.subscription.reliability'
    managed = manage(**{'markers.topic': '/x', topic: 'certainly'})
    assert not managed.change(Transition.TRANSITION_CONFIGURE)
    assert managed.state() == State.PRIMARY_STATE_UNCONFIGURED
    assert managed.services() == set()
    assert topic in managed.world.said()
