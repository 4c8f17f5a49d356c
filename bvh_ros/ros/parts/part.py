# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of the node: what they open on it, and when they publish."""

from __future__ import annotations

import time
import warnings
from abc import abstractmethod
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile

from bvh_ros.ros.qos import REPEATED, REQUESTS, Delivery
from bvh_ros.ros.sources.subscribing import FollowingSubscription
from bvh_ros.ros.texts import Refused, Timings

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.service import Service
    from rclpy.timer import Timer

    from bvh_ros.ros.world.views import View
    from bvh_ros.ros.world.world import World

# Replies whose client is found late.

AGAIN_AFTER = 0.4, 1.0, 3.0
"""Seconds between one attempt and the next. DDS announces a reader anew every second."""
LOOK_EVERY = 0.1  # seconds


class Late(NamedTuple):
    """A reply that is not delivered.

    Attributes
    ----------
    due : float
        When to try again, on the monotonic clock.
    attempts : int
        That failed.
    response, header
        As rclpy sends them.
    """

    due: float
    attempts: int
    response: Any
    header: Any


class Replies:
    """Sends the replies of a service, and once more those whose client was not found.

    A client asks as soon as it knows the node, which may not know the reader of its replies yet:
    news of that comes by packets of its own. rmw_fastrtps waits 0.1 s for them, then drops the
    reply, and rclpy warns. On a loaded machine the first request of a client remained unanswered.

    Parameters
    ----------
    node : rclpy.node.Node
        Serves; its executor tries again.
    service : rclpy.service.Service
        From now on sends this way.
    """

    def __init__(self, node: Node, service: Service) -> None:
        self._node = node
        self._name = service.srv_name
        self._send = service.send_response
        self._late: list[Late] = []
        self._timer: Timer | None = None
        service.send_response = self.send

    def send(self, response: Any, header: Any) -> None:
        """Send a reply now, or as soon as its client is found."""
        self._try(Late(0.0, 0, response, header))

    def close(self) -> None:
        """Try no more."""
        self._late.clear()
        self._stop_looking()

    def _try(self, late: Late) -> None:
        if self._is_sent(late):
            return
        if late.attempts == len(AGAIN_AFTER):
            self._node.get_logger().warning(
                f'a reply of {self._name} is lost: its client asked, but cannot be reached'
            )
            return
        due = time.monotonic() + AGAIN_AFTER[late.attempts]
        self._late.append(late._replace(due=due, attempts=late.attempts + 1))
        if self._timer is None:
            clock = Clock(clock_type=ClockType.STEADY_TIME)
            self._timer = self._node.create_timer(LOOK_EVERY, self._look, clock=clock)

    def _is_sent(self, late: Late) -> bool:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter('always', RuntimeWarning)
            self._send(late.response, late.header)
        return not any('failed to send response' in str(one.message) for one in said)

    def _look(self) -> None:
        """Try one: an attempt that fails takes 0.1 s, in which the node serves nothing else."""
        late = min(self._late, key=lambda one: one.due)
        if late.due <= time.monotonic():
            self._late.remove(late)
            self._try(late)
        if not self._late:
            self._stop_looking()

    def _stop_looking(self) -> None:
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None


# A part of the node: what it opened on the node goes away with it.


QOS_PERIOD = 1.0  # seconds between two looks at what publishers offer


