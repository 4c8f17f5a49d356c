# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The folder in which the machine code of the kernels is kept, and what else is noted there.

It is named by a hash of every setting of numba that changes code; `kernel_files` says what is in
it.
"""

import contextlib
import functools
import hashlib
import os
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import llvmlite
import numba
from numba import config

from . import kernel_sources, shipped
from .shipped import UnsafeError, open_private, write_whole

parts: Callable[[], Any] = type(None)
"""`inside.parts`, which `compiling` hands in: that module imports those that import this one."""

PART = '.part'  # ends the names of files of which only compiling makes use
# Settings of numba that leave machine code as it is, by a word in their names.
_BESIDE_THE_CODE = 'CACHE', 'CUDA', 'THREAD'


def settings() -> tuple[str, ...]:
    """What else decides the machine code: the compiler's version, and its settings now.

    numba takes settings from `NUMBA_...` in the environment and from `.numba_config.yaml`, and
    looks again whenever it compiles. Settings that it has not got yet count, too.
    """
    return (
        numba.__version__,
        llvmlite.__version__,
        *(
            f'{name}={value!r}'
            for name, value in sorted(vars(config).items())
            if name.isupper() and not any(word in name for word in _BESIDE_THE_CODE)
        ),
    )


def _places() -> Iterator[Path]:
    """Where our own folder may be, best first."""
    named = os.environ.get('NUMBA_CACHE_DIR')
    if named:
        yield Path(named).absolute() / 'bvh_ros'
        return
    home = os.environ.get('XDG_CACHE_HOME') or os.path.expanduser('~/.cache')
    if os.path.isabs(home):  # else this user has no home
        yield Path(home) / 'bvh_ros'
    user = os.geteuid() if hasattr(os, 'geteuid') else 0
    with contextlib.suppress(OSError):  # no temporary folder, or a full one
        yield Path(tempfile.gettempdir()) / f'bvh_ros-{user}'


def cache_folder() -> Path | None:
    """Folder of the kernels that are compiled with exactly these settings of numba; None where no
    folder can be written, or only one that others can write, too, and with a numba that is not
    known inside.

    In `$NUMBA_CACHE_DIR`, else `$XDG_CACHE_HOME`, else `~/.cache`, else the machine's temporary
    folder.
    """
    return find_folder(settings())


@functools.cache
def find_folder(settings: tuple[str, ...]) -> Path | None:
    if parts() is None:
        return None
    name = hashlib.sha256('\n'.join(settings).encode()).hexdigest()[:16]
    refused: list[OSError] = []
    found = None
    for place in _places():
        try:
            found = open_private(place, name)
            break
        except OSError as error:
            refused.append(error)
    if found is None or any(isinstance(error, UnsafeError) for error in refused):
        why = '; '.join(map(str, refused)) or 'there is no home and no temporary folder'
        warn(f'kept in {found}: {why}' if found else f'not kept: {why}')
    return found


def warn(state: str) -> None:
    warnings.warn(f'the machine code of bvh_ros is {state}', RuntimeWarning, stacklevel=2)


def note(what: str) -> None:
    """Remember, beside the machine code, that all of what this names is there."""
    folder = cache_folder()
    if folder is not None:
        with contextlib.suppress(OSError):  # then it is looked for again
            write_whole(folder / _note(what), b'')


def is_noted(what: str) -> bool:
    """Whether all of what this names was kept before, or shipped."""
    if parts() is None:
        return False
    ready_made = shipped.find(settings())
    if ready_made is not None and (ready_made.folder / _note(what)).exists():
        return True
    folder = cache_folder()
    return folder is not None and (folder / _note(what)).exists()


def is_first_use() -> bool:
    """Whether kernels can be kept, and none that these sources compile were kept or shipped."""
    folder = cache_folder()
    if folder is None or shipped.find(settings()) is not None:
        return False
    return not any(folder.glob(f'{_of_these_sources()}-*.done'))


def _note(what: str) -> str:
    return f'{_of_these_sources()}-{hashlib.sha256(what.encode()).hexdigest()[:16]}.done'


def _of_these_sources() -> str:
    return kernel_sources.digest_of_all()[:16]


def ship() -> Path:
    """Make what the cache folder holds ready to be read by all; return its place."""
    folder = cache_folder()
    if folder is None:
        raise OSError('there is no folder to write kernels to')
    for part in folder.glob(f'*{PART}'):
        part.unlink()
    shipped.finish(folder, settings(), parts().code_generator())
    return folder
