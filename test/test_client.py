# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The Python client, against a stand-in for the node."""

import threading
import time
from contextlib import contextmanager

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.srv import GetPlan
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from ros.patience import PATIENCE, spin_until

from bvh_ros.client import BvhClient, BvhError, BvhTimeoutError, Hit
from bvh_ros.ros.access import REQUESTS

SERVICES = 'raycast', 'raycast_all', 'overlap', 'nearest'


class FakeNode:
    """Answers like a bvh node: by the tolerance of the request."""

    def __init__(self, context, services=SERVICES):
        self.node = rclpy.create_node(
            'bvh', context=context, start_parameter_services=False, enable_rosout=False
        )
        self.requests, self.compiles, self.released = [], False, threading.Event()
        for name in services:
            self.offer(name)
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self.executor.spin)
        self.thread.start()

    def offer(self, service):
        self.node.create_service(GetPlan, f'~/{service}', self.answer, qos_profile=REQUESTS)

    def answer(self, request, response):
        self.requests.append(request)
        if request.tolerance == 99.0:
            self.released.wait()
        if self.compiles:
            response.plan.poses = [PoseStamped()]
            response.plan.poses[0].header.frame_id = 'error: compiling: 50 %'
            return response
        count = 1 if request.tolerance == 7.0 else int(request.tolerance)
        for i in range(count):
            pose = PoseStamped()
            pose.header.frame_id = 'error: no world' if request.tolerance == 7.0 else f'a/{i}'
            pose.header.stamp.sec, pose.header.stamp.nanosec = 3, i
            pose.pose.position.x = float(i)
            pose.pose.orientation.z, pose.pose.orientation.w = 1.0, 0.0  # -x
            response.plan.poses = [*response.plan.poses, pose]
        return response

    def close(self):
        self.released.set()
        self.executor.shutdown()
        self.thread.join()
        self.node.destroy_node()


@pytest.fixture
def context():
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    yield context
    rclpy.try_shutdown(context=context)


@pytest.fixture
def server(context):
    fake = FakeNode(context)
    yield fake
    fake.close()


@pytest.fixture
def node(context, server):
    node = rclpy.create_node('asker', context=context)
    yield node
    node.destroy_node()


@pytest.fixture
def client(node):
    client = BvhClient(node, timeout=PATIENCE)
    client.wait_until_ready(PATIENCE)
    return client


@pytest.fixture
def executor(client, context):
    """Who may spin the client's node."""
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(client.node)
    yield executor
    executor.shutdown()


@contextmanager
def spinning(executor):
    """Spin in a thread meanwhile."""
    thread = threading.Thread(target=executor.spin)
    thread.start()
    yield
    executor.shutdown()
    thread.join()


@pytest.fixture(
    params=['nobody spins', 'spun in a thread', 'between spins', 'left by its executor', 'second']
)
def any_client(request, client):
    """The client of a node that nobody spins, that is spun now and then, or all the time."""
    if request.param == 'nobody spins':
        yield client
    elif request.param == 'second':
        assert client.raycast((0, 0, 0), (1, 0, 0)) is None
        second = BvhClient(client.node, timeout=PATIENCE)
        second.wait_until_ready(PATIENCE)
        yield second
    else:
        executor = request.getfixturevalue('executor')
        if request.param == 'spun in a thread':
            with spinning(executor):
                yield client
            return
        executor.spin_once(0.01)
        if request.param == 'left by its executor':  # as `rclpy.spin_once` does
            executor.remove_node(client.node)
        yield client


def test_raycast(any_client, server):
    assert any_client.raycast((1, 2, 3), (4, 5), 0.0) is None
    request = server.requests[-1]
    start, goal = request.start.pose.position, request.goal.pose.position
    assert (start.x, start.y, start.z) == (1, 2, 3)
    assert (goal.x, goal.y, goal.z) == (4, 5, 0)
    hit = any_client.raycast((0, 0, 0), (1, 0, 0), 2.0, frame_id='odom')
    assert hit == Hit('a/0', (0, 0, 0), (-1, 0, 0), 3_000_000_000)
    assert server.requests[-1].start.header.frame_id == 'odom'
    assert server.requests[-1].goal.header.frame_id == 'odom'


def test_many_hits_in_order(any_client):
    hits = any_client.raycast_all((0, 0, 0), (1, 0, 0), 3.0)
    assert [hit.name for hit in hits] == ['a/0', 'a/1', 'a/2']
    assert [hit.stamp for hit in hits] == [3_000_000_000, 3_000_000_001, 3_000_000_002]


