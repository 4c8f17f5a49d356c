# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated time: the clock of a node is that of a test, whatever time the machine takes."""

from typing import Any

from builtin_interfaces.msg import Time
from rosgraph_msgs.msg import Clock

REMAP = '/clock:=clock'  # for a node with `use_sim_time`


class Simulation:
    """The clock of a node that was started with REMAP."""

    def __init__(self, world: Any) -> None:
        self.world = world
        self._publisher = world.node.create_publisher(Clock, f'{world.namespace}/clock', 1)
        world.until(lambda: self._publisher.get_subscription_count() > 0)

    def at(self, seconds: float) -> None:
        """Set the node's time, and wait until the node has it: error replies are stamped so."""
        whole, rest = divmod(round(seconds * 1e9), 10**9)
        message = Clock(clock=Time(sec=whole, nanosec=rest))

        def arrived() -> bool:
            self._publisher.publish(message)  # again and again: /clock is best effort
            return abs(self.now() - seconds) < 1e-6

        self.world.until(arrived)

    def now(self) -> float:
        """The node's time, s."""
        header = self.world.plan('raycast', (float('nan'), 0, 0), (1, 0, 0)).header
        return float(header.stamp.sec + header.stamp.nanosec / 1e9)

    def destroy(self) -> None:
        """Publish no more."""
        self.world.node.destroy_publisher(self._publisher)
