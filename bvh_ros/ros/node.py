# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_node`: an rclpy node that serves from its start to its end, and ends quietly."""

from __future__ import annotations

import sys
from collections.abc import Callable

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from bvh_ros.ros.interrupts import Interrupts
from bvh_ros.ros.option import ConfigurationError
from bvh_ros.ros.server import BvhServer

WRONG_CONFIGURATION = 2  # exit code
RCLError = rclpy_implementation.RCLError  # what rcl says about arguments that it cannot read


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
    interrupts = Interrupts()
    try:
        with interrupts.while_starting():
            rclpy.init(args=args)
            node = create()
            executor = SingleThreadedExecutor()
        rclpy.spin(node, executor)
    except ExternalShutdownException:
        pass
    except (ConfigurationError, RCLError) as error:
        # Where a signal has shut ROS down below us, an error is only its echo.
        if not interrupts.received:
            print(f'{executable}: {error}', file=sys.stderr)
            return WRONG_CONFIGURATION
    finally:
        rclpy.try_shutdown()
    return 0


def main(args: list[str] | None = None) -> int:
    """Run the node until Ctrl-C or SIGTERM; return the exit code."""
    return run('bvh_node', BvhNode, args)


if __name__ == '__main__':
    sys.exit(main())
