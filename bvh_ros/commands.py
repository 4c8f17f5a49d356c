# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The commands. Each imports its module when it is called: Ctrl-C meanwhile ends it quietly, and
`--version` needs nothing of it.
"""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path

from bvh_ros import __version__

INTERRUPTED = 130  # exit code


def run(module: str) -> int:
    """Import a module and call its `main`; return the exit code."""
    if sys.argv[1:] == ['--version']:
        print(f'{Path(sys.argv[0]).name} {__version__}')
        return 0
    try:
        code: int = importlib.import_module(module).main()
    except KeyboardInterrupt:
        sys.stdout.flush()
        os._exit(INTERRUPTED)  # a second Ctrl-C would interrupt Python's own end
    return code


def bvh_node() -> int:
    """Run the node: obstacles from topics, answers by services."""
    return run('bvh_ros.ros.node')


def bvh_lifecycle_node() -> int:
    """Run the same node with a managed life cycle."""
    return run('bvh_ros.ros.lifecycle_node')


def bvh_demo() -> int:
    """Replay a warehouse over ROS 2, and ask about it."""
    return run('bvh_ros.demo')


def bvh_warm_up() -> int:
    """Compile before the first start, say for an image."""
    return run('bvh_ros.warm_up')


def bvh_report() -> int:
    """Measure speed and errors, beside other libraries."""
    return run('bvh_ros.report.cli')


def bvh_view() -> int:
    """Show a node, a recording or a saved tree in a browser."""
    return run('bvh_ros.view.main')
