# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_node`: an rclpy node that serves from its start to its end, and ends quietly.

How it begins, how it spins, and how signals end it.
"""

from __future__ import annotations

import argparse
import ctypes
import faulthandler
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import rclpy
from rclpy.event_handler import EventHandler
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.timer import Timer
from rclpy.utilities import remove_ros_args

from bvh_ros.ros.compilation import prepare
from bvh_ros.ros.parameters import ConfigurationError
from bvh_ros.ros.private_rclpy import RCLError, UnknownROSArgsError, guard_taking, spin_once
from bvh_ros.ros.server import BvhServer
from bvh_ros.ros.texts import Seldom, as_line, explain

WRONG_CONFIGURATION = 2  # exit code
M_TRIM_THRESHOLD, M_MMAP_MAX = -1, -4  # of mallopt(3)
KEPT, LARGE = 256 << 20, 16 << 20  # bytes


class BvhNode(Node):
    """Serves as soon as it is there.

    Raises
    ------
    ConfigurationError
        If a parameter cannot be used.
    """

    def __init__(self) -> None:
        super().__init__('bvh')
        self.server = BvhServer(self)
        self.server.compile()
        self.server.serve()


def run(executable: str, create: Callable[[], Node], args: list[str] | None) -> int:
    """Create a node and spin it until Ctrl-C or SIGTERM; return the exit code."""
    if sys.__stderr__ is not None:  # None where a supervisor has closed it
        faulthandler.enable(sys.__stderr__)  # a crash in native code says where
    prepare()
    keep_memory()
    interrupts = Interrupts()
    try:
        with interrupts.while_starting():
            node = _start(executable, create, args)
            executor = SturdyExecutor()
            interrupts.wake = executor.wake
        executor.spin_until(interrupts.received, node)
        node.destroy_node()  # others hear at once that it is gone
    except (ConfigurationError, RCLError) as error:
        print(f'{executable}: {as_line(error)}', file=sys.stderr)
        return WRONG_CONFIGURATION
    finally:
        rclpy.try_shutdown()
    interrupts.end_if_received()
    return 0


def keep_memory() -> None:
    """Let the allocator keep freed memory, up to 256 MB, and have some before the first message.

    Taking a message of 16 MB allocates it three times. A new page costs up to 4 us, on a virtual
    machine 40 ms in all; with pages that are kept the message takes 7 ms.
    """
    mallopt = getattr(ctypes.CDLL(None), 'mallopt', None)  # the GNU C library has it
    if mallopt is not None:
        mallopt(M_TRIM_THRESHOLD, KEPT)
        mallopt(M_MMAP_MAX, 0)  # else what is larger than 32 MB is never kept
        _touched = [bytearray(LARGE) for _ in range(3)]


def _start(executable: str, create: Callable[[], Node], args: list[str] | None) -> Node:
    """Create the node; wrong parameters or arguments are a ConfigurationError or an RCLError."""
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        if args is None:
            _refuse_others(executable, remove_ros_args(sys.argv)[1:])
        return create()
    except UnknownROSArgsError as error:
        raise ConfigurationError(f'unknown ROS arguments: {error}') from error
    except (NameValidationException, ParameterException) as error:
        raise ConfigurationError(str(error)) from error


def _refuse_others(executable: str, arguments: list[str]) -> None:
    """End with a usage line if there are arguments that are not for ROS; they would be lost."""
    argparse.ArgumentParser(
        prog=executable,
        usage='%(prog)s [-h] [--ros-args ...]',
        description='Answer raycast and overlap services about obstacles on topics.',
        epilog='Parameters and remappings come after --ros-args.',
    ).parse_args(arguments)


# How the node spins, and how signals end it.

PATIENCE = 0.5  # seconds that a callback which is running gets to come to its end


class Interrupts:
    """Notes SIGINT and SIGTERM, and while the node starts ends the process at once.

    To be made before `rclpy.init`, which has to install no handlers of its own: they shut ROS down
    below whatever callback is running, and what that publishes or logs then fails. Spinning ends
    after the callback instead. Where that takes longer, a thread ends the process: Python's own
    handlers wait for the callback, too.

    Attributes
    ----------
    received : threading.Event
        Set by the first signal.
    wake : callable
        What ends a wait for messages. It is called in another thread, after `received` is set.
    """

    def __init__(self) -> None:
        self.received = threading.Event()
        self.wake: Callable[[], None] = lambda: None
        self._starting = False
        self._read_end, self._write_end = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        os.set_blocking(self._read_end, True)
        # The number of every signal is written there as soon as it comes: none is lost from here.
        signal.set_wakeup_fd(self._write_end, warn_on_full_buffer=False)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)
        threading.Thread(target=self._end_soon, name='interrupts', daemon=True).start()

    @contextmanager
    def while_starting(self) -> Iterator[None]:
        """End the process at once: kernels take seconds, and the compiler swallows exceptions.

        No client waits yet, and nothing is left half done, because kernels
        reach their cache by renaming whole files.
        """
        self._starting = True
        try:
            yield
        finally:
            self._starting = False

    def end_if_received(self) -> None:
        """End the process after a signal, without Python's own end: that takes a second."""
        if self.received.is_set():
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(0)

    def _on_signal(self, _number: int, _frame: object) -> None:
        if self._starting:
            os._exit(0)

    def _end_soon(self) -> None:
        wanted = signal.SIGINT, signal.SIGTERM
        while os.read(self._read_end, 1)[0] not in wanted:
            pass
        self.received.set()
        self.wake()
        time.sleep(PATIENCE)
        os._exit(0)


