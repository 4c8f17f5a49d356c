# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A bvh node in a process of its own, and this process as everybody else on the network."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from ros import forking
from ros.patience import COMPILING, PATIENCE, spin_until

AGAIN = 1.0  # s: until a node that may not have found who asks is asked again
STACKS = 0.5  # s: until a node has written what its threads do

EVERY_NODE = {  # the services that rclpy opens for each node
    'describe_parameters',
    'get_parameter_types',
    'get_parameters',
    'list_parameters',
    'set_parameters',
    'set_parameters_atomically',
}


_started: list[World] = []  # by the file whose tests run


class World:
    """One running node, and the means to talk to it."""

    def __init__(self, ros: Any, process: Any, namespace: str, log: Path) -> None:
        self.node, self.executor = ros
        self.process = process
        self.name = f'{namespace}/bvh'
        self.namespace = namespace
        self.log = log
        self._clients: dict[str, Any] = {}
        self.publishers: dict[str, Any] = {}
        self._subscriptions: list[Any] = []
        self._heard: Any = None
        self._statuses: dict[str, Any] = {}

    # ---- services

    def call(
        self, name: str, request: Any, kind: type | None = None, timeout: float = PATIENCE
    ) -> Any:
        """Call a service of the node and return its reply."""
        from nav_msgs.srv import GetPlan
        from std_srvs.srv import Trigger

        if name not in self._clients:
            others = kind is not None
            kind = kind or (GetPlan if isinstance(request, GetPlan.Request) else Trigger)
            self._clients[name] = self.node.create_client(kind, f'{self.name}/{name}')
            if others:  # services that are not ours drop a reply to whom they have not found yet
                self.until_found(timeout)
        # Each time: a managed node closes its services, and opens them again.
        self.until(self._clients[name].service_is_ready, timeout)
        future = self._clients[name].call_async(request)
        deadline = time.monotonic() + timeout
        while not future.done():
            assert time.monotonic() < deadline, f'{name} does not answer'
            self.executor.spin_once(AGAIN)
        return future.result()

    def plan(self, name: str, start: Any, goal: Any, **given: Any) -> Any:
        """Ask one of the GetPlan services and return the path."""
        from ros.messages import get_plan

        return self.call(name, get_plan(start, goal, **given)).plan

    def names(self, name: str, start: Any, goal: Any, **given: Any) -> list[str]:
        """Ask, and return only who was hit."""
        return [pose.header.frame_id for pose in self.plan(name, start, goal, **given).poses]

    def hits(self, *question: Any) -> list[str]:
        """Names, too, but nobody where the node cannot answer yet: `names` has its error then."""
        names = self.names(*question)
        return [] if names[:1] and names[0].startswith('error: ') else names

    def place(self, name: str, start: Any, goal: Any, **given: Any) -> tuple[float, ...]:
        """Ask, and return where the only one is hit."""
        from ros.messages import coordinates

        (pose,) = self.plan(name, start, goal, **given).poses
        return coordinates(pose)

    def everything(self) -> set[str]:
        """Return the names of all obstacles."""
        return set(self.names('overlap', (-1e6, -1e6, -1e6), (1e6, 1e6, 1e6)))

    def trigger(self, name: str) -> Any:
        """Call ~/clear, ~/rebuild or ~/validate."""
        from std_srvs.srv import Trigger

        return self.call(name, Trigger.Request())

    # ---- topics

    def publish(self, topic: str, message: Any, *, qos: Any = 10) -> None:
        """Publish on a topic in the node's namespace, once somebody listens."""
        if topic not in self.publishers:
            publisher = self.node.create_publisher(type(message), f'{self.namespace}/{topic}', qos)
            self.publishers[topic] = publisher
        publisher = self.publishers[topic]
        self.until(lambda: publisher.get_subscription_count() > 0)
        publisher.publish(message)

    def markers(self, *array: Any) -> None:
        """Publish markers where a node without configuration expects them."""
        from visualization_msgs.msg import MarkerArray

        self.publish('bvh/obstacles', MarkerArray(markers=list(array)))

    def holds(self, *names: str) -> None:
        """Wait until the node knows these obstacles, and no other."""
        self.until(lambda: self.everything() == set(names))

    def show(self, *array: Any) -> None:
        """Publish markers that add, and wait until the node knows them."""
        names = {f'{marker.ns}/{marker.id}' for marker in array}
        self.markers(*array)
        self.until(lambda: self.everything() >= names)

    def heard(self, kind: type, topic: str, qos: Any = 10) -> list[Any]:
        """The messages on a topic of the node, as they come."""
        found: list[Any] = []
        heard = self.node.create_subscription(kind, f'{self.name}/{topic}', found.append, qos)
        self._subscriptions.append(heard)
        return found

    def until(
        self, condition: Callable[[], Any], timeout: float = PATIENCE, pause: float = 0.005
    ) -> None:
        """Spin until something is true."""
        spin_until(self.executor, condition, timeout, pause, self.said)

    def until_compiled(self, condition: Callable[[], Any]) -> None:
        """Spin until something is true that takes kernels. Not too often: others compile, and a
        look is a question to a node.
        """
        self.until(condition, COMPILING, pause=0.2)

    def status(self, what: str) -> Any:
        """The next status on /diagnostics of this part of the node: its level, text and values."""
        return self.statuses()[what]

    def statuses(self) -> dict[str, Any]:
        """The next ones of all parts."""
        from diagnostic_msgs.msg import DiagnosticArray

        if self._heard is None:
            self._heard = self.node.create_subscription(
                DiagnosticArray, '/diagnostics', self._keep, 10
            )
        with self._heard.handle:
            while self._heard.handle.take_message(DiagnosticArray, False) is not None:
                pass  # what waits is older than what the caller has just seen
        self._statuses = {}
        self.until(lambda: self._statuses)
        return self._statuses

    def until_found(self, timeout: float = PATIENCE) -> None:
        """Wait until the node has found all that was opened here: DDS announces it in order, and
        the node answers what is opened last.
        """
        from rcl_interfaces.srv import ListParameters

        client = self.node.create_client(ListParameters, f'{self.name}/list_parameters')
        self.until(client.service_is_ready, timeout)
        asked, again = [], 0.0

        def answered() -> bool:
            nonlocal again
            if time.monotonic() > again:
                asked.append(client.call_async(ListParameters.Request()))
                again = time.monotonic() + AGAIN
            return any(reply.done() for reply in asked)

        self.until(answered, timeout)
        self.node.destroy_client(client)

    def _keep(self, message: Any) -> None:
        from types import SimpleNamespace

        beginning = f'{self.name.lstrip("/")}: '
        for status in message.status:
            if status.name.startswith(beginning):
                values = {pair.key: pair.value for pair in status.values}
                self._statuses[status.name[len(beginning) :]] = SimpleNamespace(
                    level=status.level, message=status.message, values=values
                )

    # ---- graph

    def offered(self) -> set[str]:
        """Names of the node's services, once the graph knows all that the node began with.

        Other processes hear of a node a moment after its services answer, and bit by bit.
        """
        self.until(lambda: self._known() >= EVERY_NODE)
        return self._known()

    def _known(self) -> set[str]:
        from rclpy.node import NodeNameNonExistentError

        try:
            offered = self.node.get_service_names_and_types_by_node('bvh', self.namespace)
        except NodeNameNonExistentError:
            return set()
        return {name.removeprefix(f'{self.name}/') for name, _ in offered}

    # ---- process

    def said(self) -> str:
        """Return what the node has logged."""
        return self.log.read_text()

    def end(self, how: signal.Signals = signal.SIGINT) -> int:
        """Ask the node to end and return its exit code."""
        self.process.send_signal(how)
        return self.process.wait(PATIENCE)

    def destroy(self) -> None:
        """End the node if it still runs, and what was opened for it."""
        if self.process.poll() is None:
            self.end()
        for client in self._clients.values():
            self.node.destroy_client(client)
        for publisher in self.publishers.values():
            self.node.destroy_publisher(publisher)
        for subscription in self._subscriptions:
            self.node.destroy_subscription(subscription)


