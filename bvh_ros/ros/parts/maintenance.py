# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What has to be done again and again, whoever asks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bvh_ros.ros.parts.part import NodePart

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.world.world import World

EXPIRY_PERIOD = 0.1  # seconds; queries expire obstacles exactly, this frees what nobody asks about
QOS_PERIOD = 1.0  # seconds


class Maintenance(NodePart):
    """Removes obstacles whose time is over, and follows what publishers offer."""

    def __init__(self, node: Node, world: World) -> None:
        super().__init__(node)
        self._world = world
        self._turn = node.create_guard_condition(self._expire)
        self._close.append(lambda: node.destroy_guard_condition(self._turn))
        self.every(EXPIRY_PERIOD, self._expire)
        self.every(QOS_PERIOD, self._check_qos)

    def _expire(self) -> None:
        if self._world.expire(self.node.get_clock().now().nanoseconds):
            self._turn.trigger()

    def _check_qos(self) -> None:
        for source in self._world.sources:
            if source.subscription is not None:
                source.subscription.check()