# An executor that outlives what goes wrong: one message too many must not end the node.

EVENTS_EVERY = 0.1  # seconds: what publishers and subscribers ask of each other can wait
ALL_EVENTS = 0.001  # seconds


class SturdyExecutor(SingleThreadedExecutor):
    """Serves on where a message or request cannot even be taken, say for want of memory.

    rclpy marks a callback group while it is served, and where taking fails leaves the mark for
    ever: no part of the node would be called again.
    """

    def __init__(self) -> None:
        super().__init__()
        self.resting: set[object] = set()  # entities that wake no executor for a while
        self._events_seen = 0.0  # s
        self._logger = rclpy.logging.get_logger('bvh')
        self._errors = Seldom(lambda text: self._logger.error(text))
        guard_taking(self, self._attempt)

    def spin_until(self, ended: threading.Event, node: Node) -> None:
        """Spin until the event is set and this is woken; what a callback raises is logged."""
        self._logger = node.get_logger()
        self.add_node(node)
        try:
            while not ended.is_set() and self.context.ok():
                self._attempt(spin_once, self, None, ended.is_set)
                self._errors.log()
        finally:
            self.remove_node(node)

    def can_execute(self, entity: Any) -> bool:
        """Return whether the next round waits for this entity, too.

        Each one costs a round 4 us, and there are some eighty. So rounds leave out what is not to
        wake anybody: what rests, timers that are stopped and, most of the time, events.
        """
        if (
            entity in self.resting
            or (isinstance(entity, EventHandler) and not self._looks_at_events())
            or (isinstance(entity, Timer) and entity.is_canceled())
        ):
            return False
        return bool(super().can_execute(entity))

    def _looks_at_events(self) -> bool:
        """Now and then, for as long as a round takes to ask for all of them."""
        now = time.monotonic()
        if now - self._events_seen >= EVENTS_EVERY:
            self._events_seen = now
        return now - self._events_seen < ALL_EVENTS

    def _attempt(self, call: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return call(*arguments)
        except ExternalShutdownException:
            raise
        except Exception as error:
            reason = explain(error)
        # The error is gone by now, and with it what it held in memory.
        self._errors.add(reason)
        return None


def main(args: list[str] | None = None) -> int:
    """Run the node until Ctrl-C or SIGTERM; return the exit code."""
    return run('bvh_node', BvhNode, args)


if __name__ == '__main__':
    sys.exit(main())
