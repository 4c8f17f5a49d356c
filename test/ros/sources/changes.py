# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What markers change in a scene, as a source of markers finds it out."""

import logging
from types import SimpleNamespace

from rclpy.clock import Clock
from rclpy.serialization import serialize_message
from ros.sources.generators import ended
from visualization_msgs.msg import MarkerArray

from bvh_ros.ros.access import SourceSettings, create_source
from bvh_ros.ros.cdr import marker_array as decoder
from bvh_ros.ros.sources import marker_array as conversion


def change_of(markers, **given):
    """What visualization_msgs/Marker objects change."""
    read = decoder.read(serialize_message(MarkerArray(markers=[*markers])))
    return ended(conversion.change(read, **given))


def source_of(scene, into_node=lambda _frame, _stamp: None, **options):
    """A source of markers without a node."""
    node = SimpleNamespace(get_logger=logging.getLogger, get_clock=Clock)
    given = {'predict': 'none', 'meshes': 'convex', **options}
    settings = SourceSettings('s', 'MarkerArray', 't', '', False, 0.0, given)
    return create_source(node, settings, scene, SimpleNamespace(into_node=into_node))
