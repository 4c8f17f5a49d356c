# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Waiting for answers, and asking again until they come: packets get lost on a bad link."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from threading import Lock
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor
from rclpy.guard_condition import GuardCondition
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.timer import Timer

from bvh_ros.client.messages import BvhError, BvhTimeoutError
from bvh_ros.ros.private_rclpy import WaitSet
from bvh_ros.ros.qos import REPEATED

LEAST = 0.02  # seconds between the first request and the second one, ...
MOST = 0.5  # ... at least and at most
GROWTH = 1.5  # of this time, from one request to the next, ...
GROWN = 0.2  # ... up to so many seconds, where it is not longer anyway
POLL = 0.02  # seconds between two looks at what wakes no thread
LOOK = 0.1  # seconds between two looks whether the context lives


class Patience:
    """Seconds after which an answer counts as lost: the retransmission timer of RFC 6298.

    It follows the times in which answers have come, so that a busy node does not get the same
    question again and again while its answers are only late.
    """

    def __init__(self, least: float = LEAST) -> None:
        self._least = least
        self._mean = self._deviation = 0.0
        self._latest_request = self._latest_answer = 0.0  # of the latest answer, monotonic

    @property
    def seconds(self) -> float:
        """How long to wait before the second request."""
        return min(max(self._mean + 4.0 * self._deviation, self._least), MOST)

    def since(self, request: float) -> float:
        """Return when waiting for the answer to a request began: when the latest answer to an
        earlier request came, as requests wait in a queue. A later one is no reason to wait.
        """
        return max(request, self._latest_answer if self._latest_request < request else 0.0)

    def learn(self, request: float, work: float = 0.0) -> None:
        """Take into account that the answer to a request came now, after some work besides."""
        now = time.monotonic()
        seconds = max(now - request - work, 0.0)
        self._latest_request, self._latest_answer = request, now
        if self._mean == 0.0:
            self._mean, self._deviation = seconds, 0.5 * seconds
        self._deviation += (abs(seconds - self._mean) - self._deviation) / 4.0
        self._mean += (seconds - self._mean) / 8.0


class Question:
    """A question that is sent again until its first answer comes.

    Parameters
    ----------
    name : str
        The service or topic, for people.
    patience : Patience
        Of the questions of this kind.
    executor : rclpy.executors.Executor, optional
        Runs the callbacks of the answer; without one, the thread that brings the answer does.
    """

    def __init__(self, name: str, patience: Patience, executor: Executor | None = None) -> None:
        self.name = name
        self.answer = Future(executor=executor)
        self._patience = patience
        self._count, self._wait_for, self._asked_at = 0, 0.0, -math.inf
        self._first = Lock()

    def ask(self, number: int) -> float:
        """Send the request for the n-th time, from 0; return the seconds that its answer may take
        besides.
        """
        raise NotImplementedError

    def forget(self) -> None:
        """Expect no answer any more."""
        raise NotImplementedError

    def ask_if_due(self) -> float:
        """Ask, if it is time to; return the seconds until the next time."""
        if (wait := self.seconds_left()) > 0.0:
            return wait
        least = self._patience.seconds
        wait = min(least * GROWTH ** min(self._count, 99), max(least, GROWN))
        self._count += 1
        self._asked_at = time.monotonic()
        self._wait_for = wait + self.ask(self._count - 1)
        return self._wait_for

    def seconds_left(self) -> float:
        """Return the seconds until it is time to ask; 0 or less: now."""
        return self._patience.since(self._asked_at) + self._wait_for - time.monotonic()

    def ask_anew(self) -> None:
        """Ask at once, as if for the first time."""
        self._count, self._wait_for, self._asked_at = 0, 0.0, -math.inf

    def settle(self, result: Callable[[], Any], request: float, work: float = 0.0) -> bool:
        """Set the answer, or the error that making it raises; False if there is one already.

        Parameters
        ----------
        request, work : float
            When it was sent, on the monotonic clock, and the seconds that the answer may take
            besides.
        """
        if not self._first.acquire(blocking=False):
            return False
        self._patience.learn(request, work)
        self.forget()
        try:
            self.answer.set_result(result())
        except Exception as error:
            self.answer.set_exception(error)
        return True

    def drop(self) -> None:
        """Wait for the answer no longer."""
        if not self.answer.done():
            self.forget()
        # Else rclpy complains about an error that was never read.
        self.answer.add_done_callback(Future.exception)


