# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Markers as the columns that the decoder reads from their bytes, by their Python objects."""

import numpy as np
from ros.sources.generators import ended

from bvh_ros.ros.conversions import nanoseconds
from bvh_ros.ros.sources import marker_array as conversion


def table(markers):
    """Return the columns of visualization_msgs/Marker objects."""
    namespaces = {}
    frame_ids = {}
    numbers = np.empty((7, len(markers)), np.int64)
    places = np.empty((len(markers), 10))
    for row, marker in enumerate(markers):
        at, turned, scale = marker.pose.position, marker.pose.orientation, marker.scale
        places[row, :3] = at.x, at.y, at.z
        places[row, 3:7] = turned.x, turned.y, turned.z, turned.w
        places[row, 7:] = scale.x, scale.y, scale.z
        numbers[:, row] = (
            namespaces.setdefault(marker.ns, len(namespaces)),
            frame_ids.setdefault(marker.header.frame_id, len(frame_ids)),
            nanoseconds(marker.header.stamp),
            *(marker.id, marker.type, marker.action),
            nanoseconds(marker.lifetime),
        )
    namespace, frame, stamp, number, kind, action, lifetime = numbers

    def points(row):
        found = np.array([(p.x, p.y, p.z) for p in markers[row].points], np.float64)
        return found.reshape(-1, 3)

    def resource(row):
        return markers[row].mesh_resource

    def colours(row):
        found = np.array([(c.r, c.g, c.b, c.a) for c in markers[row].colors], np.float64)
        return found.reshape(-1, 4)

    return conversion.MarkerTable(
        *(list(namespaces), namespace, list(frame_ids), frame),
        *(stamp, number, kind, action),
        *(places[:, :3], places[:, 3:7], places[:, 7:]),
        *(lifetime, points, resource, colours),
    )


def change_of(markers, **given):
    """What visualization_msgs/Marker objects change in a scene."""
    return ended(conversion.change(table(markers), **given))
