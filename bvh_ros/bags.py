# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles recorded in a ROS 2 bag, read with rosbags: no ROS installation is needed for that."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection

# Types of topics that a source of the node can read, and the name of that source's type.
SOURCE_TYPES = {
    'visualization_msgs/msg/MarkerArray': 'MarkerArray',
    'sensor_msgs/msg/PointCloud2': 'PointCloud2',
    'nav_msgs/msg/OccupancyGrid': 'OccupancyGrid',
}


class BagError(RuntimeError):
    """A recording cannot be played; the text says why."""


class Track(NamedTuple):
    """One topic of a bag."""

    topic: str
    source_type: str  # of the node's source that reads it
    transient_local: bool  # offered so when it was recorded
    total: int  # messages


class Recording(NamedTuple):
    """The topics of a bag that bring obstacles."""

    path: Path
    tracks: list[Track]
    seconds: float  # from the first message of the bag to the last
    others: list[str]  # topics that could have been chosen, too

    @property
    def total(self) -> int:
        """How many messages there are on all topics."""
        return sum(track.total for track in self.tracks)

    def messages(self) -> Iterator[tuple[float, Track, bytes]]:
        """Seconds since the first message, its topic, and the message as it was serialised."""
        tracks = {track.topic: track for track in self.tracks}
        with _reader(self.path) as reader:
            began = None
            chosen = [c for c in reader.connections if c.topic in tracks]
            for connection, time, serialised in reader.messages(chosen):
                began = time if began is None else began
                yield (time - began) * 1e-9, tracks[connection.topic], serialised


def find(path: Path, topic: str = '') -> Recording:
    """Look into a bag for topics of obstacles.

    Parameters
    ----------
    path : Path
        Folder with a metadata.yaml, or a single .mcap or .db3 file.
    topic : str
        The only one wanted; without it all that have messages.

    Raises
    ------
    BagError
        If the bag cannot be read, or has no such topic.
    """
    with _reader(path) as reader:
        known: dict[str, list[Connection]] = {}
        for connection in reader.connections:
            if connection.msgtype in SOURCE_TYPES:
                known.setdefault(connection.topic, []).append(connection)
        tracks = [_track(name, known[name]) for name in _chosen(reader, known, topic)]
        for message_type in {known[track.topic][0].msgtype for track in tracks}:
            _check_definition(reader, message_type)
        others = sorted(known.keys() - {track.topic for track in tracks})
        return Recording(path, tracks, reader.duration * 1e-9, others)


def _track(topic: str, connections: list[Connection]) -> Track:
    """A topic may have been recorded from several publishers."""
    return Track(
        topic,
        SOURCE_TYPES[connections[0].msgtype],
        any(_is_transient_local(connection) for connection in connections),
        sum(connection.msgcount for connection in connections),
    )


def _reader(path: Path) -> AnyReader:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise BagError("bags are read with rosbags: pip install 'bvh_ros[bags]'") from error
    if path.suffix == '.bag':
        raise BagError(f'{path} is a ROS 1 bag; make a ROS 2 bag of it with rosbags-convert')
    try:
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
        reader.open()
    except Exception as error:  # of many kinds: of the file system, YAML, SQLite, MCAP
        raise BagError(f'{path} is no ROS 2 bag: {error}') from error
    reader.close()
    return reader


def _chosen(reader: AnyReader, known: dict[str, list[Connection]], topic: str) -> list[str]:
    all_topics = ', '.join(sorted(f'{c.topic} ({c.msgtype})' for c in reader.connections))
    if topic and topic not in known:
        raise BagError(f'the bag has no topic {topic} of a known type, but {all_topics or "none"}')
    if not known:
        types = ', '.join(SOURCE_TYPES.values())
        raise BagError(f'the bag has no topic of type {types}, but {all_topics or "none"}')
    wanted = [topic] if topic else sorted(known)
    chosen = [name for name in wanted if any(c.msgcount for c in known[name])]
    if not chosen:
        raise BagError(f'the bag has no message on {", ".join(wanted)}')
    return chosen


def _check_definition(reader: AnyReader, message_type: str) -> None:
    """The messages are handed on as they are, so their type has to be the one that we have."""
    from rosbags.typesys import Stores, get_typestore

    ours = get_typestore(Stores.ROS2_JAZZY)
    if reader.typestore.hash_rihs01(message_type) != ours.hash_rihs01(message_type):
        raise BagError(f'the bag was recorded with another definition of {message_type}')


def _is_transient_local(connection: Connection) -> bool:
    profiles = getattr(connection.ext, 'offered_qos_profiles', [])
    return any(profile.durability.name == 'TRANSIENT_LOCAL' for profile in profiles)
