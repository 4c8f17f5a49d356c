# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The one decorator for compiled functions, and where their machine code is kept.

numba's own disk cache looks only at the file of the function that is called: after an edit in a
callee's file it would still run the old code. So the cache folder is named by a hash of every
source that can hold a kernel.
"""

import functools
import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core import config

_PACKAGE = Path(__file__).resolve().parent.parent


def _source_hash() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for room in ('tree', 'scene', 'ros/cdr'):
        for source in sorted((_PACKAGE / room).glob('*.py')):
            digest.update(source.name.encode())
            digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


@functools.cache
def cache_folder() -> Path | None:
    """Folder of the compiled kernels of exactly these sources; None where no folder can be
    written.

    `$NUMBA_CACHE_DIR`, else `$XDG_CACHE_HOME/bvh_ros`, else `~/.cache/bvh_ros`, else the machine's
    temporary folder.
    """
    named = os.environ.get('NUMBA_CACHE_DIR')
    home = os.environ.get('XDG_CACHE_HOME') or os.path.expanduser('~/.cache')
    user = os.getuid() if hasattr(os, 'getuid') else 0
    places = [Path(named)] if named else [Path(home), Path(tempfile.gettempdir()) / f'user-{user}']
    for place in places:
        folder = place / 'bvh_ros' / _source_hash()
        if _writable(folder):
            return folder
    return None


def is_warm() -> bool:
    """Whether kernels of exactly these sources have been compiled on this machine before."""
    folder = cache_folder()
    return folder is not None and any(folder.rglob('*.nbi'))


def _compiled(function: Callable[..., Any], **options: Any) -> Any:
    folder = cache_folder()
    if folder is None:
        return numba.njit(function, error_model='numpy', nogil=True, **options)
    # numba reads its cache folder when a function is decorated; other users of numba in this
    # process keep their own.
    theirs = config.CACHE_DIR
    config.CACHE_DIR = str(folder)
    try:
        return numba.njit(function, error_model='numpy', nogil=True, cache=True, **options)
    finally:
        config.CACHE_DIR = theirs


def kernel(function: Callable[..., Any]) -> Any:
    """Compile with numba at the first call, keep the machine code on disk, and release the GIL
    while running.

    Division by zero follows IEEE 754, as in numpy. `fastmath` stays off: a kernel that decides
    must round as written.
    """
    return _compiled(function, _nrt=True)


def lean_kernel(function: Callable[..., Any]) -> Any:
    """A kernel that makes no arrays, and so need not count references.

    Counting is two atomic operations for every array passed to a function: ten arrays a ray cost
    more than the ray.
    """
    return _compiled(function, _nrt=False)


def inlined(function: Callable[..., Any]) -> Any:
    """A lean kernel that becomes part of its callers."""
    return _compiled(function, _nrt=False, forceinline=True)


def entry_point(compiled: Any, *arguments: Any) -> Callable[..., Any]:
    """The machine code of a kernel for arguments of these types; it takes no others, and does not
    look.

    A kernel that is called as such finds out the types of its arguments at every call: half a
    microsecond for seven arrays, as long as a ray.
    """
    code: Callable[..., Any] = compiled.compile(tuple(map(numba.typeof, arguments)))
    return code
