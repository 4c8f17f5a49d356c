# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compiling in several processes: numba compiles one function at a time in each."""

import base64
import contextlib
import os
import pickle
import queue
import selectors
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NoReturn, TextIO

# ---- in the other process


Calls = queue.SimpleQueue[str]

_here = False


def main(commands: TextIO, answers: TextIO) -> NoReturn:
    """Run what comes, a call a line; answer each with a line: why it failed, or nothing."""
    global _here
    _here = True
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that sent the calls
    if hasattr(os, 'nice'):
        os.nice(5)  # the sender may answer queries meanwhile
    calls: Calls = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(commands, calls), daemon=True).start()
    while True:
        print(_run(calls.get()), file=answers, flush=True)


def _listen(commands: TextIO, calls: Calls) -> None:
    """Take calls, and end the process as soon as the sender has ended."""
    for line in commands:
        calls.put(line)
    os._exit(0)


def _run(line: str) -> str:
    try:
        pickle.loads(base64.b64decode(line))()
    except Exception as error:
        return ' '.join(repr(error).split())
    return ''


def is_here() -> bool:
    """Whether this process is a worker."""
    return _here


def run_and_end(call: Callable[[], object]) -> NoReturn:
    """Run a call, and end this process without waiting for another one."""
    call()
    os._exit(0)


def packed(call: Any) -> bytes:
    """Return a call as a line for a worker; what cannot be sent raises what pickle raises."""
    return base64.b64encode(pickle.dumps(call)) + b'\n'


# ---- forks


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
            _be_worker([*others, self], commands, answer)
        os.close(commands)
        os.close(answer)

    def kill(self) -> None:
        """End it at once."""
        os.kill(self.pid, signal.SIGKILL)

    def wait(self) -> None:
        """Wait until it has ended."""
        os.waitpid(self.pid, 0)


def _be_worker(forks: Sequence[Fork], commands: int, answer: int) -> NoReturn:
    """Be a worker. What this process was about to do, its parent does."""
    try:
        for fork in forks:
            fork.stdin.close()
            fork.stdout.close()
        main(os.fdopen(commands), os.fdopen(answer, 'w'))
    finally:
        os._exit(1)


# ---- in this process

Process = subprocess.Popen[bytes] | Fork

MOST = 8  # processes, of some 300 MB
START = """
import sys
sys.path[:] = {}
from bvh_ros.tree.compiler.workers import main
main(sys.stdin, sys.stdout)
"""


_ahead: list[Fork] = []


def fork_ahead() -> None:
    """Fork the processes that the next `Workers` begin with. They have imported what this one has:
    a second less, on a machine that has yet to compile everything. To be called before this
    process has threads of its own; where it cannot be forked, processes are started later.
    """
    if hasattr(os, 'fork'):
        with contextlib.suppress(OSError):
            while len(_ahead) < min(processors(), MOST):
                _ahead.append(Fork(_ahead))


def run_beside(call: Callable[[], object]) -> None:
    """Run a call in a process of its own, which ends then, or with this one; where that is no
    gain or cannot be, not at all.
    """
    if processors() == 1 or is_here() or 'python' not in Path(sys.executable or '').name:
        return
    with contextlib.suppress(OSError):
        process = _spawn()
        assert process.stdin is not None
        process.stdin.write(packed(partial(run_and_end, call)))
        process.stdin.flush()
        threading.Thread(target=process.wait, daemon=True).start()


def _spawn() -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, '-c', START.format(repr(sys.path))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )


def _cpu_seconds(process: Process) -> float:
    """Processor time of a child that has not been waited for; 0 or more where it is unknown."""
    try:
        return time.clock_gettime(~process.pid << 3 | 2)  # the clock of clock_getcpuclockid(3)
    except (AttributeError, OSError):
        return time.monotonic()


def processors() -> int:
    """How many this process may use."""
    if hasattr(os, 'sched_getaffinity'):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Workers:
    """Processes that run calls, so that what these compile is in the cache for all processes.

    They end when they have nothing more to do, and as soon as this process ends, however it does.

    Parameters
    ----------
    calls : sequence of callables
        Begun in this order. They are pickled.
    count : int, optional
        Of processes; by default one a processor, at most `MOST`.
    """

    def __init__(self, calls: Sequence[Callable[[], object]], count: int = 0) -> None:
        self._todo = deque(enumerate(calls))
        self._busy: dict[Process, int] = {}
        self._began: dict[int, float] = {}  # processor time of a call's process when it began
        self._used: dict[int, float] = {}
        self._lost: list[tuple[int, str]] = []
        self._selector = selectors.DefaultSelector()
        self.count = min(count or min(processors(), MOST), len(calls))
        for _ in range(self.count):
            self._begin_next(self._start())

    @property
    def running(self) -> Sequence[int]:
        """The numbers of the calls that run now."""
        return tuple(self._busy.values())

    def used(self) -> dict[int, float]:
        """Processor seconds of each call that has begun."""
        for process, number in self._busy.items():
            self._used[number] = _cpu_seconds(process) - self._began[number]
        return self._used

    def ended(self, timeout: float) -> Iterator[tuple[int, str]]:
        """Tell which calls have ended, and why those failed that did; wait for the first one, at
        most so many seconds.
        """
        while self._lost:
            yield self._lost.pop()
        for key, _ in self._selector.select(timeout):
            process = key.data
            line = process.stdout.readline()
            self.used()  # before it begins something else
            number = self._busy.pop(process)
            if line:
                self._begin_next(process)
            else:
                self._end(process)
                self._lost += [(left, 'no worker is left') for left, _ in self._left_over()]
            yield number, line.decode().strip() if line else 'its worker ended'

    def end(self) -> None:
        """End all processes at once."""
        self._todo.clear()
        for process in [*self._busy]:
            process.kill()
            self._end(process)
        self._busy.clear()

    def _start(self) -> Process:
        process: Process
        if _ahead:
            process = _ahead.pop()
        else:
            process = _spawn()
        self._selector.register(process.stdout, selectors.EVENT_READ, process)  # type: ignore[arg-type]
        return process

    def _begin_next(self, process: Process) -> None:
        """Send the next call that can be sent; without one the worker may end."""
        while self._todo:
            number, call = self._todo.popleft()
            try:
                line = packed(call)
            except Exception as error:  # whatever an object that will not be pickled raises
                self._lost.append((number, repr(error)))
                continue
            self._busy[process], self._began[number] = number, _cpu_seconds(process)
            with contextlib.suppress(OSError):  # it has ended: seen when it should answer
                assert process.stdin is not None
                process.stdin.write(line)
                process.stdin.flush()
            return
        self._end(process)

    def _left_over(self) -> Iterator[tuple[int, Callable[[], object]]]:
        """Calls that no process will begin any more."""
        while self._todo and not self._busy:
            yield self._todo.popleft()

    def _end(self, process: Process) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        self._selector.unregister(process.stdout)
        with contextlib.suppress(OSError):
            process.stdin.close()
        process.stdout.close()
        process.wait()