class Waiting:
    """Waits for answers by taking them from the middleware, as an executor would.

    Whether a thread spins the node cannot be known: `rclpy.spin_once` leaves the node with an
    executor that no thread spins, and the waiting thread may be the one that should spin. So the
    node's executor is left alone. If it runs, either of the two takes an answer, and gives it to
    the same future.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.group = ReentrantCallbackGroup()
        """Of all entities: a callback that awaits an answer keeps the group it is in busy."""
        self._clients: list[Client] = []
        self._subscriptions: list[Subscription] = []
        self._watched: dict[Question, float] = {}
        self._timer: Timer | None = None

    def add_client(self, client: Client) -> None:
        """Take the replies to this client while waiting."""
        if client not in self._clients:
            self._clients.append(client)

    def remove_client(self, client: Client) -> None:
        """Leave its replies alone; it is about to be destroyed."""
        self._clients.remove(client)

    def add_subscription(self, subscription: Subscription) -> None:
        """Take the messages of this subscription while waiting."""
        self._subscriptions.append(subscription)

    def until(
        self, condition: Callable[[], bool], timeout: float, questions: Sequence[Question] = ()
    ) -> bool:
        """Return whether a condition holds within `timeout` seconds; ask the questions meanwhile.

        Raises
        ------
        BvhError
            If rclpy is shut down, or the node destroyed.
        """
        deadline = time.monotonic() + timeout
        self.require_life()
        if condition():
            return True
        wake = GuardCondition(None, None, context=self._node.context)
        for question in questions:
            question.answer.add_done_callback(lambda _: wake.trigger())
        while (left := deadline - time.monotonic()) > 0.0:
            waits = [each.ask_if_due() for each in questions if not each.answer.done()]
            with suppress(InvalidHandle):  # another thread has destroyed a client meanwhile
                self._take_what_comes(wake, min(left, LOOK if questions else POLL, *waits))
            self.require_life()
            if condition():
                return True
        return False

    def result(self, question: Question, timeout: float) -> Any:
        """Wait for an answer; BvhTimeoutError if it does not come within `timeout` seconds."""
        return self.results([question], timeout)[0]

    def results(self, questions: Sequence[Question], timeout: float) -> list[Any]:
        """Ask at once, and return all answers, or raise the error of the first without one."""
        try:
            self.until(lambda: all(each.answer.done() for each in questions), timeout, questions)
            results = []
            for question in questions:
                if not question.answer.done():
                    raise BvhTimeoutError(f'{question.name} did not answer within {timeout:g} s')
                results.append(question.answer.result())
            return results
        finally:
            for question in questions:
                question.drop()

    def keep_asking(self, question: Question, timeout: float) -> Future:
        """Ask until the answer comes, by a timer of the node, for `timeout` seconds at most."""
        question.ask_if_due()
        self._watched[question] = time.monotonic() + timeout
        if self._timer is None:
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self._timer = self._node.create_timer(LEAST, self._look, self.group, steady)
        elif self._timer.is_canceled():
            self._timer.reset()
            if self._node.executor is not None:
                self._node.executor.wake()
        return question.answer

    def _look(self) -> None:
        for question, end in [*self._watched.items()]:
            answer = question.answer
            if answer.done() or answer.cancelled() or time.monotonic() > end:
                self._watched.pop(question, None)
        due = [question for question in [*self._watched] if question.seconds_left() <= 0.0]
        for question in due[: REPEATED.depth]:  # the node would lose more
            question.ask_if_due()
        if self._timer is not None and not self._watched:
            self._timer.cancel()
            if self._watched:  # another thread has added a question meanwhile
                self._timer.reset()

    def require_life(self) -> None:
        """Raise BvhError if rclpy is shut down, or the node destroyed."""
        if not self._node.context.ok():
            raise BvhError('rclpy is shut down')
        try:
            with self._node.handle:
                pass
        except InvalidHandle:
            raise BvhError('the node is destroyed') from None

    def _take_what_comes(self, wake: GuardCondition, timeout: float) -> None:
        clients, subscriptions = [*self._clients], [*self._subscriptions]
        with ExitStack() as handles:
            for entity in (*clients, *subscriptions, wake, self._node.context):
                handles.enter_context(entity.handle)
            wait_set = WaitSet(
                len(subscriptions), 1, 0, len(clients), 0, 0, self._node.context.handle
            )
            wait_set.clear_entities()
            wait_set.add_guard_condition(wake.handle)
            for client in clients:
                wait_set.add_client(client.handle)
            for subscription in subscriptions:
                wait_set.add_subscription(subscription.handle)
            wait_set.wait(int(1e9 * timeout))
            replies = {*wait_set.get_ready_entities('client')}
            messages = {*wait_set.get_ready_entities('subscription')}
            for client in clients:
                if client.handle.pointer in replies:
                    _take_reply(client)
            for subscription in subscriptions:
                if subscription.handle.pointer in messages:
                    _take_message(subscription)
        executor = self._node.executor
        if (replies or messages) and executor is not None:
            executor.wake()  # a coroutine there may await what was taken


def left(deadline: float) -> float:
    """Seconds until a time of `time.monotonic`, not below 0."""
    return max(deadline - time.monotonic(), 0.0)


def _take_reply(client: Client) -> None:
    header, reply = client.handle.take_response(client.srv_type.Response)
    if header is None:
        return  # another thread was faster
    try:
        future = client.get_pending_request(header.request_id.sequence_number)
    except KeyError:
        return  # no call waits for it any more
    future.set_result(reply)


def _take_message(subscription: Subscription) -> None:
    taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    if taken is not None:
        subscription.callback(taken[0])
