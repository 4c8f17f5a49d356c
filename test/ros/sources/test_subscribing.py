# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A subscription: what it hears, and what the numbers of messages tell: what is missing, what is
heard twice, and what waits.
"""

import math
import os
import random
import time

import pytest
import rclpy
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from ros.messages import marker
from ros.patience import PATIENCE, spin_until
from visualization_msgs.msg import Marker, MarkerArray

from bvh_ros.ros.access import DEPTH, Delivery
from bvh_ros.ros.node import SturdyExecutor
from bvh_ros.ros.sources import subscribing
from bvh_ros.ros.sources.subscribing import (
    DELAY,
    MOST_WHOLE,
    NEXT,
    SETTLED,
    TOGETHER,
    Backlog,
    Completeness,
    FollowingSubscription,
    Heard,
    Merger,
    Numbering,
    Received,
)

NEW = Heard(is_new=True)
DEEP = QoSProfile(depth=DEPTH)
LATCHED_DEEP = QoSProfile(depth=DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.mark.parametrize(
    ('numbers', 'publishers', 'last'),
    [
        ([1], 1, NEW),
        ([1, 2, 3], 1, NEXT),
        ([1, 2, 5], 1, Heard(lost=2)),
        ([7], 1, Heard(is_new=True, unheard=6)),
        ([7, 8], 1, NEXT),
        ([1, 1, 2, 2, 3], 2, NEXT),
        ([1, 2, 1, 2, 9], 2, Heard(lost=6)),
        ([1, 2, 40], 2, Heard(is_new=True, unheard=39)),
        ([1, 2, 3, 1, 5], 1, Heard(lost=3)),  # of the one that is still there
        ([None], 1, Heard(is_new=True, unheard=1)),
        ([None, None], 1, NEXT),
    ],
)
def test_numbers(numbers, publishers, last):
    numbering = Numbering()
    heard = [numbering.note(number, publishers) for number in numbers]
    assert heard[-1] == last


def test_every_gap_of_many_publishers_is_counted():
    """Losses anywhere but at the end, publishers interleaved at random, by brute force."""
    chance = random.Random(1)
    for publishers in (1, 2, 5):
        numbering, lost, found = Numbering(), 0, 0
        sent = [0] * publishers
        for _ in range(2000):
            who = chance.randrange(publishers)
            sent[who] += 1
            if sent[who] > 1 and chance.random() < 0.05:
                lost += 1
                continue
            found += numbering.note(sent[who], publishers).lost
        for who in range(publishers):  # each speaks once more
            found += numbering.note(sent[who] + 1, publishers).lost
        assert found == lost


def test_what_is_missing_until_all_is_told(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(subscribing.time, 'monotonic', lambda: now[0])
    told = Completeness()
    told.note(NEW, latched=False)
    assert told.missing() == ''
    told.note(Heard(lost=3), latched=False)
    assert told.missing() == '3 of its messages were lost'
    told.note(NEW, latched=False)  # another publisher does not mend it
    assert told.missing()
    told.note_all_known()
    assert told.missing() == ''
    told.forget('paused')
    told.note(Heard(is_new=True, unheard=5), latched=True)
    assert 'still coming' in told.missing()
    now[0] += 2 * SETTLED
    assert told.missing() == ''
    told.note(Heard(is_new=True, unheard=5), latched=False)
    assert told.missing() == 'it had spoken before it was heard'


def test_two_copies_are_one_and_the_better_one_orders(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(subscribing.time, 'monotonic', lambda: now[0])
    out = []
    merger = Merger(lambda told: out.append(told.message))

    def take(message, number, *, better):
        one = Received(message, number, latched=False)
        merger.take(one, 1000 + number, others_hear=True, better_hear=better)

    take('second, early', 2, better=True)
    take('first', 1, better=False)
    take('second', 2, better=False)
    take('second, late', 2, better=True)
    take('from another', 7, better=True)
    merger.release()
    assert out == ['first', 'second']
    now[0] += 2 * DELAY
    merger.release()
    assert out == ['first', 'second', 'from another']
    assert not merger.is_delaying


def received(message):
    return Received(message, 1, latched=False)


def texts(backlog):
    return ''.join(one.received.message for one in backlog.next())


def test_every_change_waits_but_few_that_say_everything():
    backlog = Backlog(str.isupper, lambda _: False)
    for message in ['a', 'b', *'ABCD', 'c', *'EFGHIJKLM', 'd']:
        backlog.add(received(message), NEXT)
    waiting = ''.join(texts(backlog) for _ in range(len(backlog)))
    assert waiting == 'DcEFGHIJKLMd'
    assert sum(map(str.isupper, waiting)) == MOST_WHOLE
    assert backlog.superseded == 5
    for message in 'abc' * 1000:
        backlog.add(received(message), NEXT)
    assert len(backlog) == 3000


def test_small_messages_are_taken_out_together():
    lost = Heard(lost=1)
    backlog = Backlog(
        lambda _: False, lambda one: one.received.message.islower() and one.heard is NEXT
    )
    for message, heard in [('A', lost), ('b', NEXT), ('c', NEXT), ('D', NEXT), ('e', lost)]:
        backlog.add(received(message), heard)
    assert [texts(backlog) for _ in range(3)] == ['Abc', 'D', 'e']
    for _ in range(3 * TOGETHER):
        backlog.add(received('f'), NEXT)
    assert [len(backlog.next()) for _ in range(3)] == [TOGETHER] * 3
    assert not len(backlog)


# ---- a subscription


def test_what_is_left_of_a_publisher_that_is_gone_is_heard_once(ros):
    """Kept messages come by two subscriptions; nobody is counted when they are taken."""
    node, executor = ros
    heard, topic = [], f'gone_{os.getpid()}'
    subscription = FollowingSubscription(
        node, MarkerArray, topic, heard.extend, Delivery(latched=True, raw=True)
    )
    sent = [serialize_message(MarkerArray(markers=[marker(i)])) for i in range(300)]
    for first in (0, 100, 200):
        publisher = node.create_publisher(MarkerArray, topic, LATCHED_DEEP)
        spin_until(executor, lambda: publisher.get_subscription_count() == 2)  # noqa: B023
        for message in sent[first : first + 100]:
            publisher.publish(message)
        assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE))
        node.destroy_publisher(publisher)
        ends = time.monotonic() + PATIENCE
        while subscription.publishers():
            assert time.monotonic() < ends
            time.sleep(0.01)
    spin_until(executor, lambda: len(heard) >= len(sent))
    for _ in range(10):  # and none comes twice
        executor.spin_once(0.05)
    assert heard == sent
    assert subscription.lost == 0
    subscription.destroy()


def test_a_burst_costs_few_rounds_of_the_executor(ros):
    """Whoever is woken takes all that waits: a round costs more than a small message does."""
    node, executor = ros
    heard, rounds = [], 0
    topic = f'burst_{os.getpid()}'
    subscription = FollowingSubscription(
        node, MarkerArray, topic, heard.extend, Delivery(raw=True)
    )
    publisher = node.create_publisher(MarkerArray, topic, DEEP)
    spin_until(executor, publisher.get_subscription_count)
    for burst in range(200):
        for _ in range(20):
            publisher.publish(MarkerArray())
        ends = time.monotonic() + PATIENCE
        while len(heard) < 20 * (burst + 1):
            assert time.monotonic() < ends, f'{len(heard)} heard'
            executor.spin_once(PATIENCE)
            rounds += 1
    assert rounds < 20 * 200 / 2
    subscription.destroy()
    node.destroy_publisher(publisher)


def test_a_busy_topic_wakes_nobody_and_is_heard_by_who_asks(ros_context, monkeypatch):
    monkeypatch.setattr(subscribing, 'TURN', math.inf)  # however long the machine pauses
    node = rclpy.create_node('busy')
    executor = SturdyExecutor()
    executor.add_node(node)
    heard, topic = [], f'busy_{os.getpid()}'
    subscription = FollowingSubscription(
        node, MarkerArray, topic, heard.extend, Delivery(together=True, raw=True)
    )
    publisher = node.create_publisher(MarkerArray, topic, DEEP)
    sent = []

    def publish():
        marker = Marker(id=len(sent))
        sent.append(serialize_message(MarkerArray(markers=[marker])))
        publisher.publish(sent[-1])
        assert publisher.wait_for_all_acked(Duration(seconds=PATIENCE))

    spin_until(executor, publisher.get_subscription_count)
    for _ in range(3):
        ends = time.monotonic() + PATIENCE
        while not executor.resting:
            assert time.monotonic() < ends
            publish()
            executor.spin_once(0)
        before = len(heard)
        publish()
        assert len(heard) == before
        subscription.catch_up()
        assert heard == sent
        spin_until(executor, lambda: not executor.resting, pause=0.001)  # nothing comes any more
        publish()
        spin_until(executor, lambda: len(heard) == len(sent), pause=0.001)
        assert heard == sent
    subscription.destroy()
    executor.remove_node(node)
    executor.shutdown()
    node.destroy_node()
