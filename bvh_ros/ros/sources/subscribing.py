# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Subscriptions that follow what publishers offer, and count what is lost."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Collection, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_policy_name_from_kind,
)

from bvh_ros.ros.qos import DEPTH, OVERRIDABLE, Delivery, overrides
from bvh_ros.ros.texts import Seldom

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.qos_overriding_options import QoSOverridingOptions
    from rclpy.subscription import Subscription


class Kind(NamedTuple):
    """What a subscription asks for."""

    reliability: ReliabilityPolicy
    durability: DurabilityPolicy


LATCHED = Kind(ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL)
RELIABLE = Kind(ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
BEST_EFFORT = Kind(ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE)
KINDS = (LATCHED, RELIABLE, BEST_EFFORT)  # each hears all that the ones before it hear
# What every publisher offers.
LEAST = {'reliability': 'best_effort', 'durability': 'volatile'}


def with_overrides(kind: Kind, given: Mapping[str, Any]) -> Kind:
    """Return what to ask for with the user's overrides."""
    reliability, durability = given.get('reliability'), given.get('durability')
    return Kind(
        ReliabilityPolicy[reliability.upper()] if reliability else kind.reliability,
        DurabilityPolicy[durability.upper()] if durability else kind.durability,
    )


def is_latched(kind: Kind) -> bool:
    """Return whether publishers that are heard so keep messages for late joiners."""
    return kind.durability == DurabilityPolicy.TRANSIENT_LOCAL


def unheard(topic: str, policy: str, kind: Kind) -> str:
    """Say that a publisher offers less of a policy than requested, and the two remedies."""
    policy = policy.lower()
    if policy not in LEAST:
        return f'a publisher is not heard: its {policy} is not what is asked for'
    wanted = getattr(kind, policy).name.lower()
    return (
        f'a publisher is not heard: it offers less than the {policy} {wanted} that is asked for. '
        f"Let it publish with {policy} {wanted}, or set this node's parameter "
        f"'qos_overrides.{topic}.subscription.{policy}' to '{LEAST[policy]}'"
    )


# Which messages of a topic's publishers were never heard.
#
# Each publisher numbers its messages from 1. rclpy tells the number of a message, but not whose it
# is. So a number is given to the publisher that was heard last of those it follows directly; where
# it follows none, something is missing. Two publishers that count in step can be mistaken for each
# other: a gap is then seen as soon as the other one speaks.

SPARE = 16  # publishers that are gone already, while what they said still waits


class Heard(NamedTuple):
    """What the number of a message says about those before it."""

    is_new: bool = False  # the first that is heard of its publisher
    unheard: int = 0  # messages of that publisher before
    lost: int = 0  # of a publisher that was heard before


NEXT = Heard()


class Numbering:
    """Follows the numbers of all publishers of one topic."""

    def __init__(self) -> None:
        self._last: list[int] = []  # of each publisher; the one heard last comes last
        self._counts = True

    def note(self, number: int | None, publishers: int) -> Heard:
        """Take notice of a message.

        Parameters
        ----------
        number : int or None
            As its publisher counts; None where the middleware does not tell.
        publishers : int
            How many there are now.
        """
        if number is None:
            # Neither earlier messages are known, nor later losses.
            is_new, self._counts = self._counts, False
            return Heard(is_new, unheard=1) if is_new else NEXT
        for place in range(len(self._last) - 1, -1, -1):
            if self._last[place] == number - 1:
                del self._last[place]
                self._last.append(number)
                return NEXT
        heard = self._irregular(number, publishers)
        self._last.append(number)
        del self._last[: max(len(self._last) - publishers - SPARE, 0)]
        return heard

    def _irregular(self, number: int, publishers: int) -> Heard:
        if number == 1:
            return Heard(is_new=True)
        alive = self._last[-publishers:] if publishers else self._last
        before = [last for last in alive if last < number]
        if len(alive) < publishers or not before:
            return Heard(is_new=True, unheard=number - 1)
        last = max(before)
        self._last.remove(last)
        return Heard(lost=number - last - 1)


# Whether all obstacles of a source are known. Messages that only bring changes leave that open.
#
# All are known after a message that replaces everything: a cloud without ids, a grid, markers
# after a DELETEALL of all namespaces. So they are where publishers are heard from their first
# message on, or keep messages for late joiners. They no longer are once a message is lost, or a
# publisher turns up that has published before, until everything is replaced again.

SETTLED = 0.2  # seconds without a further message: a late joiner has got what was kept for it


class Completeness:
    """Whether a message may be missing, and why."""

    def __init__(self) -> None:
        self._unheard = ''
        self._forgotten = ''
        self._settles = 0.0  # on the monotonic clock; 0: not waited for

    def note(self, heard: Heard, *, latched: bool) -> None:
        """Take notice of how a message follows the others.

        Parameters
        ----------
        latched : bool
            Whether its publisher keeps messages for late joiners.
        """
        if heard.lost:
            self._unheard = f'{heard.lost} of its messages were lost'
        elif latched and (heard.is_new or self._settles):
            self._settles = time.monotonic() + SETTLED
        elif heard.unheard:
            self._unheard = 'it had spoken before it was heard'

    def note_all_known(self) -> None:
        """A message said everything."""
        self._unheard = self._forgotten = ''
        self._settles = 0.0

    def forget(self, reason: str) -> None:
        """Earlier messages are no longer known, or changes since may be missing."""
        self._forgotten = reason

    def missing(self) -> str:
        """Say why not all is known, or return an empty text."""
        if self._settles and time.monotonic() > self._settles:
            self._settles, self._forgotten = 0.0, ''
        settling = 'what it keeps for late joiners is still coming' if self._settles else ''
        return self._unheard or settling or self._forgotten


# Several subscriptions to one topic: each message is taken once and in its publisher's order.
#
# A best-effort subscription hears reliable publishers, too, and rclpy does not say by which
# subscription a message would have come. A message of the weaker subscription is delayed for a
# moment. If it comes by the stronger one as well, that copy counts: it is complete and in order.

DELAY = 0.05  # seconds: on the way, both copies are one packet
REMEMBERED = 10_000  # messages


class Received(NamedTuple):
    """A message, and what the middleware says of it."""

    message: Any
    number: int | None  # by its publisher's count
    latched: bool  # its publisher keeps messages for late joiners


class Merger:
    """Passes each message on once, whichever subscriptions it comes by.

    Parameters
    ----------
    deliver : callable
        Takes a `Received`.
    delay : float
        Of messages of the weaker subscription, s; 0 where the order does not matter.
    """

    def __init__(self, deliver: Callable[[Received], None], delay: float = DELAY) -> None:
        self._deliver = deliver
        self._delay = delay
        self._known: dict[tuple[Any, Any], None] = {}
        self._delayed: dict[tuple[Any, Any], tuple[float, Received]] = {}

    @property
    def is_delaying(self) -> bool:
        """Whether something waits for `release`."""
        return bool(self._delayed)

    def take(self, received: Received, sent: int, *, others_hear: bool, better_hear: bool) -> None:
        """Take a message.

        Parameters
        ----------
        sent : int
            When its publisher sent it, ns: together with the number, whose it is.
        others_hear : bool
            Whether it may come by another subscription, too, or has come by one.
        better_hear : bool
            Whether it is likely to come by one that asks for more.
        """
        if not others_hear:
            self._deliver(received)
            return
        key = sent, received.number
        if key in self._known:
            return
        if better_hear and self._delay:
            self._delayed.setdefault(key, (time.monotonic() + self._delay, received))
            return
        self._delayed.pop(key, None)
        self._pass_on(key, received)

    def release(self) -> None:
        """Pass on messages that were delayed for long enough: no other subscription has them."""
        now = time.monotonic()
        for key, (due, received) in [*self._delayed.items()]:
            if due > now:
                return
            del self._delayed[key]
            self._pass_on(key, received)

    def _pass_on(self, key: tuple[Any, Any], received: Received) -> None:
        self._known[key] = None
        if len(self._known) > REMEMBERED:
            del self._known[next(iter(self._known))]
        self._deliver(received)


# Messages that wait. Every change is needed; of messages that replace everything only the newest.
#
# A publisher of large clouds may be faster than the node, which must not fall behind, nor grow.

TOGETHER = 64  # messages
MOST_WHOLE = 10  # messages that say everything; the newest may yet be refused


class Waiting(NamedTuple):
    """A message that waits."""

    received: Received
    heard: Heard
    is_whole: bool  # replaces all before it


class Backlog:
    """A queue that drops messages that newer ones replace.

    Parameters
    ----------
    says_everything : callable
        Whether a message replaces all before it.
    joins : callable
        Whether a waiting message may be handed over with those before it.
    """

    def __init__(
        self, says_everything: Callable[[Any], bool], joins: Callable[[Waiting], bool]
    ) -> None:
        self.superseded = 0
        self._says_everything = says_everything
        self._joins = joins
        self._waiting: deque[Waiting] = deque()
        self._whole = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, received: Received, heard: Heard) -> None:
        """Append a message, and what its number says about those before it."""
        self._waiting.append(Waiting(received, heard, self._says_everything(received.message)))
        self._whole += self._waiting[-1].is_whole
        while self._whole > MOST_WHOLE or (
            self._whole == MOST_WHOLE and not self._waiting[0].is_whole
        ):
            self.superseded += 1
            self._take()

    def next(self) -> list[Waiting]:
        """Take out the oldest message and those that join it."""
        some = [self._take()]
        while self._waiting and len(some) < TOGETHER and self._joins(self._waiting[0]):
            some.append(self._take())
        return some

    def _take(self) -> Waiting:
        first = self._waiting.popleft()
        self._whole -= first.is_whole
        return first


