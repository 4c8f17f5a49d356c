# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Four nodes of a region each, asked as one: the answers of one node, or an error."""

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

from visualization_msgs.msg import MarkerArray

from bvh_ros.client import BvhClient, BvhError, BvhTimeoutError

TOPIC, BOXES, CALLS = '/regions/boxes', 120, 60
INF = float('inf')
QUARTERS = [
    [-INF, -INF, -INF, 0.0, 0.0, INF],
    [0.0, -INF, -INF, INF, 0.0, INF],
    [-INF, 0.0, -INF, 0.0, INF, INF],
    [0.0, 0.0, -5.0, 30.0, 30.0, 5.0],  # what lies beyond is nobody's
]


@pytest.fixture(scope='module')
def nodes(start_node, messages):
    """One that knows all, and four that share it."""
    given = {'sources': ['boxes'], 'boxes.type': 'MarkerArray', 'boxes.topic': TOPIC}
    whole = start_node(given)
    parts = [start_node({**given, 'region': region}) for region in QUARTERS]
    publisher = whole.node.create_publisher(MarkerArray, TOPIC, 10)
    whole.until(lambda: publisher.get_subscription_count() == 5)
    rng = np.random.default_rng(2)
    places, sizes = rng.uniform(-10, 10, (BOXES, 3)), rng.uniform(0.2, 3.0, (BOXES, 3))
    publisher.publish(
        MarkerArray(
            markers=[messages.marker(i, places[i], sizes[i], stamp=1) for i in range(BOXES)]
        )
    )
    whole.until(lambda: len(whole.everything()) == BOXES)
    lo, hi = places - sizes / 2, places + sizes / 2
    for part, region in zip(parts, QUARTERS, strict=True):
        here = ((lo <= region[3:]) & (hi >= region[:3])).all(axis=1)
        wanted = {f'a/{i}' for i in np.flatnonzero(here)}
        assert 10 < len(wanted) < BOXES
        part.until(lambda part=part, wanted=wanted: part.everything() == wanted)
    yield whole, parts
    whole.node.destroy_publisher(publisher)


def test_four_nodes_answer_as_one(nodes):
    whole, parts = nodes
    one = BvhClient(whole.node, whole.name, timeout=60.0)
    all_four = BvhClient(whole.node, [part.name for part in parts], timeout=60.0)
    all_four.wait_until_ready()
    rng, hits = np.random.default_rng(9), 0
    for _ in range(CALLS):
        a, b = rng.uniform((-12, -12, -4), (12, 12, 4), (2, 3)).tolist()
        radius = float(rng.choice([0.0, 0.3]))
        assert all_four.raycast(a, b, radius) == one.raycast(a, b, radius)
        assert all_four.raycast_all(a, b, radius) == one.raycast_all(a, b, radius)
        found = all_four.overlap(a, b)
        assert {hit.name for hit in found} == {hit.name for hit in one.overlap(a, b)}
        hits += len(found)
    turned = ((-3, -1, -1), (3, 1, 1), (0.0, 0.0, 0.6, 0.8))
    assert all_four.overlap(*turned) == one.overlap(*turned)
    assert hits > CALLS


def test_what_nobody_knows_is_not_free(nodes):
    whole, parts = nodes
    names = [part.name for part in parts]
    client = BvhClient(whole.node, names, timeout=60.0)
    for a, b in (((5, 5, 0), (5, 5, 9)), ((31, 5, 0), (32, 5, 0)), ((-5, 5, 6), (5, 5, 6))):
        with pytest.raises(BvhError, match='leaves the regions'):
            client.raycast(a, b)
    client.raycast((-5, 5, 4.9), (5, 5, 4.9))
    with pytest.raises(BvhError, match='leaves the regions'):
        client.raycast((-5, 5, 4.9), (5, 5, 4.9), 0.2)
    with pytest.raises(BvhError, match='leaves the regions'):
        client.overlap((1, 1, 1), (2, 2, 2), tolerance=4.0)
    with pytest.raises(ValueError, match='a name'):
        BvhClient(whole.node, [])
    missing = BvhClient(whole.node, [*names, '/nowhere/bvh'], timeout=1.0)
    with pytest.raises(BvhTimeoutError):
        missing.raycast((0, 0, 0), (1, 1, 0))
    hasty = BvhClient(whole.node, names, timeout=60.0)
    hasty.regions()
    parts[3].process.kill()
    parts[3].process.wait()
    with pytest.raises(BvhTimeoutError):
        hasty.raycast((1, 1, 0), (2, 2, 0), timeout=2.0)
    with pytest.raises(BvhTimeoutError):
        hasty.overlap((-1, -1, -1), (1, 1, 1), timeout=2.0)
    assert hasty.raycast((-9, -9, 0), (-1, -1, 0)) == BvhClient(
        whole.node, whole.name, timeout=60.0
    ).raycast((-9, -9, 0), (-1, -1, 0))
