# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How much may wait on the way, so that a burst is late and not lost."""

from typing import NamedTuple

from rclpy.qos import QoSProfile, ReliabilityPolicy

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
