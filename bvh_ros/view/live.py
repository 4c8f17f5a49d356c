# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A node that runs: its sources are heard and decoded here, questions go to its services."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from typing import Any

import numpy as np
import rclpy
from rcl_interfaces.msg import Parameter as ParameterMessage
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

from bvh_ros.client import BvhClient, BvhTimeoutError
from bvh_ros.ros.config.part_settings import scan_settings
from bvh_ros.ros.parts.maintenance import Maintenance
from bvh_ros.ros.server import BvhServer
from bvh_ros.view.topics import Topics
from bvh_ros.view.worlds import Answer, Floats, Frame, Group, Integers, Overlay, ShownWorld, Wanted

PATIENCE = 30.0  # seconds for parameters and diagnostics
LOOK_EVERY = 1.0
ANSWER_WITHIN = 2.0
NO_HANDLES = np.empty(0, np.int64)


class Live(ShownWorld):
    """A bvh node, as any client sees it.

    The messages of its sources are decoded here, as fast as they come, into a scene of our own.
    Of a source that told something before we listened, `~/scene` is shown, once a second. Picks
    and other questions are answered by the node itself. When the node ends, what was there stays;
    when it comes back, the view begins anew, with the parameters that it has then.

    Parameters
    ----------
    name : str
        The node's, with its namespace: `/bvh`.
    waiting : callable
        Called now and then while the node is waited for; may raise to give up.

    Raises
    ------
    BvhTimeoutError
        If the node serves, but tells no parameters or diagnostics.
    """

    def __init__(self, name: str, waiting: Callable[[], object] = lambda: None) -> None:
        self._name, self._waiting = name, waiting
        self._returned = 0  # times
        self._open()

    def _open(self) -> None:
        """Wait for the node, and listen as it does."""
        name, space = self._name, self._name.rpartition('/')[0] or '/'
        node = rclpy.create_node('bvh_view_start', namespace=space)
        try:
            _wait_for(BvhClient(node, name), self._waiting)
            parameters = _parameters(node, name)
            heard = Topics(node, name)
            _until(node, heard.sources, name, 'diagnostics')
        finally:
            node.destroy_node()
        # `~` and remappings mean something else to us.
        topics = {f'{source}.topic': topic for source, topic in heard.sources().items()}
        parameters = [
            Parameter(one.name, value=topics.get(one.name, one.value)) for one in parameters
        ]
        self.node = Node('bvh_view', namespace=space, parameter_overrides=parameters)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.topics = Topics(self.node, name)
        self._server = BvhServer(self.node)
        world = self._server.world
        super().__init__(name, world.scene)
        self.frame_id = world.frames.frame_id
        self.has_queries = True
        scan = scan_settings(self._server.settings.groups['virtual_scan'])
        self.has_scan = bool(scan.pose_topic)
        self.topics.place_scans_with(world.frames, scan)
        self._client = BvhClient(self.node, name, timeout=ANSWER_WITHIN)
        self._sources = {source.name: source for source in world.sources}
        for source in world.sources:
            source.subscribe()
        self._maintenance = Maintenance(self.node, world)
        self._known: set[bytes] = set()  # the node's publishers, as first seen
        self._present: set[bytes] = set()  # and as last seen
        self._looked_at = 0.0

    def prepare(self) -> None:
        """Nothing: the node has compiled what it needs."""

    def advance(self, until: float) -> None:
        """Hear what comes until then; begin anew with a node that came back."""
        if time.monotonic() - self._looked_at > LOOK_EVERY:
            self._look()
        self._executor.spin_once(0.0)
        while (left := until - time.monotonic()) > 0.0:
            self._executor.spin_once(left)

    def _look(self) -> None:
        """Whether the node is there, and still the one that we have listened to."""
        self._looked_at = time.monotonic()
        others = self.node.get_publishers_info_by_topic(f'{self._name}/scene')
        found = {bytes(one.endpoint_gid) for one in others}
        was_there, self._present = self._known, found
        self._known = self._known or found
        if found and was_there and not found & was_there:
            self.close()
            self._returned += 1
            self._open_again()

    def _open_again(self) -> None:
        while True:
            try:
                self._open()
                return
            except BvhTimeoutError:  # it has ended once more
                self._waiting()

    def want(self, wanted: Wanted) -> None:
        """Subscribe to what somebody looks at."""
        self.topics.want(wanted)

    def version(self) -> Hashable:
        """Another one after each message."""
        heard = sum(source.messages for source in self._sources.values())
        return self._returned, heard, self.scene.population, self.topics.scenes

    def groups(self) -> list[Group]:
        """All obstacles by source: as heard here or, where that is not all, from `~/scene`."""
        heard = {group.source: group for group in super().groups()}
        told = self.topics.drawn
        for source, shapes in told.items():
            mine = len(heard[source].handles) if source in heard else 0
            if mine < len(shapes.kind) and not self._knows_all(source):
                heard[source] = Group(source, shapes, NO_HANDLES)
        return [*heard.values()]

    def _knows_all(self, name: str) -> bool:
        source = self._sources.get(name)
        return source is not None and source.has_spoken and not source.completeness.missing()

    def levels(self, first: int, last: int) -> tuple[Floats, Floats, Integers]:
        """Boxes of the node's tree, as it tells them on `~/tree`."""
        lo, hi, depths = self.topics.boxes
        seen = (depths >= first) & (depths <= last)
        return lo[seen], hi[seen], depths[seen]

    @property
    def height(self) -> int:
        """The greatest depth that the node tells of."""
        return int(self._server.settings.groups['draw']['last_depth'])

    def overlay(self) -> Overlay:
        """The last queries and hits, and the virtual scan."""
        return self.topics.overlay

    def frames(self) -> list[Frame]:
        """The frames of the parameter `transforms`."""
        frames = self._server.world.frames
        given = [settings.frame_id for settings in self._server.settings.transforms]
        places = {name: frames.into_node(name) for name in given}
        return [
            Frame(name, place.translation, place.rotation)
            for name, place in places.items()
            if place is not None
        ]

    def now(self) -> int:
        """The node's clock."""
        return int(self.node.get_clock().now().nanoseconds)

    def figures(self) -> dict[str, str]:
        """What the node's diagnostics tell."""
        if self._is_gone:
            return {'the node': 'has ended; this is what was there'}
        return self.topics.figures

    def raycast(self, start: Floats, goal: Floats) -> Answer:
        """Ask the node for the first obstacle on a segment; the time is that of the round trip."""
        self._refuse_if_gone()
        began = time.perf_counter()
        hit = self._client.raycast(start.tolist(), goal.tolist())
        return Answer([] if hit is None else [hit], 1e6 * (time.perf_counter() - began))

    def overlap(self, lo: Floats, hi: Floats) -> Answer:
        """Ask the node for all obstacles that touch a box."""
        self._refuse_if_gone()
        began = time.perf_counter()
        hits = self._client.overlap(lo.tolist(), hi.tolist())
        return Answer(hits, 1e6 * (time.perf_counter() - began))

    @property
    def _is_gone(self) -> bool:
        return bool(self._known) and not self._present

    def _refuse_if_gone(self) -> None:
        if self._is_gone:
            raise RuntimeError(f'{self._name} has ended')

    def close(self) -> None:
        """Destroy the node."""
        self._maintenance.destroy()
        self._server.destroy()
        for source in self._sources.values():
            source.destroy()
        self._executor.shutdown()
        self.node.destroy_node()


def _wait_for(client: BvhClient, waiting: Callable[[], object]) -> None:
    while True:
        try:
            client.wait_until_ready(timeout=0.5)
            return
        except BvhTimeoutError:
            waiting()


def _parameters(node: Node, name: str) -> list[Parameter]:
    """All parameters of another node, but those of its QoS."""
    client = AsyncParameterClient(node, name)
    listed = client.list_parameters([], 0)
    _until(node, listed.done, name, 'parameters')
    names = [one for one in listed.result().result.names if not one.startswith('qos_overrides')]
    got = client.get_parameters(names)
    _until(node, got.done, name, 'parameters')
    return [
        Parameter.from_parameter_msg(ParameterMessage(name=one, value=value))
        for one, value in zip(names, got.result().values, strict=True)
    ]


def _until(node: Node, condition: Callable[[], Any], name: str, what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > deadline:
            raise BvhTimeoutError(f"'{name}' told no {what} within {PATIENCE:g} s")
        rclpy.spin_once(node, timeout_sec=0.1)
