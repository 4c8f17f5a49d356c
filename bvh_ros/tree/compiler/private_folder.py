# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A folder that only this user can write.

A user who can write machine code that others run can run anything in their name. So a folder in
the machine's temporary folder, or in a borrowed home, is not trusted before its owner is checked.
"""

import contextlib
import os
import stat
import tempfile
import time
from pathlib import Path

DRAFT = '.tmp'  # ends the names of files that are being written
ABANDONED = 600.0  # seconds; writing takes milliseconds


class UnsafeError(PermissionError):
    """Others could have written here."""


def is_ours_alone(status: os.stat_result, *, or_of_root: bool = False) -> bool:
    """Whether a file or folder is this user's, and no other user may write it. With `or_of_root`
    those of root will do, too: root needs no such file to run anything.
    """
    if os.name == 'nt':
        return True  # knows no such modes
    owners = (os.geteuid(), 0) if or_of_root else (os.geteuid(),)
    return status.st_uid in owners and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def open_private(ours: Path, name: str) -> Path:
    """Return the folder `name` in our own one; both are made where they are missing, and what was
    never written to its end is removed.

    What is above our own folder is the machine's, and not looked at.

    Raises
    ------
    UnsafeError
        If one of the two is a link, another user's, or can be written by others.
    OSError
        If no file can be written there.
    """
    for above in reversed(ours.parents):
        if not above.exists():
            above.mkdir(mode=0o700, exist_ok=True)
    folder = ours / name
    for part in ours, folder:
        part.mkdir(mode=0o700, exist_ok=True)
        check(part)
    for draft in folder.glob(f'*{DRAFT}'):  # of processes that ended while they wrote
        with contextlib.suppress(OSError):
            if time.time() - draft.stat().st_mtime > ABANDONED:
                draft.unlink()
    with tempfile.TemporaryFile(dir=folder):
        return folder


def check(folder: Path, *, or_of_root: bool = False) -> None:
    """Raise UnsafeError if a folder is a link, another user's, or can be written by others."""
    status = folder.lstat()
    if stat.S_ISLNK(status.st_mode):
        raise UnsafeError(f'{folder} is a link')
    if not is_ours_alone(status, or_of_root=or_of_root):
        raise UnsafeError(
            f'{folder} has mode {stat.S_IMODE(status.st_mode):o} and belongs to user'
            f' {status.st_uid}; only user {os.geteuid()} may write there'
        )


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that others see whole or not at all."""
    descriptor, draft = tempfile.mkstemp(dir=path.parent, suffix=DRAFT)
    try:
        with open(descriptor, 'wb') as file:
            file.write(content)
        os.replace(draft, path)
    except BaseException:
        os.unlink(draft)
        raise
