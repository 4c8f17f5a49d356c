# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What subscriptions to a topic ask for, and why a publisher is not heard."""

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
# What every publisher offers.
LEAST = {'reliability': 'best_effort', 'durability': 'volatile'}


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


def unheard(topic: str, policy: str, kind: Kind) -> str:
    """Say that a publisher offers less of a policy than is asked for, and the two ways out."""
    policy = policy.lower()
    if policy not in LEAST:
        return f'a publisher is not heard: its {policy} is not what is asked for'
    wanted = getattr(kind, policy).name.lower()
    return (
        f'a publisher is not heard: it offers less than the {policy} {wanted} that is asked for. '
        f"Let it publish with {policy} {wanted}, or set this node's parameter "
        f"'qos_overrides.{topic}.subscription.{policy}' to '{LEAST[policy]}'"
    )
