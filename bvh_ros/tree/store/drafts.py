# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files that are there whole, or as they were before."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO


@contextmanager
def put_in_place(path: Path) -> Iterator[BinaryIO]:
    """A file to write to, that takes the place of `path` at the end, and leaves nothing behind if
    there is none: whoever reads meanwhile, or has mapped the older one, keeps that.
    """
    path = Path(os.path.realpath(path))  # a link stays one
    if path.exists() and not path.is_file():  # a pipe is written to; a folder says what it is
        with open(path, 'wb') as file:
            yield file
        return
    draft = path.with_name(f'.{secrets.token_hex(8)}.part')  # two may write at once
    try:
        with open(draft, 'xb') as file:
            yield file
        os.replace(draft, path)
    finally:
        draft.unlink(missing_ok=True)
