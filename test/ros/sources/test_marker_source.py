# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles that come and go on a MarkerArray topic; `test_markers.py` has all ways to do so."""

import math

from ros.messages import marker
from visualization_msgs.msg import Marker


def test_add_modify_delete(world):
    world.markers(marker(1), marker(2, (5, 0, 0)), marker(3, (9, 0, 0), ns='b/c'))
    world.holds('a/1', 'a/2', 'b/c/3')
    world.markers(marker(1, (0, 50, 0)))
    world.until(lambda: world.names('raycast', (0, 50, -9), (0, 50, 9)) == ['a/1'])
    assert world.names('raycast', (0, 0, -9), (0, 0, 9)) == []
    world.markers(marker(2, action=Marker.DELETE), marker(7, action=Marker.DELETE))
    world.holds('a/1', 'b/c/3')
    world.markers(marker(0, ns='', action=Marker.DELETEALL))
    world.holds()


def test_round_shapes(world):
    world.show(
        marker(1, (0, 0, 0), (2, 2, 2), type=Marker.SPHERE),
        marker(2, (0, 10, 0), (2, 2, 6), type=Marker.CYLINDER),
        marker(3, (0, 20, 0), (2, 2, 2), turn=(0, 0, math.sin(0.4), math.cos(0.4))),
    )
    for y in (0, 10, 20):  # each bounding box has a corner that the shape does not fill
        assert world.names('raycast', (0.95, y + 0.95, 0.9), (0.95, y + 0.95, 0.95)) == []
    assert math.isclose(world.place('raycast', (-9, 0.6, 0), (9, 0.6, 0))[0], -0.8, abs_tol=1e-12)
