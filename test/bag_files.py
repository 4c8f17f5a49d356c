# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of messages."""

from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

JAZZY = get_typestore(Stores.ROS2_JAZZY)


def write(path, topics, *, storage=StoragePlugin.MCAP, qos=(), begin=10**18):
    """A bag with these topics: name -> list of (seconds, message)."""
    with Writer(path, version=9, storage_plugin=storage) as writer:
        for topic, messages in topics.items():
            kind = type(messages[0][1])
            name = f'{kind.__module__.partition(".")[0]}/msg/{kind.__name__}'
            given = {'typestore': JAZZY, 'offered_qos_profiles': qos}
            connection = writer.add_connection(topic, name, **given)
            for seconds, message in messages:
                at = begin + int(seconds * 1e9)
                writer.write(connection, at, bytes(serialize_message(message)))
    return path