# A busy topic is looked at every few milliseconds; not every message wakes the node.

REST = 0.01  # seconds, in which many small messages come for one round of the executor
BUSY = 0.002  # seconds between messages


class Resting:
    """Lets a busy topic's subscriptions wake no executor, and looks at them by a timer.

    An executor that does not know `resting`, a set of entities to leave out, goes on being woken.

    Parameters
    ----------
    subscriptions : collection of rclpy.subscription.Subscription
        As they are at any time.
    take : callable
        Takes and hands over what waits; returns how many messages that were.
    """

    def __init__(
        self, node: Node, subscriptions: Collection[Subscription], take: Callable[[], int]
    ) -> None:
        self._node = node
        self._subscriptions = subscriptions
        self._take = take
        self._woken = -1.0  # when, s
        self._asleep: set[Subscription] | None = None  # what the executor leaves out
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(REST, self._look, clock=steady, autostart=False)

    def woken(self) -> None:
        """Take notice that the executor was woken for a message; sleep if that comes often."""
        last, self._woken = self._woken, time.perf_counter()
        if self._woken - last < BUSY:
            self._asleep = getattr(self._node.executor, 'resting', None)
            if self._asleep is not None:
                self._asleep.update(self._subscriptions)
                self._timer.reset()

    def catch_up(self) -> None:
        """Take what waits, before a query."""
        if self._asleep is not None:
            self._take()

    def wake(self) -> None:
        """Be woken by each message again."""
        if self._asleep is not None:
            self._asleep.difference_update(self._subscriptions)
            self._asleep = None
            self._timer.cancel()

    def destroy(self) -> None:
        """End for good, before the subscriptions do."""
        self.wake()
        self._node.destroy_timer(self._timer)

    def _look(self) -> None:
        if self._take() < 2:
            self.wake()


