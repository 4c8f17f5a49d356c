# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A subscription that follows what the publishers offer, and counts what is lost."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy, qos_policy_name_from_kind

from bvh_ros.ros.config.qos_overrides import OVERRIDABLE, overrides
from bvh_ros.ros.qos import DEPTH, Delivery
from bvh_ros.ros.seldom import Seldom
from bvh_ros.ros.sources.backlog import Backlog
from bvh_ros.ros.sources.kinds import (
    BEST_EFFORT,
    KINDS,
    LATCHED,
    RELIABLE,
    Kind,
    asked,
    is_kept,
    unheard,
)
from bvh_ros.ros.sources.merging import HOLD, Merger, Told
from bvh_ros.ros.sources.numbering import NEXT, Heard, Numbering
from bvh_ros.ros.sources.resting import Resting

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.qos_overriding_options import QoSOverridingOptions
    from rclpy.subscription import Subscription

TURN = 0.01  # seconds after which others get a turn
SMALL = 4096  # bytes of messages that may be handed over together


class FollowingSubscription:
    """Subscribes as the publishers offer, each of them as well as it does.

    A reliable subscription never hears a best-effort publisher, nor one that asks for what was
    kept for late joiners a publisher that keeps nothing. So there is one for each kind; that for
    best effort only while somebody offers no more.

    Whoever is woken takes and hands over all that waits, for as long as a turn may take: an
    executor's round costs more than a small message does.

    Parameters
    ----------
    callback : callable
        Takes a message, or its bytes, in a list; with it those that may be handed over together.
    on_irregular : callable, optional
        Takes what a message's number says about those before, where it does not just follow, and
        whether its publisher keeps messages for late joiners; called before `callback`.
    says_everything : callable, optional
        Whether a message needs none of those before it: of such, few may wait. None: no message
        does.
    is_full : callable, optional
        Whether messages have to wait here; `resume` says when no longer.

    Raises
    ------
    ValueError
        If a QoS override makes no sense.
    """

    def __init__(
        self,
        node: Node,
        message_type: type,
        topic: str,
        callback: Callable[[list[Any]], None],
        delivery: Delivery,
        *,
        on_irregular: Callable[[Heard, bool], None] = lambda _heard, _kept: None,
        says_everything: Callable[[Any], bool] | None = None,
        is_full: Callable[[], bool] = lambda: False,
    ) -> None:
        self._node = node
        self._message_type = message_type
        self._callback = callback
        self._on_irregular = on_irregular
        self._is_full = is_full
        self._raw, self._together = delivery.raw, delivery.together
        self.topic = node.resolve_topic_name(topic)
        self.incompatible = ''  # why a publisher is not heard, and the remedy
        self.lost = 0  # messages
        self._losses = Seldom(lambda text: node.get_logger().warning(text))
        self._numbering = Numbering()
        self._merger = Merger(self._deliver, HOLD if delivery.ordered else 0.0)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._holding = node.create_timer(HOLD / 2, self._release, clock=steady, autostart=False)
        # Subscriptions come and go outside of their own events' callbacks.
        self._change = node.create_guard_condition(self.check)
        self._supersedes = says_everything is not None
        self._backlog = Backlog(says_everything or (lambda _message: False), self._joins)
        self._more = node.create_guard_condition(self._hand_over_some)
        self._is_handing_over = False
        given = overrides(node, self.topic)
        wanted = asked(LATCHED if delivery.latched else RELIABLE, given)
        self._wanted = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=delivery.depth)
        self._subscriptions: dict[Kind, Subscription] = {}
        self._resting = Resting(node, self._subscriptions.values(), self._take_what_waits)
        self._create(wanted, OVERRIDABLE)  # rclpy writes the user's depth into the profile
        self._follows = delivery.follow and wanted.reliability == ReliabilityPolicy.RELIABLE
        if wanted == LATCHED and self._follows and 'durability' not in given:
            self._create(RELIABLE)

    def check(self) -> None:
        """Subscribe best effort, too, as long as somebody offers no more; warn of losses.

        To be called about once a second.
        """
        self._losses.log()
        offered = {
            info.qos_profile.reliability
            for info in self._node.get_publishers_info_by_topic(self.topic)
        }
        if not (self._follows and offered):
            return
        wanted = ReliabilityPolicy.BEST_EFFORT in offered
        if wanted == (BEST_EFFORT in self._subscriptions):
            return
        log = self._node.get_logger().info
        if wanted:
            log(f'{self.topic}: subscribing best effort, too, as a publisher offers no more')
            self._create(BEST_EFFORT)
        else:
            log(f'{self.topic}: nobody publishes best effort any more')
            self._take_the_rest(BEST_EFFORT, math.inf)
            self.resume()
            self._resting.wake()
            self._node.destroy_subscription(self._subscriptions.pop(BEST_EFFORT))

    def destroy(self) -> None:
        """Listen no longer."""
        self._resting.destroy()
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()
        self._node.destroy_timer(self._holding)
        self._node.destroy_guard_condition(self._change)
        self._node.destroy_guard_condition(self._more)

    def resume(self) -> None:
        """Hand over what waits, soon, unless it has to wait still."""
        if self._backlog and not self._is_handing_over and not self._is_full():
            self._more.trigger()

    def catch_up(self) -> None:
        """Take what waits before somebody asks; usually the executor's rounds have done so."""
        self._resting.catch_up()

    def publishers(self) -> int:
        """Return how many publishers there are, heard or not."""
        return int(self._node.count_publishers(self.topic))

    def figures(self) -> dict[str, object]:
        """Return who is heard, how, and what was lost, as /diagnostics shows it."""
        counts = self._counts()
        kinds = [kind for kind, count in counts.items() if count] or [*counts]
        figures: dict[str, object] = {
            'reliability': kinds[0].reliability.name.lower(),
            'durability': kinds[0].durability.name.lower(),
            'messages lost': self.lost,
        }
        if self._supersedes:
            figures['messages that newer ones replaced'] = self._backlog.superseded
        return figures

    def _create(self, kind: Kind, overriding: QoSOverridingOptions | None = None) -> None:
        history, depth = self._wanted.history, self._wanted.depth
        qos = QoSProfile(
            history=history, depth=depth, reliability=kind.reliability, durability=kind.durability
        )
        if overriding is not None:
            self._wanted = qos
        self._subscriptions[kind] = self._node.create_subscription(
            self._message_type,
            self.topic,
            partial(self._receive, kind),
            qos,
            raw=self._raw,
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=partial(self._on_incompatible, kind)
            ),
            qos_overriding_options=overriding,
        )

    def _receive(self, kind: Kind, message: Any, info: dict[str, Any]) -> None:
        self._take(kind, message, info)
        self._take_what_waits()
        if self._together:
            self._resting.woken()

    def _take_what_waits(self) -> int:
        """Take and hand over what waits; return how many messages came."""
        # Who is replaced by a newer message is known once that is taken.
        limit = math.inf if self._supersedes else TURN
        taken = sum(self._take_the_rest(kind, limit) for kind in self._subscriptions)
        self._hand_over_some()
        return taken

    def _take(self, kind: Kind, message: Any, info: dict[str, Any]) -> None:
        told = Told(message, info['publication_sequence_number'], is_kept(kind))
        counts = self._counts()
        place = KINDS.index(kind) if kind in KINDS else 0
        self._merger.take(
            told,
            info['source_timestamp'],
            # Whoever is counted: a publisher may be gone while what it said still waits.
            others_hear=len(counts) > 1,
            better_hear=any(counts.get(other) for other in KINDS[:place]),
        )
        if self._merger.is_holding and self._holding.is_canceled():
            self._holding.reset()

    def _release(self) -> None:
        self._merger.release()
        if not self._merger.is_holding:
            self._holding.cancel()
        self._hand_over_some()

    def _deliver(self, told: Told) -> None:
        publishers = max(self._counts().values(), default=0)
        heard = self._numbering.note(told.number, publishers)
        if heard.lost:
            self.lost += heard.lost
            self._losses.add(
                f'{self.topic}: {self.lost} messages were lost in all; they came faster than they '
                'were taken, or on a connection that loses some',
                heard.lost,
            )
        self._backlog.add(told.message, (told, heard))

    def _hand_over_some(self) -> None:
        """Hand over what waits until the turn is over, and go on after others had theirs."""
        end = time.perf_counter() + TURN
        self._is_handing_over = True
        try:
            while self._backlog and not self._is_full() and time.perf_counter() < end:
                self._hand_over(*self._backlog.next())
        finally:
            self._is_handing_over = False
            self.resume()

    def _joins(self, message: Any, more: tuple[Told, Heard]) -> bool:
        return self._together and more[1] is NEXT and len(message) <= SMALL

    def _hand_over(self, messages: list[Any], first: tuple[Told, Heard]) -> None:
        told, heard = first
        if heard is not NEXT:
            self._on_irregular(heard, told.kept)
        self._callback(messages)

    def _take_the_rest(self, kind: Kind, limit: float) -> int:
        """Take what already waits, for so many seconds; return how many messages that were."""
        handle = self._subscriptions[kind].handle
        end = time.perf_counter() + limit
        most = (self._wanted.depth or DEPTH) - len(self._backlog)
        for count in range(most):
            with handle:
                taken = handle.take_message(self._message_type, self._raw)
            if taken is None:
                return count
            self._take(kind, *taken)
            if time.perf_counter() >= end:
                return count + 1
        return max(most, 0)

    def _counts(self) -> dict[Kind, int]:
        """How many publishers each subscription hears."""
        return {kind: one.get_publisher_count() for kind, one in self._subscriptions.items()}

    def _on_incompatible(self, kind: Kind, event: Any) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        if kind == LATCHED and RELIABLE in self._subscriptions:
            return  # that one hears who keeps nothing
        if self._follows and policy == 'RELIABILITY':
            self._change.trigger()
            return
        self.incompatible = unheard(self.topic, policy, kind)
        self._node.get_logger().warning(f'{self.topic}: {self.incompatible}')