class NodePart:
    """Opens services, topics and timers on a node, and closes them again.

    Parameters
    ----------
    node : rclpy.node.Node
        Any node, managed or not.
    """

    def __init__(self, node: Node) -> None:
        self.node = node
        self._close: list[Callable[[], object]] = []

    def service(self, kind: type, name: str, callback: Callable[..., Any], **given: Any) -> Any:
        """Create a service that lives as long as this part."""
        service = self.node.create_service(kind, name, callback, qos_profile=REQUESTS, **given)
        self._close += [
            partial(self.node.destroy_service, service),
            Replies(self.node, service).close,
        ]
        return service

    def repeated_service(self, kind: type, name: str, callback: Callable[..., Any]) -> None:
        """Create a best-effort service; its clients ask again if a reply is lost."""
        service = self.node.create_service(kind, name, callback, qos_profile=REPEATED)
        self._close.append(partial(self.node.destroy_service, service))

    def publisher(self, kind: type, topic: str, qos: Any, **given: Any) -> Any:
        """Create a publisher that lives as long as this part."""
        publisher = self.node.create_publisher(kind, topic, qos, **given)
        self._close.append(partial(self.node.destroy_publisher, publisher))
        return publisher

    def listen(
        self, kind: type, topic: str, callback: Callable[[list[Any]], None], delivery: Delivery
    ) -> None:
        """Subscribe, as publishers offer it, as long as this part lives."""
        subscription = FollowingSubscription(self.node, kind, topic, callback, delivery)
        self._close.append(subscription.destroy)
        self.every(QOS_PERIOD, subscription.check)

    def every(self, period: float, callback: Callable[[], Any]) -> None:
        """Call back every `period` seconds of real time, as long as this part lives.

        With simulated time, too: the callback has to run while nobody publishes /clock.
        """
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        timer = self.node.create_timer(period, callback, clock=clock)
        self._close.append(partial(self.node.destroy_timer, timer))

    def destroy(self) -> None:
        """Close what was opened, the last first. Doing so twice does nothing more."""
        while self._close:
            self._close.pop()()


# A part that answers, and what diagnostics show of it.


class Answerer(NodePart):
    """Answers questions about a world.

    Parameters
    ----------
    world : World
        Checked for completeness before each answer.
    view : View
        What its answers show.
    what : str
        The questions, as diagnostics call them; with `of_view` those of a view by its name.
    logged : str, optional
        How the log calls them, if otherwise.
    """

    def __init__(
        self,
        node: Node,
        world: World,
        view: View,
        what: str,
        logged: str = '',
        *,
        of_view: bool = True,
    ) -> None:
        super().__init__(node)
        self.view = view
        self.what = f'{what} of {view.name}' if of_view and view.name else what
        self.refused = Refused(node.get_logger(), logged or self.what)
        self.answered = 0  # rows
        self.timings = Timings()
        self._world = world
        self._clock = node.get_clock()

    def now(self) -> int:
        """The time on the node's clock, ns."""
        return int(self._clock.now().nanoseconds)


# Topics that cost nothing without subscribers.

PERIOD = 1.0  # seconds
REPEATS = 2  # of a message for a new subscriber, which may find us a moment after we found it


class OnDemandPublisher(NodePart):
    """Publishes at most once a second, latched, and only while there are subscribers.

    Only subscribers that ask for it get a latched message. The others would wait for a change:
    when there is a new subscriber, the last message is published again.
    """

    def __init__(self, node: Node, kind: type, topic: str) -> None:
        super().__init__(node)
        self.is_watched = False
        self._published_at = -PERIOD
        self._last: Any = None
        self._repeats = 0  # how often the last message is still to be published again
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(PERIOD, self._publish, clock=steady, autostart=False)
        self._close.append(partial(node.destroy_timer, self._timer))
        self._publisher = self.publisher(
            kind,
            topic,
            QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
            event_callbacks=PublisherEventCallbacks(matched=self._on_matched),
        )

    @abstractmethod
    def message(self) -> Any:
        """Return the next message, or its bytes; None if there is nothing new."""

    def _on_matched(self, status: Any) -> None:
        if status.current_count == 0:
            self.is_watched = False
            self._timer.cancel()
            return
        if status.current_count_change > 0:
            self._repeats = REPEATS
        if not self.is_watched:
            self.is_watched = True
            self._timer.reset()
            if time.monotonic() - self._published_at >= PERIOD:
                self._publish()

    def _publish(self) -> None:
        message = self.message()
        if message is None and self._repeats > 0:
            message = self._last
        if message is not None:
            self.send(message)

    def send(self, message: Any) -> None:
        """Publish a message, which is the newest from now on."""
        self._repeats -= self._repeats > 0
        self._last = message
        self._published_at = time.monotonic()
        self._publisher.publish(message)
