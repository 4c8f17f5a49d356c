# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A worker that begins as a fork of this process, with all that this one has imported."""

import os
import signal
from collections.abc import Sequence
from typing import NoReturn

from . import worker


class Fork:
    """What `subprocess.Popen` is to a worker that imports everything itself.

    Parameters
    ----------
    others : sequence of Fork
        That are there: a fork holds no end of their pipes, or they would not hear that this
        process has ended.

    Raises
    ------
    OSError
        If there is no room for a process.
    """

    def __init__(self, others: Sequence['Fork']) -> None:
        commands, tell = os.pipe()
        heard, answer = os.pipe()
        self.stdin, self.stdout = os.fdopen(tell, 'wb'), os.fdopen(heard, 'rb')
        try:
            self.pid = os.fork()
        except OSError:
            for end in commands, answer:
                os.close(end)
            raise
        if self.pid == 0:
            _run([*others, self], commands, answer)
        os.close(commands)
        os.close(answer)

    def kill(self) -> None:
        """End it at once."""
        os.kill(self.pid, signal.SIGKILL)

    def wait(self) -> None:
        """Wait until it has ended."""
        os.waitpid(self.pid, 0)


def _run(forks: Sequence[Fork], commands: int, answer: int) -> NoReturn:
    """Be a worker. What this process was about to do, its parent does."""
    try:
        for fork in forks:
            fork.stdin.close()
            fork.stdout.close()
        worker.main(os.fdopen(commands), os.fdopen(answer, 'w'))
    finally:
        os._exit(1)
