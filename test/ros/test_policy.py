# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The SROS 2 policy grants what the nodes do, and nothing else."""

import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from rclpy.validate_full_topic_name import validate_full_topic_name
from rclpy.validate_namespace import validate_namespace
from ros.patience import COMPILING, PATIENCE

from bvh_ros.ros.access import has_typed_services

POLICY = Path(__file__).parents[2] / 'config' / 'bvh_policy.xml'
# What sros2's schema allows of the elements used: attributes (those that must be there first),
# and children.
SCHEMA = {
    'policy': (('version',), (), 'enclaves'),
    'enclaves': ((), (), 'enclave'),
    'enclave': (('path',), (), 'profiles'),
    'profiles': ((), ('type',), 'profile'),
    'profile': (('ns', 'node'), (), 'topics services'),
    'topics': ((), ('publish', 'subscribe'), 'topic'),
    'services': ((), ('reply', 'request'), 'service'),
    'topic': ((), (), ''),
    'service': ((), (), ''),
}
GRANTS = ('publish', 'subscribe', 'reply', 'request')


@pytest.fixture(scope='module')
def policy():
    """As sros2 reads it, by lxml: to that, a comment is a child like any other, without a path."""
    builder = ElementTree.TreeBuilder(insert_comments=True, insert_pis=True)
    return ElementTree.parse(POLICY, ElementTree.XMLParser(target=builder)).getroot()


def test_the_policy_has_the_form_that_sros2_reads(policy):
    assert policy.tag == 'policy'
    assert policy.get('version') == '0.2.0'
    for element in policy.iter():
        needed, possible, children = SCHEMA[element.tag]
        assert set(needed) <= set(element.keys()) <= {*needed, *possible}, element.tag
        assert {child.tag for child in element} <= set(children.split()), element.tag
        if children:
            assert len(element), f'{element.tag} is empty'
            assert not (element.text or '').strip(), element.tag
        else:
            assert element.text == element.text.strip() != ''
        for kind in set(GRANTS) & set(element.keys()):
            assert element.get(kind) in ('ALLOW', 'DENY')


def test_sros2_makes_an_enclave_of_each_child(policy):
    """It creates keys for the path of every child of `enclaves`, and then looks its profiles up.

    Permissions name what a profile's `ns` and `node` make of `~`.
    """
    paths = [child.get('path') for child in policy.find('enclaves')]
    assert paths == ['/bvh/node', '/bvh/lifecycle_node', '/bvh/client']
    for path in paths:
        assert validate_namespace(path)
        (enclave,) = policy.findall(f"enclaves/enclave[@path='{path}']")
        for profile in enclave.findall('profiles/profile'):
            node = f'{profile.get("ns").rstrip("/")}/{profile.get("node")}'
            assert node == ('/bvh_client' if path == '/bvh/client' else '/bvh')
            for name in (item.text for block in profile for item in block):
                assert validate_full_topic_name(name.replace('~', node))


def granted(policy, enclave, name):
    """What an enclave allows, with its node called `name`: kind of right to names."""
    (profile,) = policy.findall(f"enclaves/enclave[@path='{enclave}']/profiles/profile")
    rights = {kind: [] for kind in GRANTS}
    for block in profile:
        for kind in GRANTS:
            if block.get(kind) == 'ALLOW':
                rights[kind] += [item.text.replace('~', name) for item in block]
    for names in rights.values():
        assert len(set(names)) == len(names), 'a right is given twice'
    return {kind: set(names) for kind, names in rights.items()}


def used(world, name='bvh'):
    """What a running node does, as the graph tells."""
    node, ns = world.node, world.namespace
    # The graph tells of a node a moment after its first service answers.
    world.until(lambda: (name, ns) in node.get_node_names_and_namespaces())
    return {
        'publish': {n for n, _ in node.get_publisher_names_and_types_by_node(name, ns)},
        'subscribe': {n for n, _ in node.get_subscriber_names_and_types_by_node(name, ns)},
        'reply': {n for n, _ in node.get_service_names_and_types_by_node(name, ns)},
        'request': {n for n, _ in node.get_client_names_and_types_by_node(name, ns)},
    }


def check(policy, enclave, world):
    expected = granted(policy, enclave, world.name)
    if not has_typed_services():  # they come with another package
        expected['reply'] = {name for name in expected['reply'] if '/query/' not in name}
    try:
        world.until(lambda: used(world) == expected)
    except AssertionError:
        assert used(world) == expected  # says what differs
        raise


def test_the_node_is_granted_what_it_does(policy, world):
    check(policy, '/bvh/node', world)


def test_the_managed_node_is_granted_what_it_does(policy, start_node):
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    world = start_node(wait=False, module='lifecycle_node')
    for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
        request = ChangeState.Request(transition=Transition(id=transition))
        assert world.call('change_state', request, ChangeState, COMPILING).success
    check(policy, '/bvh/lifecycle_node', world)


def test_a_client_may_ask_and_nothing_else(policy):
    node = granted(policy, '/bvh/node', '/bvh')
    client = granted(policy, '/bvh/client', '/bvh_client')
    services = 'raycast', 'raycast_all', 'overlap', 'nearest'
    names = {*services, *(f'_best_effort/{name}' for name in services)}
    assert client['request'] == {f'/bvh/{name}' for name in names}
    assert client['request'] <= node['reply']
    shared = {'/rosout', '/parameter_events'}
    asked = {'/bvh/rays', '/bvh/boxes', '/bvh/points'}
    assert client['publish'] - shared == asked <= node['subscribe']
    assert client['subscribe'] <= node['publish']


ASK = """
import contextlib, sys
import rclpy
from bvh_ros.client import BvhClient, BvhError

rclpy.init(args=['--ros-args', '-r', f'__ns:={sys.argv[1]}'])
client = BvhClient(rclpy.create_node('bvh_client'), timeout=float(sys.argv[2]))
client.wait_until_ready(client.timeout)
client.raycast_many([(0.0, 0.0, 0.0)], [(1.0, 0.0, 0.0)])
client.names([])
with contextlib.suppress(BvhError):  # it may have to be compiled
    client.nearest_many([(0.0, 0.0, 0.0)])
with contextlib.suppress(BvhError):
    client.overlap_many([(0.0, 0.0, 0.0)], (1.0, 1.0, 1.0))
print('asked', flush=True)
sys.stdin.read()
"""


def test_a_client_is_granted_what_it_does(policy, world):
    """All but what only a program of its own asks for: here, diagnostics."""
    client = subprocess.Popen(
        [sys.executable, '-c', ASK, world.namespace, str(PATIENCE)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert client.stdout.readline() == 'asked\n'
        given = granted(policy, '/bvh/client', f'{world.namespace}/bvh_client')
        allowed = {
            kind: {name.replace('/bvh/', f'{world.name}/') for name in names}
            for kind, names in given.items()
        }
        allowed['subscribe'] -= {'/diagnostics'}
        world.until(lambda: used(world, 'bvh_client') == allowed)
    finally:
        client.stdin.close()
        client.wait()
