# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The client's ends of the services and topics of one bvh node."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Path
from nav_msgs.srv import GetPlan
from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2

from bvh_ros.client import messages
from bvh_ros.client.messages import (
    Batch,
    BvhError,
    BvhTimeoutError,
    Hit,
    NoRowAnsweredError,
    Typed,
)
from bvh_ros.client.waiting import Patience, Question, Waiting, left
from bvh_ros.ros.conversions import nanoseconds
from bvh_ros.ros.conversions.query_clouds import (
    UNANSWERED,
    Hits,
    Near,
    PathHits,
    Touched,
    read_answers,
)
from bvh_ros.ros.qos import REPEATED_REPLIES, REQUESTS, repeated

QUERIES = 'raycast', 'raycast_all', 'overlap', 'nearest'
HEARTBEAT = 3.0  # seconds: the default of Fast DDS, with which what is lost is sent again
LATE = 2  # of several requests, the number of the reliable one while that service is held up
# Fast DDS sends a heartbeat with each message of a publisher that keeps only the latest one, so
# what is lost is sent again at once. What the next message has replaced is sent again.
LATEST = QoSProfile(depth=1)
JITTER = 1_000_000  # ns, of a stamp near the clock
TIME_JITTER = 1_000_000_000  # ns, of a stamp near the times of the rows: clients may share these
COMPILING_LOOK = 0.2  # seconds between two looks whether the node still compiles
REFUSAL_PATIENCE = 1.0  # seconds for an answer to that: a node that compiles is busy
PARAMETERS_PATIENCE = 0.2  # seconds until the request for parameters is sent again
NAMES_TYPE = 'diagnostic_msgs/msg/DiagnosticStatus'


class Kind(NamedTuple):
    """Questions of one kind."""

    questions: str
    """Their topic."""
    answers: str
    """The topic of answers."""
    message: type
    """Of questions."""
    kind: Any
    """Hits, Near, PathHits or Touched."""
    work: float
    """Seconds that an answer takes a row, at most."""


KINDS = {
    'rays': Kind('rays', 'ray_hits', PointCloud2, Hits, 1e-5),
    'points': Kind('points', 'nearest_hits', PointCloud2, Near, 1e-5),
    'boxes': Kind('boxes', 'box_hits', PointCloud2, Touched, 1e-5),
    'paths': Kind('paths', 'path_hits', Path, Near, 1e-4),
    'path sweeps': Kind('paths', 'path_hits', Path, PathHits, 1e-4),
}


