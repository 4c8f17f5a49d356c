# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A process that runs calls for another one, so that what they compile is kept for both."""

import base64
import os
import pickle
import queue
import signal
import sys
import threading
from typing import Any

Calls = queue.SimpleQueue[str]


def main() -> None:
    """Run what comes on standard input, a call a line; answer each with a line: why it failed, or
    nothing.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who sent the calls
    if hasattr(os, 'nice'):
        os.nice(5)  # who sent them may answer meanwhile
    calls: Calls = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(calls,), daemon=True).start()
    while True:
        print(_run(calls.get()), flush=True)


def _listen(calls: Calls) -> None:
    """Take calls, and end the process at once when nobody is there any more who sends some."""
    for line in sys.stdin:
        calls.put(line)
    os._exit(0)


def _run(line: str) -> str:
    try:
        pickle.loads(base64.b64decode(line))()
    except Exception as error:
        return ' '.join(repr(error).split())
    return ''


def packed(call: Any) -> bytes:
    """Return a call as a line for a worker; what cannot be sent raises what pickle raises."""
    return base64.b64encode(pickle.dumps(call)) + b'\n'
