# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The process that publishes the soak's world until it is ended.

Run: python -m bvh_ros.report.soak.publisher NAMESPACE
"""

import re
import struct
import sys
import time
from typing import Any

import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.serialization import serialize_message
from visualization_msgs.msg import Marker, MarkerArray

from .scene import BOXES, HALF, scene_at

RATE = 30.0  # frames a second
TOPIC = 'bvh/obstacles'
STAMP, ID, X = 0x1D0FACED, 0x0B0EAC71, -1.2345678901234567e89  # occur nowhere else


class Frames:
    """Makes the MarkerArray of a frame, as serialised bytes.

    rclpy takes 42 ms to serialise a thousand markers, longer than a frame lasts. So one message is
    serialised, and its numbers are overwritten in place.
    """

    def __init__(self) -> None:
        serialised = _serialised()
        self._bytes = np.frombuffer(serialised, np.uint8).copy()
        self._stamps = _places(serialised, struct.pack('<i', STAMP), 4)
        # An id is followed by type and action, a place by orientation and size.
        self._ids = _places(serialised, struct.pack('<i', ID), 4)
        self._poses = _places(serialised, struct.pack('<d', X), 80)

    def message(self, frame: int) -> bytes:
        """Frame number `frame`, stamped with as many seconds and one."""
        scene = scene_at(frame)
        order = np.argsort(~scene.present, kind='stable')  # deletions come last
        zero = np.zeros(BOXES)
        turn = (zero, zero, np.sin(scene.yaw / 2), np.cos(scene.yaw / 2))
        table = np.column_stack((scene.centre, *turn, 2.0 * HALF))[order]
        actions = np.where(scene.present, Marker.ADD, Marker.DELETE)[order, None]
        self._write(self._stamps, np.full((BOXES, 1), 1 + frame))
        self._write(self._ids, order[:, None])
        self._write(self._ids + 8, actions)
        self._write(self._poses, table)
        return self._bytes.tobytes()

    def _write(self, places: NDArray[np.int64], values: NDArray[Any]) -> None:
        kind = '<i4' if values.dtype.kind == 'i' else '<f8'
        self._bytes[places] = values.astype(kind).view(np.uint8).reshape(places.shape)


def _places(serialised: bytes, mark: bytes, size: int) -> NDArray[np.int64]:
    """(n, size) indices of the bytes that begin with a mark, one row a marker."""
    starts = np.array([found.start() for found in re.finditer(re.escape(mark), serialised)])
    return starts[:, None] + np.arange(size)


def _serialised() -> bytes:
    """A MarkerArray with marks where frames differ."""
    array = MarkerArray()
    for _ in range(BOXES):
        marker = Marker(ns='soak', id=ID, type=Marker.CUBE)
        marker.header.frame_id = 'map'
        marker.header.stamp.sec = STAMP
        marker.pose.position.x = X
        array.markers.append(marker)
    return bytes(serialize_message(array))


def main(namespace: str) -> None:
    """Publish frame after frame; a late one is followed by the next at once."""
    rclpy.init(args=[])
    node = rclpy.create_node('soak_publisher', namespace=namespace)
    publisher = node.create_publisher(MarkerArray, TOPIC, 10)
    while publisher.get_subscription_count() == 0:
        time.sleep(0.01)
    frames, frame, began = Frames(), 0, time.monotonic()
    while rclpy.ok():
        message = frames.message(frame)
        time.sleep(max(0.0, began + frame / RATE - time.monotonic()))
        publisher.publish(message)
        frame += 1


if __name__ == '__main__':
    main(*sys.argv[1:])