class OneNode:
    """Asks one bvh node. Its topics are opened when they are first needed.

    Parameters
    ----------
    waiting : Waiting
        May be shared by several nodes.
    """

    def __init__(self, node: Node, name: str, waiting: Waiting) -> None:
        self.name = name
        self._node = node
        self._waiting = waiting
        self._services = {query: self._service(GetPlan, query) for query in QUERIES}
        self._topics: dict[str, _Topic] = {}
        self._names: dict[int, str] | None = None  # None: no message of names has come
        self._has_names_topic = False
        self._opening = Lock()  # threads that come at once share the topics

    def _service(self, kind: type, query: str) -> _Service:
        clients = (
            self._node.create_client(
                kind, f'{self.name}/{name}', qos_profile=qos, callback_group=self._waiting.group
            )
            for name, qos in ((query, REQUESTS), (repeated(query), REPEATED_REPLIES))
        )
        return _Service(self._waiting, *clients)

    def wait_until_ready(self, timeout: float) -> None:
        """See `BvhClient.wait_until_ready`."""
        deadline = time.monotonic() + timeout
        clients = [self._services[query].reliable for query in QUERIES]
        if not self._waiting.until(lambda: all(c.service_is_ready() for c in clients), timeout):
            raise BvhTimeoutError(f"no services of '{self.name}' after {timeout:g} s")
        while compiling := self._compiling(deadline - time.monotonic()):
            if time.monotonic() + COMPILING_LOOK > deadline:  # too late for another look
                raise BvhTimeoutError(f"'{self.name}' is still {compiling}")
            time.sleep(COMPILING_LOOK)

    def _compiling(self, timeout: float) -> str:
        """Return how far compiling has come; '' if it is done."""
        try:
            why = self._refusal('', max(timeout, COMPILING_LOOK))
        except BvhTimeoutError:
            return 'compiling, or busy'
        return why if why.startswith(messages.COMPILING) else ''

    def _refusal(self, frame_id: str, timeout: float) -> str:
        """Ask a question that is answered once all are; return why it is not, '' if it is.
        BvhTimeoutError if the node does not answer in time, or not soon.
        """
        request = messages.request([0.0] * 3, [0.0] * 3, 0.0, frame_id)
        try:
            self.hits('raycast_all', request, min(timeout, REFUSAL_PATIENCE))
        except BvhTimeoutError:
            raise
        except BvhError as error:
            self._waiting.require_life()  # else the error is the node's answer
            return str(error)
        return ''

    def wait_until_batches_are_ready(self, timeout: float) -> None:
        """See `BvhClient.wait_until_batches_are_ready`."""
        nothing = messages.rays(np.empty((0, 3)), np.empty((0, 3)), 1.0, 1, None, None, None)
        question = self.batch_question(nothing)
        # An error is an answer, too.
        if not self._waiting.until(question.answer.done, timeout, [question]):
            raise BvhTimeoutError(f'{question.name} did not answer within {timeout:g} s')
        question.drop()

    def hits(self, query: str, request: GetPlan.Request, timeout: float) -> list[Hit]:
        """Return the hits of one question."""
        hits: list[Hit] = self._waiting.result(self.question(query, request), timeout)
        return hits

    def answers(
        self, batch: Batch, timeout: float, frame_id: str = '', stamp: int | None = None
    ) -> Any:
        """Return the answers to a batch; the error for none says why, if a plain question is
        refused, too.
        """
        deadline = time.monotonic() + timeout
        try:
            return self._waiting.result(self.batch_question(batch, frame_id, stamp), timeout)
        except NoRowAnsweredError as error:
            why = ''
            with suppress(BvhTimeoutError):
                why = self._refusal(frame_id, left(deadline))
            raise BvhError(why or str(error)) from None

    def typed_answers(self, question: Typed, timeout: float) -> Any:
        """Return the answers of a typed service; BvhTimeoutError if the node does not offer it."""
        deadline = time.monotonic() + timeout
        with self._opening:
            if question.query not in self._services:
                self._services[question.query] = self._service(question.kind, question.query)
        service = self._services[question.query]
        if not self._waiting.until(service.reliable.service_is_ready, timeout):
            raise BvhTimeoutError(
                f"no '{self.name}/{question.query}' after {timeout:g} s: the node needs the "
                "package bvh_msgs, and its parameter 'batch'"
            )
        call = _Call(service, question.request, question.read, None, question.work)
        return self._waiting.result(call, left(deadline))

    def question(
        self,
        query: str,
        request: GetPlan.Request,
        read: Callable[[GetPlan.Response], Any] = messages.hits,
        executor: Executor | None = None,
    ) -> Question:
        """Return one question, which is not sent yet."""
        return _Call(self._services[query], request, read, executor)

    def batch_question(
        self,
        batch: Batch,
        frame_id: str = '',
        stamp: int | None = None,
        *,
        some: Any = slice(None),
        executor: Executor | None = None,
    ) -> Question:
        """Return a question about some rows of a batch, which is not sent yet."""
        with self._opening:
            if batch.kind not in self._topics:
                self._topics[batch.kind] = _Topic(self._node, self.name, batch.kind, self._waiting)
        topic = self._topics[batch.kind]
        if stamp is None:
            # Near the times of the rows, to keep their nanoseconds. But another frame is
            # transformed at the stamp, so there it is near the clock.
            stamp = topic.new_stamp(None if frame_id else batch.begin)
        message = batch.message(stamp, some)
        message.header.frame_id = frame_id
        message.header.stamp = Time(nanoseconds=stamp).to_msg()
        return _BatchQuestion(topic, message, executor)

    def names(self, handles: set[int], timeout: float) -> dict[int, str]:
        """Return the names of those handles that come in time; BvhTimeoutError if no names do."""
        deadline = time.monotonic() + timeout
        if not self._waiting.until(lambda: self.publishers_of_names()[0] != '', timeout):
            raise BvhTimeoutError(f"nobody publishes the names of '{self.name}'")
        with self._opening:
            if not self._has_names_topic:
                self._has_names_topic = True
                latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
                subscription = self._node.create_subscription(
                    DiagnosticStatus,
                    self.publishers_of_names()[0],
                    self._receive_names,
                    latched,
                    callback_group=self._waiting.group,
                )
                self._waiting.add_subscription(subscription)
        self._waiting.until(
            lambda: self._names is not None and handles <= self._names.keys(), left(deadline)
        )
        if (names := self._names) is None:
            raise BvhTimeoutError(f"'{self.name}' sent no names within {timeout:g} s")
        return {handle: names[handle] for handle in sorted(handles) if handle in names}

    def _receive_names(self, status: DiagnosticStatus) -> None:
        self._names = {int(pair.key): pair.value for pair in status.values}

    def publishers_of_names(self) -> tuple[str, frozenset[bytes]]:
        """Return the topic of names and its publishers; '' and none while there are none.

        The handles in a view are those of the node, which publishes names under its own name
        only. A node that is started again has another publisher.
        """
        for owner in (self.name, self.name.rpartition('/')[0]):
            topic = f'{owner}/names'
            found = self._node.get_publishers_info_by_topic(topic) if owner else ()
            publishers = [bytes(one.endpoint_gid) for one in found if one.topic_type == NAMES_TYPE]
            if publishers:
                return topic, frozenset(publishers)
        return '', frozenset()

    def parameters(self, names: Sequence[str], timeout: float) -> list[Any]:
        """Return the values of parameters of the node; '/a/bvh' of a view '/a/bvh/view'."""
        deadline = time.monotonic() + timeout
        owner = self.publishers_of_names()[0].rpartition('/')[0]
        client = self._node.create_client(
            GetParameters, f'{owner}/get_parameters', callback_group=self._waiting.group
        )
        service = _Service(self._waiting, client, None, PARAMETERS_PATIENCE)
        request = GetParameters.Request(names=[*names])
        try:
            if not self._waiting.until(client.service_is_ready, timeout):
                raise BvhTimeoutError(f'no {client.srv_name} after {timeout:g} s')
            # A reply is lost if the service has not discovered its client within 0.1 s, as happens
            # under load (ros2/rmw_fastrtps#842). So this, too, is sent again.
            call = _Call(service, request, lambda reply: [*reply.values], None)
            values: list[Any] = self._waiting.result(call, left(deadline))
            return values
        finally:
            self._waiting.remove_client(client)
            self._node.destroy_client(client)