WITHOUT_ROS = 'test_octomap.py', 'test_rotations.py', 'test_compilation.py'


class NoRos(pytest.Module):
    """A file of tests that cannot be imported."""

    def collect(self) -> Any:
        pytest.skip('rclpy is not installed', allow_module_level=True)


def pytest_pycollect_makemodule(module_path: Path, parent: Any) -> pytest.Module | None:
    """Skip the files that need ROS where there is none."""
    if module_path.name not in WITHOUT_ROS:
        try:
            import rclpy  # noqa: F401
        except ImportError:
            return NoRos.from_parent(parent, path=module_path)
    return None


@pytest.fixture(scope='session')
def ros(ros_context: None) -> Iterator[Any]:
    """The node and the executor of this process."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor

    node = rclpy.create_node('test')
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    yield node, executor
    executor.shutdown()
    node.destroy_node()


@pytest.fixture(scope='module')
def start_node(ros: Any, tmp_path_factory: Any) -> Iterator[Callable[..., World]]:
    """Start a node with parameters, each in a namespace of its own."""
    counter = itertools.count()

    def start(
        parameters: dict[str, Any] | None = None,
        *,
        wait: bool = True,
        module: str = 'node',
        script: Sequence[Any] = (),
        remap: str = '',
        namespace: str = '',
        fresh: bool = False,
    ) -> World:
        """A `fresh` one is started as its command does it, and not forked."""
        folder = tmp_path_factory.mktemp('node')
        own = f'/t{os.getpid()}_{folder.name}_{next(counter)}'.replace('-', '_')
        namespace = namespace or own
        file = folder / 'parameters.yaml'
        # JSON is YAML, but for infinity
        given = json.dumps({'/**': {'ros__parameters': parameters or {}}})
        file.write_text(given.replace('Infinity', '.inf'))
        arguments = ['--ros-args', '-r', f'__ns:={namespace}']
        arguments += ['--params-file', str(file)] if parameters else []
        arguments += ['-r', remap] if remap else []
        log = folder / 'log.txt'
        process: Any
        if fresh or script or forking.settings() != forking.SETTINGS:
            program = [sys.executable, *(script or ('-m', f'bvh_ros.ros.{module}'))]
            with log.open('wb') as output:
                process = subprocess.Popen([*program, *arguments], stdout=output, stderr=output)
        else:
            log.touch()
            process = forking.Fork(arguments, log, f'bvh_{module}')
        world = World(ros, process, namespace, log)
        _started.append(world)
        if wait:
            world.until(lambda: 'ready' in world.said() or process.poll() is not None, COMPILING)
            assert process.poll() is None, world.said()
        return world

    yield start
    while _started:
        _started.pop(0).destroy()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Any:
    """A failure comes with the last words of the nodes of its file, and what their threads do."""
    report = yield
    if report.failed:
        said = {world: world.said() for world in _started}
        for world in _started:
            if isinstance(world.process, forking.Fork):
                world.process.print_stacks()
        time.sleep(STACKS)
        for world, log in said.items():
            code = world.process.poll()
            last = log[-1500:] if code is None else log[-5000:]  # a crash lists all libraries
            stacks = world.said()[len(log) :][:1500]
            state = f'runs\n{stacks}' if code is None else f'has ended with {code}'
            report.sections.append((f'log of {world.name}', f'{last}\n{world.name} {state}'))
    return report


@pytest.fixture(scope='module')
def world(start_node: Callable[..., World]) -> World:
    """A node without configuration, shared by the tests of a module."""
    return start_node()


@pytest.fixture
def configure(ros: Any) -> Iterator[Callable[[dict[str, Any]], Any]]:
    """Read parameters as the node does at start, in this process: a server that does not serve."""
    from rclpy.node import Node
    from rclpy.parameter import Parameter

    from bvh_ros.ros.access import BvhServer

    servers = []

    def start(parameters: dict[str, Any]) -> BvhServer:
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        node = Node('configured', parameter_overrides=overrides)
        try:
            servers.append(BvhServer(node))
        except BaseException:
            node.destroy_node()
            raise
        return servers[-1]

    yield start
    for server in servers:
        server.destroy()
        server.node.destroy_node()


@pytest.fixture
def client_of(ros_context: None) -> Iterator[Callable[..., Any]]:
    """Make a client of a node, or of several by their names, on a node that nobody else spins."""
    import rclpy

    from bvh_ros.client import BvhClient

    nodes = []

    def make(of: Any, timeout: float = PATIENCE) -> BvhClient:
        nodes.append(rclpy.create_node('asker'))
        return BvhClient(nodes[-1], of.name if isinstance(of, World) else of, timeout=timeout)

    yield make
    for node in nodes:
        node.destroy_node()


@pytest.fixture
def patient_client(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no row of a batch is answered, the client asks the node why, for a second only."""
    monkeypatch.setattr('bvh_ros.client.node.REFUSAL_PATIENCE', PATIENCE)


