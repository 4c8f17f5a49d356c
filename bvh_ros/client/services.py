# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The client's end of the services: single questions."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from threading import Lock
from typing import Any, TypeVar

from nav_msgs.srv import GetPlan
from rclpy.callback_groups import CallbackGroup
from rclpy.client import Client
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future

from bvh_ros.client.asking import Patience, Question
from bvh_ros.client.errors import BvhTimeoutError
from bvh_ros.client.waiting import Pending, Waiting, left
from bvh_ros.ros.qos import REPEATED_REPLIES, REQUESTS, repeated

Answer = TypeVar('Answer')

QUERIES = 'raycast', 'raycast_all', 'overlap', 'nearest'
PATIENCE = 1.0  # seconds that the first of several tries may take
HEARTBEAT = 3.0  # seconds: the default of Fast DDS, with which what is lost is sent again
LATE = 2  # of several requests, the number of the reliable one while that service is held up


class _Call:
    """One question to a service: one reliable request, the others by best effort.

    Parameters
    ----------
    services : Services
        Of the node.
    client : rclpy.client.Client
        The reliable one.
    turn : int
        Which of the requests is the reliable one.
    """

    def __init__(
        self, services: Services, client: Client, request: GetPlan.Request, turn: int
    ) -> None:
        self.reply = Future()
        """The first reply."""
        self._services, self._client, self._request = services, client, request
        self._turn = turn
        self._tries: list[tuple[Client, Future]] = []
        self._won = Lock()
        self.question = Question(self._ask, services.patience(client))
        self.question.ask_if_due()

    def _ask(self, number: int) -> None:
        client = self._client
        if number != self._turn:
            other = self._services.repeating(client)
            if other is not None:
                client = other
            elif number == 0:
                self._turn = 0
            else:
                return
        asked, again = time.monotonic(), number > self._turn
        reply = client.call_async(self._request)
        self._tries.append((client, reply))

        def finish(reply: Future) -> None:
            if reply.cancelled() or not self._won.acquire(blocking=False):
                return
            self._services.patience(self._client).learn(time.monotonic() - asked)
            if again:
                self._services.lost()
            self.forget()
            self.reply.set_result(reply.result())

        reply.add_done_callback(finish)

    def forget(self) -> None:
        """Wait for no reply any more."""
        for client, reply in self._tries:
            if not reply.done():
                client.remove_pending_request(reply)


class Services:
    """The services `raycast`, `raycast_all`, `overlap` and `nearest` of one bvh node."""

    def __init__(self, node: Node, name: str, group: CallbackGroup, waiting: Waiting) -> None:
        self._node = node
        self._group = group
        self._waiting = waiting

        def client(service: str, qos: QoSProfile) -> Client:
            return node.create_client(
                GetPlan, f'{name}/{service}', qos_profile=qos, callback_group=group
            )

        self._clients = [client(query, REQUESTS) for query in QUERIES]
        self.raycast, self.raycast_all, self.overlap, self.nearest = self._clients
        self._repeating = {
            one: client(repeated(query), REPEATED_REPLIES)
            for query, one in zip(QUERIES, self._clients, strict=True)
        }
        self._patience = {one: Patience() for one in self._clients}
        self._lossy_until = -math.inf  # on the monotonic clock
        for one in self._clients:
            waiting.add_client(one)

    def are_offered(self) -> bool:
        """Whether the node offers them."""
        return all(client.service_is_ready() for client in self._clients)

    def ask(
        self,
        client: Client,
        request: GetPlan.Request,
        read: Callable[[Any], Answer],
        timeout: float,
    ) -> Future:
        """Return a future of what `read` makes of the reply; ask for `timeout` seconds."""
        answer = Future(executor=self._node.executor)

        def finish(reply: Future) -> None:
            try:
                answer.set_result(read(reply.result()))
            except Exception as error:
                answer.set_exception(error)

        call = self._start(client, request)
        call.reply.add_done_callback(finish)
        if not call.reply.done():
            self._waiting.ask_again(call.reply, call.question, timeout)
        return answer

    def begin(self, client: Client, request: GetPlan.Request) -> Pending:
        """Ask, and wait for the reply later."""
        call = self._start(client, request)
        return Pending(
            self._waiting, call.reply, client.srv_name, lambda _: call.forget(), call.question
        )

    def _start(self, client: Client, request: GetPlan.Request) -> _Call:
        lossy = time.monotonic() < self._lossy_until
        if lossy:
            self._waiting.add_client(self._repeating[client])
        return _Call(self, client, request, LATE if lossy else 0)

    def repeating(self, client: Client) -> Client | None:
        """The best-effort client of the same query, where the node is found to serve it."""
        other = self._repeating[client]
        if not other.service_is_ready():
            return None
        self._waiting.add_client(other)
        return other

    def patience(self, client: Client) -> Patience:
        """How long answers of this query take."""
        return self._patience[client]

    def lost(self) -> None:
        """Ask by best effort first for a while: a reliable reply is late, and so are the next."""
        self._lossy_until = time.monotonic() + HEARTBEAT

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
