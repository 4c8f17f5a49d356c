# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`BvhClient`: the services and batches of one bvh node."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from bvh_ros.client import plans
from bvh_ros.client.batch import handles_of
from bvh_ros.client.batch_calls import BatchCalls
from bvh_ros.client.channels import Channels
from bvh_ros.client.errors import BvhError, BvhTimeoutError
from bvh_ros.client.services import Services
from bvh_ros.client.single_calls import SingleCalls
from bvh_ros.client.waiting import Waiting

LOOK = 0.2  # seconds between two looks whether the node still compiles
PATIENCE = 1.0  # seconds for an answer to that: who compiles is busy


class BvhClient(SingleCalls, BatchCalls):
    """Calls the services of one bvh node.

    The plain calls wait for the answer, whether the node is being spun in another thread, now and
    then, or not at all, and in callbacks, too; there they hold up everything else, so the
    `_async` forms are better. Any thread may call, and a node may have several clients.

    Parameters
    ----------
    node : rclpy.node.Node
        Your node.
    name : str, or sequence of str
        Name of the bvh node, with its namespace if that is not your own: `/robot1/bvh`. Of
        several nodes with a region each: a client of all of them, see `RegionClient`.
    timeout : float
        Seconds that a plain call waits for its answer unless it is told otherwise.
    """

    def __new__(
        cls, node: Node, name: str | Sequence[str] = 'bvh', *, timeout: float = 5.0
    ) -> Any:
        """Return a client of one node, or of several."""
        if isinstance(name, str):
            return super().__new__(cls)
        from bvh_ros.client.regions import RegionClient

        return RegionClient(node, name, timeout)

    def __init__(self, node: Node, name: str = 'bvh', *, timeout: float = 5.0) -> None:
        self.node = node
        self.name = name
        self.timeout = timeout
        # A group of their own: a callback that awaits an answer keeps the group it is in busy.
        group = ReentrantCallbackGroup()
        self.waiting = Waiting(node, group)
        self.services = Services(node, name, group, self.waiting)
        self.channels = Channels(node, name, group, self.waiting)

    def wait_until_ready(self, timeout: float = 60.0) -> None:
        """Wait until the node offers its services, and has compiled what they need.

        Raises
        ------
        BvhTimeoutError
            If it does not in time; the first start on a machine compiles for half a minute.
        """
        deadline = time.monotonic() + timeout
        if not self.waiting.until(self.services.are_offered, timeout):
            raise BvhTimeoutError(f"no services of '{self.name}' after {timeout:g} s")
        while compiling := self._compiling(deadline - time.monotonic()):
            if time.monotonic() + LOOK > deadline:  # another look would not have time to be told
                raise BvhTimeoutError(f"'{self.name}' is still {compiling}")
            time.sleep(LOOK)

    def _compiling(self, timeout: float) -> str:
        """Ask a question that is answered once all are; say how far compiling has come."""
        try:
            patience = min(max(timeout, LOOK), PATIENCE)
            self.raycast_all((0.0, 0.0), (0.0, 0.0), timeout=patience)
        except BvhTimeoutError:
            return 'compiling, or busy'
        except BvhError as error:
            return str(error) if str(error).startswith(plans.COMPILING) else ''
        return ''

    def names(self, obstacles: Iterable[int], *, timeout: float | None = None) -> dict[int, str]:
        """Return the names of node handles, as `raycast_many` returns them.

        Handles that stand for no obstacle are left out. The node tells names at most once a
        second; those of obstacles that have vanished since are missing after `timeout` seconds.

        Raises
        ------
        BvhTimeoutError
            If no names are told at all.
        """
        timeout = self.timeout if timeout is None else timeout
        return self.channels.find_names(handles_of(obstacles), timeout)