# ---- ends


def waits_of(process: int) -> dict[str, float]:
    """Seconds that each thread of a process was ready to run, but did not."""
    waits = {}
    for file in Path(f'/proc/{process}/task').glob('*/schedstat'):
        with contextlib.suppress(OSError):  # it has ended
            waits[file.parent.name] = int(file.read_text().split()[1]) / 1e9
    return waits


def end(process: subprocess.Popen, how: signal.Signals = signal.SIGTERM) -> float:
    """Ask a process to end, and check its exit code; return how long it took, without the time
    that its threads, and this process, were ready to run while the processor was with others.
    """
    both = os.getpid(), process.pid
    before = [waits_of(one) for one in both]
    waits, began = [dict(each) for each in before], time.monotonic()
    process.send_signal(how)
    while process.poll() is None:
        for each, one in zip(waits, both, strict=True):
            each |= waits_of(one)  # threads end one by one: of each, what is seen last
        assert time.monotonic() - began < PATIENCE, 'it does not end'
        time.sleep(0.01)
    waits[0] |= waits_of(os.getpid())
    took = time.monotonic() - began
    assert process.returncode == 0
    after, earlier = (sum(sum(each.values()) for each in some) for some in (waits, before))
    return took - (after - earlier)


@pytest.fixture(scope='session')
def seconds_to_end() -> Callable[..., float]:
    """Ends a process by a signal, and tells how long that took, whoever used the machine."""
    return end
