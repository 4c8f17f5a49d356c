# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What subscriptions to a topic ask for."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from rclpy.qos import DurabilityPolicy, ReliabilityPolicy


class Kind(NamedTuple):
    """What a subscription asks for."""

    reliability: ReliabilityPolicy
    durability: DurabilityPolicy


LATCHED = Kind(ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
RELIABLE = Kind(ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
BEST_EFFORT = Kind(ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE)
KINDS = (LATCHED, RELIABLE, BEST_EFFORT)  # each hears all that the ones before it hear


def asked(kind: Kind, given: Mapping[str, Any]) -> Kind:
    """Return what to ask for with the user's overrides."""
    reliability, durability = given.get('reliability'), given.get('durability')
    return Kind(
        ReliabilityPolicy[reliability.upper()] if reliability else kind.reliability,
        DurabilityPolicy[durability.upper()] if durability else kind.durability,
    )


def is_kept(kind: Kind) -> bool:
    """Return whether publishers that are heard so keep messages for late joiners."""
    return kind.durability == DurabilityPolicy.TRANSIENT_LOCAL
