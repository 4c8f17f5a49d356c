# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A process that runs calls for another one, so that what they compile is kept for both."""

import base64
import os
import pickle
import queue
import signal
import threading
from collections.abc import Callable
from typing import Any, NoReturn, TextIO

Calls = queue.SimpleQueue[str]

_here = False


def main(commands: TextIO, answers: TextIO) -> NoReturn:
    """Run what comes, a call a line; answer each with a line: why it failed, or nothing."""
    global _here
    _here = True
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who sent the calls
    if hasattr(os, 'nice'):
        os.nice(5)  # who sent them may answer meanwhile
    calls: Calls = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(commands, calls), daemon=True).start()
    while True:
        print(_run(calls.get()), file=answers, flush=True)


def _listen(commands: TextIO, calls: Calls) -> None:
    """Take calls, and end the process at once when nobody is there any more who sends some."""
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
