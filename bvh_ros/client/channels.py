# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The client's topics, opened when they are first needed."""

from __future__ import annotations

import time
from threading import Lock

import numpy as np
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node

from bvh_ros.client.batch import NameChannel, RayChannel, as_rays, topic_of_names
from bvh_ros.client.errors import BvhTimeoutError
from bvh_ros.client.waiting import Waiting
from bvh_ros.ros.conversions.ray_clouds import EVERYTHING, Hits, Rays

NO_RAYS = np.empty((0, 3))
PATIENCE = 0.2  # seconds for an answer to no rays


class Channels:
    """The topics of one bvh node. Who asks for single rays only opens none."""

    def __init__(self, node: Node, name: str, group: CallbackGroup, waiting: Waiting) -> None:
        self._node = node
        self._name = name
        self._group = group
        self._waiting = waiting
        self._rays: RayChannel | None = None
        self._names: NameChannel | None = None
        self._opening = Lock()  # threads that come at once share them

    def rays(self) -> RayChannel:
        """Rays and their hits."""
        with self._opening:
            if self._rays is None:
                self._rays = RayChannel(self._node, self._name, self._group)
                self._waiting.add_subscription(self._rays.subscription)
            return self._rays

    def answered_rays(self, timeout: float) -> RayChannel:
        """The same once the node hears us and we hear it; BvhTimeoutError if not in time."""
        channel, deadline = self.rays(), time.monotonic() + timeout
        if not self._waiting.until(channel.is_found, timeout):
            raise BvhTimeoutError(f"no batches at '{self._name}' after {timeout:g} s")
        # That both are found here does not say that the node has found us.
        while not channel.has_answered:
            if time.monotonic() > deadline:
                raise BvhTimeoutError(f"'{self._name}/rays' did not answer within {timeout:g} s")
            nothing = channel.ask(as_rays(NO_RAYS, NO_RAYS, np.inf, EVERYTHING), '', None)
            self._waiting.until_done(nothing, PATIENCE)
            channel.forget(nothing)
        return channel

    def cast(self, rays: Rays, frame_id: str, stamp: int | None, timeout: float) -> Hits:
        """Wait for the hits of rays; BvhTimeoutError if they do not come in time."""
        channel = self.answered_rays(timeout)
        answer = channel.ask(rays, frame_id, stamp)
        if not self._waiting.until_done(answer, timeout):
            channel.forget(answer)
            raise BvhTimeoutError(f"'{self._name}/rays' did not answer within {timeout:g} s")
        return answer.result()

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
            lambda: topic_of_names(self._node, self._name) != '', timeout
        ):
            raise BvhTimeoutError(f"nobody tells the names of '{self._name}'")
        with self._opening:
            if self._names is None:
                topic = topic_of_names(self._node, self._name)
                self._names = NameChannel(self._node, topic, self._group)
                self._waiting.add_subscription(self._names.subscription)
            return self._names
