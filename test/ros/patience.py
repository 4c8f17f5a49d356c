# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How long tests wait for what comes for certain, however slow the machine is."""

import time
from collections.abc import Callable
from typing import Any

PATIENCE = 600.0  # seconds, against hanging; an answer takes milliseconds of a processor
COMPILING = 2400.0  # seconds, where kernels are compiled first: minutes of a processor


def spin_until(
    executor: Any,
    condition: Callable[[], Any],
    timeout: float = PATIENCE,
    pause: float = 0.01,
    said: Callable[[], str] = str,
) -> None:
    """Spin until something is true."""
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, f'still not true; the node says:\n{said()}'
        executor.spin_once(pause)


def once_compiled(ask: Callable[[], Any]) -> Any:
    """The answer to a question of a client, once the node has compiled what it takes."""
    from bvh_ros.client import BvhError

    deadline = time.monotonic() + COMPILING
    while True:
        try:
            return ask()
        except BvhError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.2)
