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
    """Run the node."""
    return run('bvh_ros.ros.node')


def bvh_lifecycle_node() -> int:
    """Run the managed node."""
    return run('bvh_ros.ros.lifecycle_node')


def bvh_demo() -> int:
    """Run the demo."""
    return run('bvh_ros.demo')


def bvh_warm_up() -> int:
    """Compile before the first start."""
    return run('bvh_ros.warm_up')


def bvh_report() -> int:
    """Measure."""
    return run('bvh_ros.report.cli')


def bvh_view() -> int:
    """Show obstacles in a browser."""
    return run('bvh_ros.view.main')
