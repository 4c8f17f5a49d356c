# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages to arrays: pure functions, no node needed."""

from __future__ import annotations

from typing import Any


def nanoseconds(time: Any) -> int:
    """Return a builtin_interfaces Time or Duration in ns."""
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)
