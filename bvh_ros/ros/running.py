# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Start a bvh node for a program that brings its own: the demo, an example."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import rclpy
from rclpy.signals import SignalHandlerOptions

from bvh_ros.client import COMPILING, BvhClient, BvhTimeoutError

START_TIMEOUT = 300.0  # seconds: the first start on a machine compiles
END_TIMEOUT = 10.0  # seconds


def keep_apart(domain: int | None = None) -> str:
    """Hear no robots nearby: this machine only, and by default a domain of our own.

    To be called before `init`.

    Parameters
    ----------
    domain : int, optional
        ROS_DOMAIN_ID; without it that of the environment, else one by the number of this process.

    Returns
    -------
    str
        A namespace for the node, so that two such programs in one domain do not meet either.
    """
    own = os.environ.get('ROS_DOMAIN_ID') or 1 + os.getpid() % 100
    os.environ['ROS_DOMAIN_ID'] = str(own if domain is None else domain)
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    return f'/p{os.getpid()}'


def init() -> None:
    """`rclpy.init` for a program that has processes to end: signals raise exceptions in it."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _frame: sys.exit(128 + number))


@contextmanager
def running_node(
    namespace: str, parameters: Mapping[str, object] | None = None, *, log: IO[bytes] | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """Run bvh_node in a process of its own, with the Python that runs this.

    Parameters
    ----------
    namespace : str
        Of the node.
    parameters : mapping, optional
        The node's parameters; those of sources are mappings themselves.
    log : file, optional
        Where the node's output goes; by default to ours.
    """
    environment = {**os.environ, 'RCUTILS_CONSOLE_OUTPUT_FORMAT': '  {name}: {message}'}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'parameters.yaml'
        # JSON is YAML
        file.write_text(json.dumps({'/**': {'ros__parameters': dict(parameters or {})}}))
        command = [sys.executable, '-m', 'bvh_ros.ros.node', '--ros-args']
        command += ['-r', f'__ns:={namespace}', '--params-file', str(file)]
        with started(command, env=environment, stdout=log, stderr=log) as process:
            yield process


@contextmanager
def served(
    name: str, parameters: Mapping[str, object] | None = None, *, log: IO[bytes] | None = None
) -> Iterator[tuple[BvhClient, subprocess.Popen[bytes]]]:
    """Start ROS and a node as `running_node` does, kept apart from others; both end with the
    block.

    Yields
    ------
    client : BvhClient
        Of that node, ready; its own node has this name.
    process : subprocess.Popen
        The node's.
    """
    namespace = keep_apart()
    init()
    try:
        with running_node(namespace, parameters, log=log) as process:
            client = BvhClient(rclpy.create_node(name, namespace=namespace), timeout=60.0)
            wait_until_ready(client, process)
            yield client, process
    finally:
        rclpy.try_shutdown()


@contextmanager
def started(command: Sequence[str], **given: Any) -> Iterator[subprocess.Popen[bytes]]:
    """Run a command in a session of its own: Ctrl-C reaches us alone, and we end it."""
    process = None
    try:
        with signals_waiting():
            process = subprocess.Popen(command, start_new_session=True, **given)
        yield process
    finally:
        if process is not None:
            end(process)


@contextmanager
def signals_waiting() -> Iterator[None]:
    """Let what would end us wait: a process that is just being started would be left behind."""
    came: list[int] = []
    theirs = {
        number: signal.signal(number, lambda number, _frame: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    }
    try:
        yield
    finally:
        for number, handler in theirs.items():
            signal.signal(number, handler)
        for late in came:
            signal.raise_signal(late)


def end(process: subprocess.Popen[bytes]) -> None:
    """End a process, by force if it does not listen."""
    process.terminate()
    try:
        process.wait(END_TIMEOUT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def wait_until_ready(
    client: BvhClient, process: subprocess.Popen[bytes], first: Callable[[], object] | None = None
) -> None:
    """Wait until the node serves, or raise RuntimeError if it has ended. `first` is called once
    what the first answers need is compiled, if that is before all is.
    """
    deadline = time.monotonic() + START_TIMEOUT
    while True:
        try:
            client.wait_until_ready(timeout=0.5)
            return
        except BvhTimeoutError as error:
            if process.poll() is not None:
                raise RuntimeError(f'the node ended with code {process.returncode}') from None
            if time.monotonic() > deadline:
                raise
            if first is not None and COMPILING in str(error):
                first()
                first = None
