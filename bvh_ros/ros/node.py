# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_node`: an rclpy node that serves from its start to its end, and ends quietly."""

from __future__ import annotations

import argparse
import ctypes
import faulthandler
import sys
from collections.abc import Callable

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from bvh_ros.ros.compilation import prepare
from bvh_ros.ros.config.parameters import ConfigurationError
from bvh_ros.ros.private_rclpy import RCLError, UnknownROSArgsError
from bvh_ros.ros.server import BvhServer
from bvh_ros.ros.spinning import Interrupts, SturdyExecutor
from bvh_ros.ros.texts import as_line

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


def main(args: list[str] | None = None) -> int:
    """Run the node until Ctrl-C or SIGTERM; return the exit code."""
    return run('bvh_node', BvhNode, args)


if __name__ == '__main__':
    sys.exit(main())
