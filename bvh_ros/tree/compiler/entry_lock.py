# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Of processes that want the same machine code, one compiles, and the others wait for it."""

import functools
import hashlib
import os
import sys
import time
from pathlib import Path

if sys.platform != 'win32':
    import fcntl

NAME = 'lock'
POLL = 0.02  # seconds between two looks
PATIENCE = 120.0  # seconds; a process that holds a lock for longer has been stopped


@functools.cache
def _open(folder: Path, _process: int) -> int:
    """The folder's lock file, open once in each process: closing it gives up all locks."""
    return os.open(folder / NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)


class EntryLock:
    """A byte of the folder's lock file. It is free as soon as its holder ends, however that ends.

    A process that holds one waits for another only where that is of something called by what it
    compiles: no two wait for each other.
    """

    def __init__(self) -> None:
        self._locked: tuple[int, int] | None = None

    def acquire(self, folder: Path, what: str) -> bool:
        """Wait until no other process compiles this; return whether one did.

        Where files cannot be locked, each process compiles.
        """
        if sys.platform == 'win32':
            return False
        self.release()
        place = int.from_bytes(hashlib.sha256(what.encode()).digest()[:7], 'big')
        began = time.monotonic()
        waited = False
        try:
            file = _open(folder, os.getpid())
            while True:
                try:
                    fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, place)
                    self._locked = file, place
                    return waited
                except BlockingIOError:
                    waited = True
                if time.monotonic() - began > PATIENCE:
                    return True
                time.sleep(POLL)
        except OSError:
            return waited

    def release(self) -> None:
        """Let the others go on."""
        if self._locked is not None:
            file, place = self._locked
            self._locked = None
            fcntl.lockf(file, fcntl.LOCK_UN, 1, place)
