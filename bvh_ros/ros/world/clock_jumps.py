# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node's clock may jump: a simulation starts over, a recording loops, /clock takes over.

What an obstacle has left to live and how long a source has been silent are carried over to the
new time. Otherwise, after a jump back, obstacles would outlive their lifetimes by the length of
the jump, and a silent source would look fresh for as long. A jump forward is time that passes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration

from bvh_ros.ros.seldom import LOG_EVERY, Seldom

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.world.world import World


class ClockJumps:
    """Moves the world to the new time whenever the clock jumps back or is exchanged."""

    def __init__(self, node: Node, world: World) -> None:
        self._clock = node.get_clock()
        self._node = node
        self._jumps = Seldom(lambda text: node.get_logger().warning(text))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(LOG_EVERY, self._jumps.log, clock=steady)
        self._world = world
        self._before = 0  # ns
        self._handle = self._clock.create_jump_callback(
            JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1)),
            pre_callback=self._note_time,
            post_callback=self._on_jump,
        )

    def _note_time(self) -> None:
        self._before = self._clock.now().nanoseconds

    def _on_jump(self, _jump: object) -> None:
        # Not by the jump's own account: that is zero where /clock takes over.
        now = self._clock.now().nanoseconds
        by = now - self._before
        self._jumps.add(
            f'the clock jumped by {by / 1e9:.3f} s; lifetimes and ages go on from there'
        )
        self._world.shift(by, now)

    def destroy(self) -> None:
        """Take no notice any more."""
        self._handle.unregister()
        self._node.destroy_timer(self._timer)