def test_overlap(any_client, server):
    hits = any_client.overlap((0, 0, 0), (1, 1, 1), (0, 0, 1, 0), tolerance=2.0)
    assert len(hits) == 2
    turn = server.requests[-1].start.pose.orientation
    assert (turn.x, turn.y, turn.z, turn.w) == (0, 0, 1, 0)


def test_an_error_reply_is_raised(any_client):
    for call in (any_client.raycast, any_client.raycast_all):
        with pytest.raises(BvhError, match='no world'):
            call((0, 0, 0), (1, 0, 0), 7.0)
    with pytest.raises(BvhError, match='no world'):
        any_client.overlap((0, 0, 0), (1, 0, 0), tolerance=7.0)


def test_timeout(any_client, server):
    with pytest.raises(BvhTimeoutError, match=r'within 0\.1 s'):
        any_client.raycast((0, 0, 0), (1, 0, 0), 99.0, timeout=0.1)
    server.released.set()
    assert any_client.raycast((0, 0, 0), (1, 0, 0)) is None  # and works again


def test_a_parameter_whose_reply_is_lost_is_asked_for_again(client, server):
    # As rmw_fastrtps loses it: the service answers, and the client's reader is not yet known.
    region = ParameterValue(double_array_value=[0.0, 0.0, 0.0, 1.0, 2.0, 3.0])

    def answer(request, response):
        response.values = [region] + [ParameterValue()] * (len(request.names) - 1)
        return response

    service = server.node.create_service(GetParameters, '~/get_parameters', answer)
    server.node.create_publisher(DiagnosticStatus, '~/names', 1)
    sent, send = [], service.send_response

    def lose_the_first(response, header):
        sent.append(response)
        if len(sent) > 1:
            send(response, header)

    service.send_response = lose_the_first
    (corners,) = BvhClient(client.node, ['/bvh'], timeout=PATIENCE).regions()
    assert [corner.tolist() for corner in corners] == [[0, 0, 0], [1, 2, 3]]
    assert len(sent) > 1
    service.send_response = lambda response, header: None
    with pytest.raises(BvhTimeoutError, match='/bvh/get_parameters did not answer'):
        BvhClient(client.node, ['/bvh'], timeout=0.5).regions()


def test_wrong_arguments(client):
    with pytest.raises(ValueError, match='coordinates'):
        client.raycast((0,), (1, 0, 0))
    with pytest.raises(ValueError, match='orientation'):
        client.overlap((0, 0, 0), (1, 0, 0), (0, 0, 1))


def test_nobody_there(context, node):
    client = BvhClient(node, 'elsewhere')
    with pytest.raises(BvhTimeoutError, match='elsewhere'):
        client.wait_until_ready(0.1)


@pytest.mark.parametrize('last', SERVICES)
def test_a_node_is_ready_when_it_offers_all_services(context, last):
    server = FakeNode(context, [name for name in SERVICES if name != last])
    node = rclpy.create_node('asker', context=context)
    client = BvhClient(node)

    def found():
        return {name for name in SERVICES if node.count_services(f'/bvh/{name}')}

    try:
        deadline = time.monotonic() + PATIENCE
        while len(found()) < len(SERVICES) - 1 and time.monotonic() < deadline:
            time.sleep(0.01)
        assert found() == {*SERVICES} - {last}
        with pytest.raises(BvhTimeoutError, match="no services of 'bvh'"):
            client.wait_until_ready(0.2)
        server.offer(last)
        client.wait_until_ready(PATIENCE)
    finally:
        server.close()
        node.destroy_node()


def test_async_inside_a_callback(client, executor):
    """A timer's callback asks and awaits, in the one thread that spins."""
    answers = []

    async def tick():
        timer.cancel()
        answers.append(await client.raycast_async((0, 0, 0), (1, 0, 0), 1.0))
        answers.append(len(await client.raycast_all_async((0, 0, 0), (1, 0, 0), 3.0)))
        answers.append(len(await client.overlap_async((0, 0, 0), (1, 0, 0), tolerance=2.0)))
        try:
            await client.raycast_async((0, 0, 0), (1, 0, 0), 7.0)
        except BvhError as error:
            answers.append(str(error))

    timer = client.node.create_timer(0.01, tick)
    spin_until(executor, lambda: len(answers) == 4)
    assert [getattr(answer, 'name', answer) for answer in answers] == ['a/0', 3, 2, 'no world']


