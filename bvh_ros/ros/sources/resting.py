# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A busy topic is looked at every few milliseconds; not every message wakes the node."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING

from rclpy.clock import Clock, ClockType

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.subscription import Subscription

REST = 0.01  # seconds, in which many small messages come for one round of the executor
BUSY = 0.002  # seconds between messages


class Resting:
    """Lets a busy topic's subscriptions wake nobody, and looks at them by a timer.

    An executor that does not know `resting`, a set of entities to leave out, goes on being woken.

    Parameters
    ----------
    subscriptions : collection of rclpy.subscription.Subscription
        As they are at any time.
    take : callable
        Takes and hands over what waits; returns how many messages that were.
    """

    def __init__(
        self, node: Node, subscriptions: Collection[Subscription], take: Callable[[], int]
    ) -> None:
        self._node = node
        self._subscriptions = subscriptions
        self._take = take
        self._woken = -1.0  # when, s
        self._asleep: set[Subscription] | None = None  # what the executor leaves out
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(REST, self._look, clock=steady, autostart=False)

    def woken(self) -> None:
        """Take notice that the executor was woken for a message; sleep if that comes often."""
        last, self._woken = self._woken, time.perf_counter()
        if self._woken - last < BUSY:
            self._asleep = getattr(self._node.executor, 'resting', None)
            if self._asleep is not None:
                self._asleep.update(self._subscriptions)
                self._timer.reset()

    def catch_up(self) -> None:
        """Take what waits before somebody asks."""
        if self._asleep is not None:
            self._take()

    def wake(self) -> None:
        """Be woken by each message again."""
        if self._asleep is not None:
            self._asleep.difference_update(self._subscriptions)
            self._asleep = None
            self._timer.cancel()

    def destroy(self) -> None:
        """End for good, before the subscriptions do."""
        self.wake()
        self._node.destroy_timer(self._timer)

    def _look(self) -> None:
        if self._take() < 2:
            self.wake()
