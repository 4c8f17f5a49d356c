# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The only door to what rclpy keeps private: its public names offer none of this."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.impl import implementation_singleton


def _private(owner: Any, name: str) -> Any:
    try:
        return getattr(owner, name)
    except AttributeError:
        raise ImportError(
            f"this rclpy has no '{name}', which bvh_ros needs; it is known to work with rclpy 7.1 "
            '(ROS 2 Jazzy) and 9.1 (Kilted)'
        ) from None


_compiled = _private(implementation_singleton, 'rclpy_implementation')
RCLError: type[Exception] = _private(_compiled, 'RCLError')
"""What rcl says about arguments, and transitions, that cannot be."""
UnknownROSArgsError: type[Exception] = _private(_compiled, 'UnknownROSArgsError')
WaitSet = _private(_compiled, 'WaitSet')
"""Waits for some entities of a node, whatever spins the rest."""
spin_once = _private(SingleThreadedExecutor, '_spin_once_impl')
"""Takes an executor, a timeout and a condition that ends the wait whenever it is woken."""
_TAKING = '_take_subscription', '_take_service', '_take_waitable'
for _name in _TAKING:
    _private(SingleThreadedExecutor, _name)


def guard_taking(executor: Executor, attempt: Callable[..., Any]) -> None:
    """Let an executor take messages, requests and events by `attempt(call, entity)`."""
    for name in _TAKING:
        setattr(executor, name, partial(attempt, getattr(executor, name)))
