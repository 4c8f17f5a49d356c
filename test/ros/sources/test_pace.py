# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Large messages that come faster than they can be applied."""

import pytest
from ros.messages import marker
from visualization_msgs.msg import MarkerArray


def test_small_changes_wait_for_a_large_one_and_keep_their_order(world):
    count = 70_000
    points = [(k % 100, k // 100, 0) for k in range(count)]
    large = marker(0, ns='large', type=6, points=points)
    beside = ((-1, -9, 0), (1000, -9, 0))
    world.publish('bvh/obstacles', MarkerArray(markers=[marker(0, (5, -9, 0))]), qos=1000)
    world.until(lambda: world.names('raycast', *beside) == ['a/0'])
    world.publish('bvh/obstacles', MarkerArray(markers=[large]))
    for k in range(100):
        world.markers(marker(k // 2, (k, -9, 0), action=2 * (k % 2)))
    world.markers(marker(0, (0, -9, 7), ns='end'))
    world.until(lambda: world.names('raycast', (0, -9, 9), (0, -9, 5)) == ['end/0'])
    assert world.names('raycast', *beside) == []
    assert world.names('raycast', (99, 699, 5), (99, 699, -5)) == [f'large/0#{count - 1}']
    assert int(world.status('source markers').values['messages']) >= 103
    assert world.trigger('validate').success


@pytest.mark.slow
def test_messages_that_wait_make_no_long_turn(world):
    """Meshes take as long without pauses as with them: others have their turns in between."""
    faces = [(0, 0, 0), (0, 1, 0), (1, 0, 0), (0, 0, 0), (1, 0, 0), (0, 0, 1)]
    faces += [(0, 0, 0), (0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    publisher = world.node.create_publisher(MarkerArray, f'{world.name}/obstacles', 10)
    world.until(lambda: publisher.get_subscription_count() > 0)
    for x in (0, 1, 2):
        meshes = [
            marker(k, (x, k, 50), size=(1, 1, 1 + k / 1000), type=11, points=faces)
            for k in range(1000)
        ]
        publisher.publish(MarkerArray(markers=meshes))
    asked = 0
    while world.names('raycast', (2.1, 999.1, 60), (2.1, 999.1, 40)) == []:
        asked += 1
    assert asked > 8  # if each were applied in one go, once or twice a message
    world.node.destroy_publisher(publisher)
