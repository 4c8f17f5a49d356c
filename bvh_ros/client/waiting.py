# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Waiting for an answer, whoever spins the node, or nobody."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.client import Client
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidHandle
from rclpy.guard_condition import GuardCondition
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.timer import Timer

from bvh_ros.client.asking import LEAST, Question
from bvh_ros.client.errors import BvhError, BvhTimeoutError
from bvh_ros.ros.private_rclpy import WaitSet

LOOK = 0.1  # seconds between two looks whether the context lives
POLL = 0.02  # seconds between two looks for the node


class Waiting:
    """Waits for futures by taking their answers from the middleware, as an executor would.

    Whether somebody spins the node cannot be known: `rclpy.spin_once` leaves the node with an
    executor that nobody spins, and the thread that waits may be the one that should spin. So the
    node's executor is left alone. If it runs, either of the two takes an answer, and gives it to
    the same future.
    """

    def __init__(self, node: Node, group: CallbackGroup) -> None:
        self._node = node
        self._group = group
        self._clients: list[Client] = []
        self._subscriptions: list[Subscription] = []
        self._watched: dict[Future, tuple[Question, float]] = {}
        self._timer: Timer | None = None

    def add_client(self, client: Client) -> None:
        """Take the replies to this one while waiting."""
        if client not in self._clients:
            self._clients.append(client)

    def remove_client(self, client: Client) -> None:
        """Leave its replies alone; it is about to be destroyed."""
        self._clients.remove(client)

    def add_subscription(self, subscription: Subscription) -> None:
        """Take the messages of this one while waiting."""
        self._subscriptions.append(subscription)

    def check(self) -> None:
        """Raise BvhError if nothing can be asked any more."""
        if not self._node.context.ok():
            raise BvhError('rclpy is shut down')
        try:
            with self._node.handle:
                pass
        except InvalidHandle:
            raise BvhError('the node is destroyed') from None

    def until(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Return whether something became true within `timeout` seconds; BvhError as below."""
        deadline = time.monotonic() + timeout
        while True:
            self.check()
            if condition():
                return True
            if time.monotonic() > deadline:
                return False
            time.sleep(POLL)

    def until_done(self, answer: Future, timeout: float, question: Question | None = None) -> bool:
        """Return whether the answer came within `timeout` seconds, in which the question is asked
        again.

        Raises
        ------
        BvhError
            If rclpy is shut down.
        """
        deadline = time.monotonic() + timeout
        self.check()
        taken_by_others = GuardCondition(None, None, context=self._node.context)
        answer.add_done_callback(lambda _answer: taken_by_others.trigger())
        while not answer.done() and (left := deadline - time.monotonic()) > 0.0:
            due = LOOK if question is None else question.ask_if_due()
            self._take_what_comes(taken_by_others, min(left, due, LOOK))
            self.check()
        return bool(answer.done())

    def ask_again(self, answer: Future, question: Question, timeout: float) -> None:
        """Ask until the answer comes, by a timer of the node, for `timeout` seconds at most."""
        self._watched[answer] = question, time.monotonic() + timeout
        if self._timer is None:
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self._timer = self._node.create_timer(LEAST, self._look, self._group, steady)
        elif self._timer.is_canceled():
            self._timer.reset()
            if self._node.executor is not None:
                self._node.executor.wake()

    def _look(self) -> None:
        for answer, (question, end) in [*self._watched.items()]:
            if answer.done() or answer.cancelled() or time.monotonic() > end:
                self._watched.pop(answer, None)
            else:
                question.ask_if_due()
        if self._timer is not None and not self._watched:
            self._timer.cancel()
            if self._watched:  # another thread has asked meanwhile
                self._timer.reset()

    def _take_what_comes(self, wake: GuardCondition, timeout: float) -> None:
        clients, subscriptions = [*self._clients], [*self._subscriptions]
        with ExitStack() as kept:
            for entity in (*clients, *subscriptions, wake, self._node.context):
                kept.enter_context(entity.handle)
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
            ready = {*wait_set.get_ready_entities('client')}
            told = {*wait_set.get_ready_entities('subscription')}
            for client in clients:
                if client.handle.pointer in ready:
                    _take_reply(client)
            for subscription in subscriptions:
                if subscription.handle.pointer in told:
                    _take_message(subscription)
        executor = self._node.executor
        if (ready or told) and executor is not None:
            executor.wake()  # what was taken may be what a coroutine there awaits


class Pending:
    """Something that was asked, and whose answer is waited for.

    Parameters
    ----------
    whom : str
        Who was asked, for people.
    forget : callable
        Is called when nobody waits any more.
    question : Question, optional
        Is asked again while the answer is waited for.
    """

    def __init__(
        self,
        waiting: Waiting,
        answer: Future,
        whom: str,
        forget: Callable[[Future], None],
        question: Question | None = None,
    ) -> None:
        self._waiting = waiting
        self._answer = answer
        self.whom = whom
        self._forget = forget
        self._question = question

    def is_done(self, timeout: float) -> bool:
        """Return whether the answer came within `timeout` seconds; BvhError if it never can."""
        return self._waiting.until_done(self._answer, timeout, self._question)

    def result(self, timeout: float) -> Any:
        """Wait for the answer; BvhTimeoutError if it does not come within `timeout` seconds."""
        try:
            if not self.is_done(timeout):
                raise BvhTimeoutError(f'{self.whom} did not answer within {timeout:g} s')
            return self._answer.result()
        finally:
            self.forget()

    def forget(self) -> None:
        """Wait for it no longer."""
        if not self._answer.done():
            self._forget(self._answer)
            # Another thread may be about to bring it, or has by now.
            self._answer.add_done_callback(Future.exception)
        else:
            self._answer.exception()  # else rclpy complains that nobody looked at it


def left(deadline: float) -> float:
    """Seconds until a time of `time.monotonic`, not below 0."""
    return max(deadline - time.monotonic(), 0.0)


def results(pending: Sequence[Pending], deadline: float) -> list[Any]:
    """All answers, or the error of the first that has none."""
    try:
        return [one.result(left(deadline)) for one in pending]
    finally:
        for one in pending:
            one.forget()


def _take_reply(client: Client) -> None:
    header, reply = client.handle.take_response(client.srv_type.Response)
    if header is None:
        return  # another thread was faster
    try:
        future = client.get_pending_request(header.request_id.sequence_number)
    except KeyError:
        return  # nobody waits for it any more
    future.set_result(reply)


def _take_message(subscription: Subscription) -> None:
    taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    if taken is not None:
        subscription.callback(taken[0])
