# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is wanted of a MarkerArray, as columns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.conversions.times import nanoseconds

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]


class MarkerTable(NamedTuple):
    """n markers, one a row."""

    namespaces: list[str]  # the different ones, and for each row which of them
    namespace: Integers
    frame_ids: list[str]
    frame: Integers
    stamp: Integers  # (n,) ns
    id: Integers
    type: Integers
    action: Integers
    position: Floats  # (n, 3)
    orientation: Floats  # (n, 4) quaternions x, y, z, w
    scale: Floats  # (n, 3)
    lifetime: Integers  # (n,) ns
    points: Callable[[int], Floats]  # of a row, (k, 3)
    colours: Callable[[int], Floats]  # of a row's points, (k, 4), or none


def table(markers: Sequence[Any]) -> MarkerTable:
    """Return the columns of visualization_msgs/Marker objects."""
    namespaces: dict[str, int] = {}
    frame_ids: dict[str, int] = {}
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

    def points(row: int) -> Floats:
        found = np.array([(p.x, p.y, p.z) for p in markers[row].points], np.float64)
        return found.reshape(-1, 3)

    def colours(row: int) -> Floats:
        found = np.array([(c.r, c.g, c.b, c.a) for c in markers[row].colors], np.float64)
        return found.reshape(-1, 4)

    return MarkerTable(
        *(list(namespaces), namespace, list(frame_ids), frame),
        *(stamp, number, kind, action),
        *(places[:, :3], places[:, 3:7], places[:, 7:]),
        *(lifetime, points, colours),
    )