# A subscription that follows what the publishers offer, and counts what is lost.

TURN = 0.01  # seconds after which others get a turn
SMALL = 4096  # bytes of messages that may be handed over together


class FollowingSubscription:
    """Subscribes as the publishers offer, each of them as well as it does.

    A reliable subscription never hears a best-effort publisher, nor one that asks for what was
    kept for late joiners a publisher that keeps nothing. So there is one for each kind; that for
    best effort only while a publisher offers no more.

    A callback takes and hands over all that waits, for as long as a turn may take: an executor's
    round costs more than a small message does.

    Parameters
    ----------
    callback : callable
        Takes a message, or its bytes, in a list; with it those that may be handed over together.
    on_irregular : callable, optional
        Takes what a message's number says about those before, where it does not just follow, and
        whether its publisher keeps messages for late joiners; called before `callback`.
    says_everything : callable, optional
        Whether a message needs none of those before it: of such, few may wait. None: no message
        does.
    is_full : callable, optional
        Whether messages have to wait here; `resume` says when no longer.

    Raises
    ------
    ValueError
        If a QoS override makes no sense.
    """

    def __init__(
        self,
        node: Node,
        message_type: type,
        topic: str,
        callback: Callable[[list[Any]], None],
        delivery: Delivery,
        *,
        on_irregular: Callable[[Heard, bool], None] = lambda _heard, _latched: None,
        says_everything: Callable[[Any], bool] | None = None,
        is_full: Callable[[], bool] = lambda: False,
    ) -> None:
        self._node = node
        self._message_type = message_type
        self._callback = callback
        self._on_irregular = on_irregular
        self._is_full = is_full
        self._raw, self._together = delivery.raw, delivery.together
        self.topic = node.resolve_topic_name(topic)
        self.incompatible = ''  # why a publisher is not heard, and the remedy
        self.lost = 0  # messages
        self._losses = Seldom(lambda text: node.get_logger().warning(text))
        self._numbering = Numbering()
        self._merger = Merger(self._deliver, DELAY if delivery.ordered else 0.0)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._release_timer = node.create_timer(
            DELAY / 2, self._release, clock=steady, autostart=False
        )
        # Subscriptions come and go outside of their own events' callbacks.
        self._change = node.create_guard_condition(self.check)
        self._supersedes = says_everything is not None
        self._backlog = Backlog(says_everything or (lambda _message: False), self._joins)
        self._more = node.create_guard_condition(self._hand_over_some)
        self._is_handing_over = False
        given = overrides(node, self.topic)
        wanted = with_overrides(LATCHED if delivery.latched else RELIABLE, given)
        self._wanted = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=delivery.depth)
        self._subscriptions: dict[Kind, Subscription] = {}
        self._resting = Resting(node, self._subscriptions.values(), self._take_what_waits)
        self._create(wanted, OVERRIDABLE)  # rclpy writes the user's depth into the profile
        self._follows = delivery.follow and wanted.reliability == ReliabilityPolicy.RELIABLE
        if wanted == LATCHED and self._follows and 'durability' not in given:
            self._create(RELIABLE)

    def check(self) -> None:
        """Subscribe best effort, too, as long as a publisher offers no more; warn of losses.

        To be called about once a second.
        """
        self._losses.log()
        offered = {
            info.qos_profile.reliability
            for info in self._node.get_publishers_info_by_topic(self.topic)
        }
        if not (self._follows and offered):
            return
        wanted = ReliabilityPolicy.BEST_EFFORT in offered
        if wanted == (BEST_EFFORT in self._subscriptions):
            return
        log = self._node.get_logger().info
        if wanted:
            log(f'{self.topic}: subscribing best effort, too, as a publisher offers no more')
            self._create(BEST_EFFORT)
        else:
            log(f'{self.topic}: nobody publishes best effort any more')
            self._take_the_rest(BEST_EFFORT, math.inf)
            self.resume()
            self._resting.wake()
            self._node.destroy_subscription(self._subscriptions.pop(BEST_EFFORT))

    def destroy(self) -> None:
        """Listen no longer."""
        self._resting.destroy()
        for subscription in self._subscriptions.values():
            self._node.destroy_subscription(subscription)
        self._subscriptions.clear()
        self._node.destroy_timer(self._release_timer)
        self._node.destroy_guard_condition(self._change)
        self._node.destroy_guard_condition(self._more)

    def resume(self) -> None:
        """Hand over what waits, soon, unless it has to wait still."""
        if self._backlog and not self._is_handing_over and not self._is_full():
            self._more.trigger()

    def catch_up(self) -> None:
        """Take what waits, before a query; usually the executor's rounds have done so."""
        self._resting.catch_up()

    def publishers(self) -> int:
        """Return how many publishers there are, heard or not."""
        return int(self._node.count_publishers(self.topic))

    def figures(self) -> dict[str, object]:
        """Return how publishers are heard and what was lost, as /diagnostics shows it."""
        counts = self._counts()
        kinds = [kind for kind, count in counts.items() if count] or [*counts]
        figures: dict[str, object] = {
            'reliability': kinds[0].reliability.name.lower(),
            'durability': kinds[0].durability.name.lower(),
            'messages lost': self.lost,
        }
        if self._supersedes:
            figures['messages that newer ones replaced'] = self._backlog.superseded
        return figures

    def _create(self, kind: Kind, overriding: QoSOverridingOptions | None = None) -> None:
        history, depth = self._wanted.history, self._wanted.depth
        qos = QoSProfile(
            history=history, depth=depth, reliability=kind.reliability, durability=kind.durability
        )
        if overriding is not None:
            self._wanted = qos
        self._subscriptions[kind] = self._node.create_subscription(
            self._message_type,
            self.topic,
            partial(self._receive, kind),
            qos,
            raw=self._raw,
            event_callbacks=SubscriptionEventCallbacks(
                incompatible_qos=partial(self._on_incompatible, kind)
            ),
            qos_overriding_options=overriding,
        )

    def _receive(self, kind: Kind, message: Any, info: dict[str, Any]) -> None:
        self._take(kind, message, info)
        self._take_what_waits()
        if self._together:
            self._resting.woken()

    def _take_what_waits(self) -> int:
        """Take and hand over what waits; return how many messages came."""
        # A newer message may replace those that wait: it has to be taken first.
        limit = math.inf if self._supersedes else TURN
        taken = sum(self._take_the_rest(kind, limit) for kind in self._subscriptions)
        self._hand_over_some()
        return taken

    def _take(self, kind: Kind, message: Any, info: dict[str, Any]) -> None:
        received = Received(message, info['publication_sequence_number'], is_latched(kind))
        counts = self._counts()
        place = KINDS.index(kind) if kind in KINDS else 0
        self._merger.take(
            received,
            info['source_timestamp'],
            # By count: a publisher may have ended while its messages still wait.
            others_hear=len(counts) > 1,
            better_hear=any(counts.get(other) for other in KINDS[:place]),
        )
        if self._merger.is_delaying and self._release_timer.is_canceled():
            self._release_timer.reset()

    def _release(self) -> None:
        self._merger.release()
        if not self._merger.is_delaying:
            self._release_timer.cancel()
        self._hand_over_some()

    def _deliver(self, received: Received) -> None:
        publishers = max(self._counts().values(), default=0)
        heard = self._numbering.note(received.number, publishers)
        if heard.lost:
            self.lost += heard.lost
            self._losses.add(
                f'{self.topic}: {self.lost} messages were lost in all; they came faster than they '
                'were taken, or on a connection that loses some',
                heard.lost,
            )
        self._backlog.add(received, heard)

    def _hand_over_some(self) -> None:
        """Hand over what waits until the turn is over, and go on after others had theirs."""
        end = time.perf_counter() + TURN
        self._is_handing_over = True
        try:
            while self._backlog and not self._is_full() and time.perf_counter() < end:
                self._hand_over(self._backlog.next())
        finally:
            self._is_handing_over = False
            self.resume()

    def _joins(self, one: Waiting) -> bool:
        return self._together and one.heard is NEXT and len(one.received.message) <= SMALL

    def _hand_over(self, some: list[Waiting]) -> None:
        if some[0].heard is not NEXT:
            self._on_irregular(some[0].heard, some[0].received.latched)
        self._callback([one.received.message for one in some])

    def _take_the_rest(self, kind: Kind, limit: float) -> int:
        """Take what already waits, for so many seconds; return how many messages that were."""
        handle = self._subscriptions[kind].handle
        end = time.perf_counter() + limit
        most = (self._wanted.depth or DEPTH) - len(self._backlog)
        for count in range(most):
            with handle:
                taken = handle.take_message(self._message_type, self._raw)
            if taken is None:
                return count
            self._take(kind, *taken)
            if time.perf_counter() >= end:
                return count + 1
        return max(most, 0)

    def _counts(self) -> dict[Kind, int]:
        """How many publishers each subscription hears."""
        return {kind: one.get_publisher_count() for kind, one in self._subscriptions.items()}

    def _on_incompatible(self, kind: Kind, event: Any) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        if kind == LATCHED and RELIABLE in self._subscriptions:
            return  # that one hears publishers that keep nothing
        if self._follows and policy == 'RELIABILITY':
            self._change.trigger()
            return
        self.incompatible = unheard(self.topic, policy, kind)
        self._node.get_logger().warning(f'{self.topic}: {self.incompatible}')