def test_plain_calls_inside_callbacks_and_in_many_threads(client, executor):
    others = [BvhClient(client.node, timeout=PATIENCE) for _ in range(2)]
    for other in others:
        other.wait_until_ready(PATIENCE)
    answers = []

    def tick():
        timer.cancel()
        answers.append(client.raycast((0, 0, 0), (1, 0, 0), 1.0).name)

    timer = client.node.create_timer(0.01, tick)
    spin_until(executor, lambda: answers)
    assert answers == ['a/0']

    def ask(own, count):
        for _ in range(10):
            answers.append(len(own.raycast_all((0, 0, 0), (1, 0, 0), float(count))) - count)

    threads = [
        threading.Thread(target=ask, args=(own, 2 + k))
        for k, own in enumerate((client, client, *others))
    ]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        executor.spin_once(0.001)  # which takes some of the replies
    assert answers[1:] == [0] * 40


def test_an_awaited_answer_that_a_plain_call_took(client, executor):
    """The coroutine goes on, though its executor did not see the reply come."""
    answers = []

    async def tick():
        timer.cancel()
        answers.append((await client.raycast_async((0, 0, 0), (1, 0, 0), 1.0)).name)

    timer = client.node.create_timer(0.01, tick)
    deadline = time.monotonic() + PATIENCE
    with spinning(executor):
        while not answers and time.monotonic() < deadline:
            assert client.raycast((0, 0, 0), (1, 0, 0)) is None
    assert answers == ['a/0']


def test_a_thousand_requests_on_the_way(client, request):
    replies = [client.raycast_async((0, 0, 0), (1, 0, 0)) for _ in range(1000)]
    executor = request.getfixturevalue('executor')  # begins to spin when all are on the way
    for reply in replies:
        executor.spin_until_future_complete(reply, PATIENCE)
        assert reply.done()


def test_a_node_that_compiles_is_not_ready_after_a_shutdown(context, server, node, monkeypatch):
    server.compiles = True
    client = BvhClient(node)
    with monkeypatch.context() as patch:
        for name in ('REFUSAL_PATIENCE', 'COMPILING_LOOK'):  # one look, however long it takes
            patch.setattr(f'bvh_ros.client.node.{name}', PATIENCE)
        with pytest.raises(BvhTimeoutError, match='compiling: 50 %'):
            client.wait_until_ready(PATIENCE)
    ending = threading.Timer(0.5, rclpy.shutdown, kwargs={'context': context})
    ending.start()
    with pytest.raises(BvhError, match='shut down'):
        client.wait_until_ready(PATIENCE)
    ending.join()


def test_nothing_can_be_asked_after_a_shutdown(context, server, node):
    client = BvhClient(node, timeout=PATIENCE)
    client.wait_until_ready(PATIENCE)
    raised = []

    def ask():
        with pytest.raises(BvhError) as caught:
            client.raycast((0, 0, 0), (1, 0, 0), 99.0)
        raised.append(str(caught.value))

    waiting = threading.Thread(target=ask)
    waiting.start()
    time.sleep(0.1)
    rclpy.shutdown(context=context)
    waiting.join(PATIENCE)
    assert raised == ['rclpy is shut down']
    for call in (client.wait_until_ready, lambda: client.raycast((0, 0, 0), (1, 0, 0))):
        with pytest.raises(BvhError, match='shut down'):
            call()


def test_nothing_can_be_asked_after_the_node_is_destroyed(client, node):
    node.destroy_node()
    for call in (client.wait_until_ready, lambda: client.raycast((0, 0, 0), (1, 0, 0))):
        with pytest.raises(BvhError, match='destroyed'):
            call()


def test_threads_that_come_at_once_open_the_topics_once(client, node):
    """A second channel would not hear the answers that the first one was found ready for."""
    before = {id(one) for one in node.subscriptions}
    start = threading.Barrier(16)

    def ask():
        start.wait()
        with pytest.raises(BvhTimeoutError):
            client.raycast_many([[0, 0, 0]], [[1, 0, 0]], timeout=0.0)

    threads = [threading.Thread(target=ask) for _ in range(16)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    # A reliable one, and one by best effort.
    assert len({id(one) for one in node.subscriptions} - before) == 2


def test_calls_do_not_become_slower(client):
    def ask(count):
        began = time.thread_time()  # without what others take of the processor
        for _ in range(count):
            client.raycast((0, 0, 0), (1, 0, 0))
        return (time.thread_time() - began) / count

    ask(20)
    first = min(ask(50) for _ in range(3))
    ask(500)
    assert min(ask(50) for _ in range(3)) < 3 * first
