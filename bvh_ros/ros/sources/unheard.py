# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Why a publisher is not heard, and what its owner can do."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

# What every publisher offers.
LEAST = {'reliability': 'best_effort', 'durability': 'volatile'}


class Asked(Protocol):
    """What a subscription asks for."""

    @property
    def reliability(self) -> ReliabilityPolicy:
        """Whether messages that were lost are sent again."""

    @property
    def durability(self) -> DurabilityPolicy:
        """Whether messages are kept for who comes late."""


def unheard(topic: str, policy: str, asked: Asked) -> str:
    """Say that a publisher offers less of a policy than is asked for, and the two ways out."""
    policy = policy.lower()
    if policy not in LEAST:
        return f'a publisher is not heard: its {policy} is not what is asked for'
    wanted = getattr(asked, policy).name.lower()
    return (
        f'a publisher is not heard: it offers less than the {policy} {wanted} that is asked for. '
        f"Let it publish with {policy} {wanted}, or set this node's parameter "
        f"'qos_overrides.{topic}.subscription.{policy}' to '{LEAST[policy]}'"
    )
