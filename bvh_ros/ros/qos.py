# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How much may wait on the way, so that a burst is late and not lost; and what users override."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

from rclpy.qos import QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from bvh_ros.ros.parameters import ConfigurationError, given_at_start, hint

if TYPE_CHECKING:
    from rclpy.node import Node

# Messages, requests or replies. DDS takes memory only for those that do wait. Every client of a
# service hears all replies, so what one client keeps has to hold those to the others, too.
DEPTH = 5000
REQUESTS = QoSProfile(depth=DEPTH)  # reliable and volatile, as services are
# A reliable service whose reply is lost delivers none of its later replies until the next
# heartbeat, 3 s by default. So each query has a second, best-effort service, by which `BvhClient`
# asks again. A node that was busy finds at most so many repeated requests there.
REPEATED = QoSProfile(depth=8, reliability=ReliabilityPolicy.BEST_EFFORT)
REPEATED_REPLIES = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)


def repeated(query: str) -> str:
    """Return the name of the best-effort service of a query; ROS hides it from lists."""
    return f'_best_effort/{query}'


class Delivery(NamedTuple):
    """How messages of a topic are to come."""

    depth: int = DEPTH
    """How many may wait."""
    latched: bool = False
    """Whether to ask for what was published earlier."""
    follow: bool = True
    """False keeps to one kind of publishers."""
    ordered: bool = True
    """Whether their order matters."""
    together: bool = False
    """Whether small ones that come often may be handed over together, some milliseconds late."""
    raw: bool = False
    """Whether they are handed over as serialised bytes."""


# The user's `qos_overrides`: read by rclpy, checked here, because it lets mistakes pass.

GROUP = 'qos_overrides'
CHOICES = {
    'history': ('keep_last', 'keep_all'),
    'reliability': ('reliable', 'best_effort'),
    'durability': ('volatile', 'transient_local'),
}
OVERRIDABLE = QoSOverridingOptions(
    (
        QoSPolicyKind.HISTORY,
        QoSPolicyKind.DEPTH,
        QoSPolicyKind.RELIABILITY,
        QoSPolicyKind.DURABILITY,
    )
)


def overrides(node: Node, topic: str) -> dict[str, Any]:
    """Return what was overridden for the subscription of a topic, by policy.

    Raises
    ------
    ConfigurationError
        If a value makes no sense.
    """
    beginning = _beginning(topic)
    found = {
        name.removeprefix(beginning): value
        for name, value in given_at_start(node).items()
        if name.startswith(beginning)
    }
    for policy, value in found.items():
        choices = CHOICES.get(policy)
        if choices and value not in choices:
            raise ConfigurationError(
                f"parameter '{beginning}{policy}' must be one of {', '.join(choices)}, "
                f'not {value!r}'
            )
        if policy == 'depth' and (type(value) is not int or value < 1):
            raise ConfigurationError(
                f"parameter '{beginning}depth' must be a whole number from 1, not {value!r}"
            )
    return found


def check_overrides(node: Node, topics: Iterable[str]) -> None:
    """Raise ConfigurationError if an override makes no sense, or is for none of these topics."""
    known = [_beginning(topic) + policy for topic in topics for policy in (*CHOICES, 'depth')]
    for name in given_at_start(node):
        if name.startswith(f'{GROUP}.') and name not in known:
            raise ConfigurationError(f"parameter '{name}' is for nothing here{hint(name, known)}")
    for topic in topics:
        overrides(node, topic)


def _beginning(topic: str) -> str:
    return f'{GROUP}.{topic}.subscription.'