class _Service:
    """A service, and its best-effort twin where it has one."""

    def __init__(
        self,
        waiting: Waiting,
        reliable: Client,
        twin: Client | None,
        patience: float | None = None,
    ) -> None:
        self.waiting, self.reliable, self.twin = waiting, reliable, twin
        self.patience = Patience() if patience is None else Patience(patience)
        self.held_up_until = -math.inf
        """On the monotonic clock: until when a lost reply holds up the reliable ones."""
        waiting.add_client(reliable)


class _Call(Question):
    """A question to a service: one request is reliable, the others go to its twin.

    Asking the same service again does not help: it delivers in order, so a lost reply holds up
    the later ones until the next heartbeat.
    """

    def __init__(
        self,
        service: _Service,
        request: Any,
        read: Callable[[Any], Any],
        executor: Executor | None,
        work: float = 0.0,
    ) -> None:
        super().__init__(service.reliable.srv_name, service.patience, executor)
        self._service, self._request, self._read = service, request, read
        self._work = work
        self._requests: list[tuple[Client, Future]] = []
        held_up = time.monotonic() < service.held_up_until
        twin = service.twin if held_up else None
        self._reliable = LATE if twin is not None and twin.service_is_ready() else 0

    def ask(self, number: int) -> float:
        """Send the request for the n-th time."""
        service, client = self._service, self._service.reliable
        if number != self._reliable and service.twin is not None:
            client = service.twin
            if not client.service_is_ready():
                return 0.0
            service.waiting.add_client(client)
        began = time.monotonic()
        reply = client.call_async(self._request)
        self._requests.append((client, reply))

        def settle(reply: Future) -> None:
            if reply.cancelled():
                return
            is_first = self.settle(lambda: self._read(reply.result()), began, self._work)
            if is_first and number > self._reliable:
                service.held_up_until = time.monotonic() + HEARTBEAT

        reply.add_done_callback(settle)
        return self._work

    def forget(self) -> None:
        """Expect no reply any more."""
        for client, reply in self._requests:
            if not reply.done():
                client.remove_pending_request(reply)


