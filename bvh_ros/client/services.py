# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The client's end of the services: single questions."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypeVar

from nav_msgs.srv import GetPlan
from rclpy.callback_groups import CallbackGroup
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future

from bvh_ros.client.errors import BvhTimeoutError
from bvh_ros.client.waiting import Pending, Waiting, left
from bvh_ros.ros.qos import REQUESTS

Answer = TypeVar('Answer')

PATIENCE = 1.0  # seconds that the first of several tries may take


class Services:
    """The services `raycast`, `raycast_all`, `overlap` and `nearest` of one bvh node."""

    def __init__(self, node: Node, name: str, group: CallbackGroup, waiting: Waiting) -> None:
        self._node = node
        self._group = group
        self._waiting = waiting

        def client(service: str) -> Client:
            made = node.create_client(
                GetPlan, f'{name}/{service}', qos_profile=REQUESTS, callback_group=group
            )
            waiting.add_client(made)
            return made

        self._clients = [client(name) for name in ('raycast', 'raycast_all', 'overlap', 'nearest')]
        self.raycast, self.raycast_all, self.overlap, self.nearest = self._clients

    def are_offered(self) -> bool:
        """Whether the node offers them."""
        return all(client.service_is_ready() for client in self._clients)

    def ask(
        self, client: Client, request: GetPlan.Request, read: Callable[[Any], Answer]
    ) -> Future:
        """Return a future of what `read` makes of the reply."""
        answer = Future(executor=self._node.executor)

        def finish(reply: Future) -> None:
            try:
                answer.set_result(read(reply.result()))
            except Exception as error:
                answer.set_exception(error)

        client.call_async(request).add_done_callback(finish)
        return answer

    def begin(self, client: Client, request: GetPlan.Request) -> Pending:
        """Ask, and wait for the reply later."""
        reply = client.call_async(request)
        return Pending(self._waiting, reply, client.srv_name, client.remove_pending_request)

    def call(self, client: Client, request: GetPlan.Request, timeout: float) -> GetPlan.Response:
        """Wait for the reply; BvhTimeoutError if it does not come in time."""
        self._waiting.check()
        return self.begin(client, request).result(timeout)

    def once(self, kind: Any, service: str, request: Any, timeout: float) -> Any:
        """Call another service, which is not kept open and may be asked twice.

        A reply is lost if the service has not discovered its client within 0.1 s, as happens under
        load (ros2/rmw_fastrtps#842). So another client asks again, with twice the patience.
        """
        deadline, patience = time.monotonic() + timeout, PATIENCE
        while (rest := left(deadline)) > 0.0:
            answered, reply = self._try(kind, service, request, min(patience, rest))
            if answered:
                return reply
            patience *= 2.0
        raise BvhTimeoutError(f'{service} did not answer within {timeout:g} s')

    def _try(self, kind: Any, service: str, request: Any, timeout: float) -> tuple[bool, Any]:
        deadline = time.monotonic() + timeout
        client = self._node.create_client(kind, service, callback_group=self._group)
        self._waiting.add_client(client)
        try:
            if not self._waiting.until(client.service_is_ready, timeout):
                return False, None
            reply = client.call_async(request)
            answered = self._waiting.until_done(reply, left(deadline))
            return answered, reply.result() if answered else None
        finally:
            self._waiting.remove_client(client)
            self._node.destroy_client(client)
