# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A subscription that follows what the publishers offer."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
    qos_policy_name_from_kind,
)
from rclpy.qos_overriding_options import QoSOverridingOptions

from bvh_ros.ros.sources.unheard import unheard

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.subscription import Subscription

OVERRIDABLE = (
    QoSPolicyKind.HISTORY,
    QoSPolicyKind.DEPTH,
    QoSPolicyKind.RELIABILITY,
    QoSPolicyKind.DURABILITY,
)


class FollowingSubscription:
    """Subscribes reliably, and best effort where only that is offered.

    A reliable subscription never hears a best-effort publisher. When such a one appears and no
    other offers more, the subscription is made anew; and again when that changes.

    Parameters
    ----------
    node : rclpy.node.Node
    message_type : ROS message class
    topic : str
    callback : callable
    depth : int
        How many messages may wait.
    transient_local : bool
        Whether to ask for what was published earlier.
    follow : bool
        False keeps to the reliability first asked for.
    raw : bool
        True hands over the serialised bytes.

    Raises
    ------
    RuntimeError, rclpy.exceptions.ParameterException
        If a QoS override makes no sense.
    """

    def __init__(
        self,
        node: Node,
        message_type: type,
        topic: str,
        callback: Callable[[Any], None],
        *,
        depth: int,
        transient_local: bool = False,
        follow: bool = True,
        raw: bool = False,
    ) -> None:
        self._node = node
        self._message_type = message_type
        self._callback = callback
        self._raw = raw
        self.topic = node.resolve_topic_name(topic)
        self.incompatible = ''  # why a publisher is not heard, and the remedy
        # The subscription is replaced outside of its own event's callback.
        self._change = node.create_guard_condition(self.check)
        self.qos = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=depth,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL
            if transient_local
            else DurabilityPolicy.VOLATILE,
        )
        # rclpy writes the user's overrides into self.qos.
        self._subscription = self._create(QoSOverridingOptions(OVERRIDABLE))
        self._follow = follow and self.qos.reliability == ReliabilityPolicy.RELIABLE

    def check(self) -> None:
        """Subscribe anew if the publishers now offer another reliability."""
        offered = {
            info.qos_profile.reliability
            for info in self._node.get_publishers_info_by_topic(self.topic)
        }
        if not (self._follow and offered):
            return
        wanted = max(offered, key=lambda reliability: reliability == ReliabilityPolicy.RELIABLE)
        if wanted == self.qos.reliability:
            return
        self._node.get_logger().info(
            f'{self.topic}: subscribing {wanted.name.lower()} as its publishers offer'
        )
        self.qos.reliability = wanted
        self.incompatible = ''
        self._node.destroy_subscription(self._subscription)
        self._subscription = self._create(None)

    def destroy(self) -> None:
        """Listen no longer."""
        self._node.destroy_subscription(self._subscription)
        self._node.destroy_guard_condition(self._change)

    def publishers(self) -> int:
        """Return how many publishers are matched."""
        return int(self._node.count_publishers(self.topic))

    def _create(self, overrides: QoSOverridingOptions | None) -> Subscription:
        return self._node.create_subscription(
            self._message_type,
            self.topic,
            self._callback,
            self.qos,
            raw=self._raw,
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=self._on_incompatible),
            qos_overriding_options=overrides,
        )

    def _on_incompatible(self, event: Any) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        self.incompatible = unheard(self.topic, policy, self.qos)
        if self._follow and policy == 'RELIABILITY':
            self._change.trigger()
        else:
            self._node.get_logger().warning(f'{self.topic}: {self.incompatible}')