class _Topic:
    """A topic of questions and that of their answers, which bear the stamps of the questions."""

    def __init__(self, node: Node, name: str, kind: str, waiting: Waiting) -> None:
        self.kind = KINDS[kind]
        topic = self.kind.questions
        self.name = f"'{name}/{topic}'"
        self.patience = Patience()
        self.open: dict[int, _BatchQuestion] = {}
        """The questions that wait for answers, by their stamps (ns)."""
        self.is_heard = False
        """Whether both sides hear each other: that they are discovered here does not say it."""
        self._node = node
        self._publisher = node.create_publisher(self.kind.message, f'{name}/{topic}', LATEST)
        self._hello = self.kind.message()
        self._hello.header.stamp = Time(nanoseconds=self.new_stamp()).to_msg()
        # A lost message holds up the reliable subscription until a heartbeat, not the other one.
        for qos in (REQUESTS, REPEATED_REPLIES):
            subscription = node.create_subscription(
                PointCloud2,
                f'{name}/{self.kind.answers}',
                self._receive,
                qos,
                callback_group=waiting.group,
            )
            waiting.add_subscription(subscription)

    def publish(self, message: Any) -> bool:
        """Publish a message once both sides hear each other, else a message without a row."""
        self._publisher.publish(message if self.is_heard else self._hello)
        return self.is_heard

    def new_stamp(self, near: int | None = None) -> int:
        """Return a stamp (ns) that no other question has, just before `near`, or before now.

        It is random: two clients that ask in one tick of a simulated clock must distinguish
        their answers. Rows count seconds from it, as doubles, so a stamp near their times keeps
        their nanoseconds.
        """
        jitter = JITTER if near is None else TIME_JITTER
        latest = self._node.get_clock().now().nanoseconds if near is None else near
        while True:
            stamp = int(max(latest, jitter) - random.randrange(jitter))
            if stamp not in self.open:
                return stamp

    def _receive(self, cloud: PointCloud2) -> None:
        stamp = nanoseconds(cloud.header.stamp)
        if stamp == nanoseconds(self._hello.header.stamp) and not self.is_heard:
            self.is_heard = True
            for question in [*self.open.values()]:
                question.ask_anew()
        # What is not here is another client's, or not the first answer.
        waiting = self.open.get(stamp)
        if waiting is not None:
            self.is_heard = True
            waiting.receive(cloud)


class _BatchQuestion(Question):
    """A message of questions."""

    def __init__(self, topic: _Topic, message: Any, executor: Executor | None) -> None:
        super().__init__(topic.name, topic.patience, executor)
        self._topic, self._message = topic, message
        self._stamp = nanoseconds(message.header.stamp)
        self._rows = len(message.poses) if isinstance(message, Path) else message.width
        self._work = self._rows * topic.kind.work
        self._began = 0.0
        topic.open[self._stamp] = self

    def ask(self, number: int) -> float:
        """Publish the message."""
        if not self._topic.publish(self._message):
            return 0.0
        self._began = time.monotonic()
        return self._work

    def receive(self, cloud: PointCloud2) -> None:
        """Settle the question by an answer."""
        self.settle(lambda: self._read(cloud), self._began, self._work)

    def _read(self, cloud: PointCloud2) -> Any:
        kind = self._topic.kind.kind
        try:
            hits = read_answers(cloud, kind)
        except ValueError as error:
            off = ': path_between of the node is off' if kind is PathHits else ''
            raise BvhError(f'the reply cannot be read: {error}{off}') from None
        rows = len(hits.obstacles)
        if rows != self._rows or (rows and (hits.obstacles == UNANSWERED).all()):
            raise NoRowAnsweredError(
                f'{self._topic.name} cannot answer: its rows are at fault, or what they need is '
                'being compiled on first use; the log and diagnostics of the node say which'
            )
        return hits

    def forget(self) -> None:
        """Expect no answer any more."""
        self._topic.open.pop(self._stamp, None)

    def drop(self) -> None:
        """Wait no longer; make sure of the node again before the next question."""
        if not self.answer.done():
            self._topic.is_heard = False
        super().drop()
