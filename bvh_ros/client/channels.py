# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The client's topics, opened when they are first needed."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from threading import Lock
from typing import Any

from nav_msgs.msg import Path
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from bvh_ros.client.batch import Channel, NameChannel, tellers_of_names
from bvh_ros.client.errors import BvhTimeoutError
from bvh_ros.client.waiting import Pending, Waiting
from bvh_ros.ros.conversions import query_clouds, ray_clouds
from bvh_ros.ros.conversions.query_clouds import Near, Touched

PATIENCE = 0.2  # seconds for an answer to nothing
# The topic of questions: that of answers, the type of questions, and how answers are read.
BATCHES: dict[str, tuple[str, type, Callable[[PointCloud2], Any]]] = {
    'rays': ('ray_hits', PointCloud2, ray_clouds.hits),
    'points': ('nearest_hits', PointCloud2, partial(query_clouds.read_answers, kind=Near)),
    'boxes': ('box_hits', PointCloud2, partial(query_clouds.read_answers, kind=Touched)),
    'paths': ('path_hits', Path, partial(query_clouds.read_answers, kind=Near)),
}


class Channels:
    """The topics of one bvh node. Who asks for single rays only opens none."""

    def __init__(self, node: Node, name: str, group: CallbackGroup, waiting: Waiting) -> None:
        self._node = node
        self._name = name
        self._group = group
        self._waiting = waiting
        self._channels: dict[str, Channel] = {}
        self._names: NameChannel | None = None
        self._opening = Lock()  # threads that come at once share them

    def open(self, asked: str) -> Channel:
        """The topics of some questions and their answers."""
        with self._opening:
            if asked not in self._channels:
                told, kind, read = BATCHES[asked]
                topics = f'{self._name}/{asked}', f'{self._name}/{told}'
                channel = Channel(self._node, topics, read, self._group, kind)
                self._channels[asked] = channel
                for subscription in channel.subscriptions:
                    self._waiting.add_subscription(subscription)
            return self._channels[asked]

    def until_answered(self, channel: Channel, timeout: float) -> None:
        """Wait until the node hears us and we hear it; BvhTimeoutError if not in time."""
        deadline = time.monotonic() + timeout
        if not self._waiting.until(channel.is_found, timeout):
            raise BvhTimeoutError(f"nobody answers '{channel.topic}' after {timeout:g} s")
        # That both are found here does not say that the node has found us.
        while not channel.has_answered:
            if time.monotonic() > deadline:
                raise BvhTimeoutError(f"'{channel.topic}' did not answer within {timeout:g} s")
            nothing, question = channel.ask(channel.nothing(), '', None)
            self._waiting.until_done(nothing, PATIENCE, question)
            channel.forget(nothing)
            if nothing.done():
                nothing.exception()  # an error is an answer, too

    def begin(
        self,
        asked: str,
        message: Any,
        timeout: float,
        frame_id: str = '',
        stamp: int | None = None,
    ) -> Pending:
        """Ask once both sides hear each other, and wait for the answers later; BvhTimeoutError if
        they do not in time.
        """
        channel = self.open(asked)
        self.until_answered(channel, timeout)
        answer, question = channel.ask(message, frame_id, stamp)
        whom = f"'{channel.topic}'"
        return Pending(self._waiting, answer, whom, channel.forget, question)

    def find_names(self, handles: set[int], timeout: float) -> dict[int, str]:
        """Names of those of the handles that are told in time, in order; BvhTimeoutError if none
        is told at all.
        """
        channel = self._told_names(timeout)
        answer = channel.ask(handles)
        self._waiting.until_done(answer, timeout)
        channel.forget(answer)
        if not (channel.has_told or answer.done()):
            raise BvhTimeoutError(f"'{self._name}' told no names within {timeout:g} s")
        known = channel.known
        return {handle: known[handle] for handle in sorted(handles) if handle in known}

    def _told_names(self, timeout: float) -> NameChannel:
        if self._names is None and not self._waiting.until(
            lambda: tellers_of_names(self._node, self._name)[0] != '', timeout
        ):
            raise BvhTimeoutError(f"nobody tells the names of '{self._name}'")
        with self._opening:
            if self._names is None:
                topic, _ = tellers_of_names(self._node, self._name)
                self._names = NameChannel(self._node, topic, self._group)
                self._waiting.add_subscription(self._names.subscription)
            return self._names
