# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The user's `qos_overrides`: read by rclpy, checked here, because it lets mistakes pass."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSPolicyKind
from rclpy.qos_overriding_options import QoSOverridingOptions

from bvh_ros.ros.config.parameters import ConfigurationError, given_at_start

if TYPE_CHECKING:
    from rclpy.node import Node

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


def check(node: Node, topics: Iterable[str]) -> None:
    """Raise ConfigurationError if an override makes no sense, or is for none of these topics."""
    known = [_beginning(topic) + policy for topic in topics for policy in (*CHOICES, 'depth')]
    for name in given_at_start(node):
        if name.startswith(f'{GROUP}.') and name not in known:
            near = difflib.get_close_matches(name, known, 1)
            hint = f"; did you mean '{near[0]}'?" if near else ''
            raise ConfigurationError(f"parameter '{name}' is for nothing here{hint}")
    for topic in topics:
        overrides(node, topic)


def _beginning(topic: str) -> str:
    return f'{GROUP}.{topic}.subscription.'
