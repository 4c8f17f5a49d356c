# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where the machine code of the kernels is kept.

numba's own disk cache looks only at the file of the function that is called: after an edit in a
callee's file it would still run the old code. So the cache folder is named by a hash of every
source that can hold a kernel. In it, kernels go by their place in the package, not on the disk:
equal sources share machine code wherever they are installed.
"""

import contextlib
import functools
import hashlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numba
from numba.core import caching
from numba.core.types import Record

try:
    import fcntl
except ImportError:  # not on Windows: there processes should compile one after the other
    fcntl = None  # type: ignore[assignment]

_PACKAGE = Path(__file__).resolve().parent.parent


def _named_by_its_fields(record: Record) -> tuple[str, tuple[int]]:
    return 'Record', (int(hashlib.sha256(record.name.encode()).hexdigest()[:15], 16),)


# numba names the machine code for a record by the record's number, which is that of another one in
# another process: what one process compiled for 2D nodes and another for 3D ones had one name, and
# who loaded both ran one for the other.
Record.mangling_args = property(_named_by_its_fields)  # type: ignore[assignment, method-assign]


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


@functools.cache
def _stamp(source: str) -> str:
    return hashlib.sha256(Path(source).read_bytes()).hexdigest()


class _Place(caching._CacheLocator):
    """A source's folder of machine code."""

    def __init__(self, function: Any, source: str) -> None:
        self._py_file = source
        self._line = function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, function: Any, source: str) -> '_Place':
        return cls(function, source)

    def get_cache_path(self) -> str:
        folder, room = cache_folder(), Path(self._py_file).resolve().parent
        return str(folder / room.relative_to(_PACKAGE)) if folder else ''

    def get_source_stamp(self) -> str:
        return _stamp(self._py_file)

    def get_disambiguator(self) -> str:
        return str(self._line)


class _Files(caching.CompileResultCacheImpl):
    _locator_classes = (_Place,)


class KernelCache(caching.FunctionCache):
    """A kernel's machine code on disk, one file for each signature.

    numba numbers the files by what the index says, which another process may be about to write:
    two that save different signatures at once would end with one's code under the other's name.
    So they take turns.
    """

    _impl_class = _Files

    def save_overload(self, sig: Any, data: Any) -> None:
        with _alone(Path(self.cache_path)):
            super().save_overload(sig, data)


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / 'lock').open('w') as file:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
