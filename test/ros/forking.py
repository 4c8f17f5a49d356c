# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes in processes of their own that need not import anything: half of a node's start.

A hundred nodes are started by the tests. They are forked from a process that has imported what a
node imports, and done nothing else.
"""

import faulthandler
import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

_FORKS = multiprocessing.get_context('forkserver')
_FORKS.set_forkserver_preload(['bvh_ros.ros.node'])
LOOKS = 0.1  # seconds between two statuses, which tests wait for; users wait for 1 s
IMPORTED = 'NUMBA_', 'BVH_ROS_', 'XDG_', 'PYTHON'  # what imports look at


class Fork:
    """A forked process, which is used as a `subprocess.Popen` is."""

    def __init__(self, arguments: Sequence[str], log: Path, command: str = 'bvh_node') -> None:
        given = arguments, log, command, dict(os.environ)
        self._process = _FORKS.Process(target=run_node, args=given)
        self._process.start()
        self.pid = self._process.pid

    def poll(self) -> int | None:
        """Return the exit code, or None while it runs."""
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end and return the exit code."""
        self._process.join(timeout)
        code = self.poll()
        if code is None:
            raise subprocess.TimeoutExpired('node', timeout or 0.0)
        return code

    def send_signal(self, number: signal.Signals) -> None:
        """Send a signal, if it runs."""
        if self.poll() is None and self.pid is not None:
            os.kill(self.pid, number)

    def print_stacks(self) -> None:
        """Let it write to its log what its threads do."""
        self.send_signal(signal.SIGUSR1)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)


def run_node(
    arguments: Sequence[str], log: Path, command: str, environment: Mapping[str, str]
) -> None:
    """Do in this process what `bvh_node`, or another command, does."""
    os.environ.clear()
    os.environ.update(environment)
    with log.open('wb') as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    faulthandler.register(signal.SIGUSR1)
    sys.argv = [command, *arguments]
    from bvh_ros import commands
    from bvh_ros.ros.parts import diagnostics

    diagnostics.PERIOD = LOOKS

    sys.exit(getattr(commands, command)())


def settings() -> dict[str, str]:
    """Return the part of the environment that was looked at when a forked node was imported."""
    return {name: value for name, value in os.environ.items() if name.startswith(IMPORTED)}


SETTINGS = settings()
