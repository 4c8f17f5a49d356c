# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Meshes of files that markers name, read in other processes.

Neither the name nor the file is trusted. A name leads to files in allowed folders only, wherever
links point; a file is read by a process with little memory and time, which is killed where it
takes more.
"""

from __future__ import annotations

import contextlib
import os
import re
import stat
import subprocess
import sys
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from typing import NamedTuple
from urllib.parse import unquote
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.conversions.placing import examined
from bvh_ros.ros.texts import shortened
from bvh_ros.scene import Mesh
from bvh_ros.scene.shapes import mesh_file
from bvh_ros.scene.store import until_done

Floats = NDArray[np.float64]
AT_ONCE = 2  # processes that read
MOST_SECONDS = 60.0  # for one file
MOST_REFUSALS = 1000  # that are remembered
# The reader sees the packages that this process sees, and imports numpy and trimesh alone.
COMMAND = 'import runpy, sys; sys.path[:] = {}; runpy.run_path({!r}, run_name="__main__")'


class MeshFile(NamedTuple):
    """A file that may be read, as it is now."""

    path: str  # without links
    kind: str
    version: tuple[int, ...]  # another one if the file was changed


class MeshFiles:
    """Finds and reads the mesh files of one source.

    Parameters
    ----------
    folders : sequence of str
        Files are read from these, and from the share folders of installed packages.
    max_triangles, max_bytes : int
        A file with more is refused.
    """

    def __init__(self, folders: Sequence[str], max_triangles: int, max_bytes: int) -> None:
        # The URI that was loaded last, until the caller has put its mesh into the scene.
        self.loading = ''
        self.latest: list[Mesh] = []  # of the last message, so that they can come and go
        self._folders = [os.path.realpath(folder) for folder in folders]
        self._limits = max_triangles, max_bytes
        self._meshes: WeakValueDictionary[object, Mesh] = WeakValueDictionary()
        self._reading: WeakValueDictionary[MeshFile, Future[Floats]] = WeakValueDictionary()
        self._refused: dict[object, str] = {}

    def find(self, uri: str) -> MeshFile:
        """The file of a URI; ValueError if it names none that may be read."""
        path, folders = self._path(uri)
        real = os.path.realpath(path)
        if not any(os.path.commonpath((real, folder)) == folder for folder in folders):
            raise ValueError(f"it is in no folder of 'mesh_paths' nor of its package: {real}")
        kind = mesh_file.kind_of(real)
        try:
            return MeshFile(real, kind, _version(os.stat(real)))
        except OSError as error:
            raise ValueError(f'it cannot be opened: {error.strerror}') from error

    def _path(self, uri: str) -> tuple[str, Sequence[str]]:
        """A path, and the folders in which it may lie."""
        scheme, _, rest = uri.partition('://')
        try:
            rest = unquote(rest, errors='strict')
        except UnicodeDecodeError:
            rest = '\0'
        if '\0' in rest:
            raise ValueError('it names no path')
        if scheme == 'file':
            if not rest.removeprefix('localhost').startswith('/'):
                raise ValueError('a file:// URI has three slashes')
            return rest.removeprefix('localhost'), self._folders
        if scheme != 'package':
            raise ValueError('only file:// and package:// are read')
        package, _, rest = rest.partition('/')
        share = os.path.realpath(_share_folder(package))
        return os.path.join(share, rest.lstrip('/')), [*self._folders, share]

    def start(self, file: MeshFile) -> Future[Floats]:
        """Begin to read a file, unless that has begun; its triangles come in another thread."""
        work = self._reading.get(file)
        if work is None:
            work = self._reading[file] = _readers().submit(_read, file, *self._limits)
        return work

    def knows(self, file: MeshFile, scale: Floats, form: str) -> bool:
        """Whether a mesh need not be read."""
        key = file, scale.tobytes(), form
        return key in self._meshes or key in self._refused

    def mesh(
        self, uri: str, file: MeshFile, scale: Floats, form: str, *, planar: bool
    ) -> Generator[None, None, Mesh]:
        """The mesh of a file, times a scale (3,), in a form of `mesh_of`; pause until it is there.

        Raises
        ------
        ValueError
            If the file cannot be read, now or when that was tried last, or is no such mesh.
        """
        key = file, scale.tobytes(), form
        if key in self._refused:
            raise ValueError(self._refused[key])
        mesh = self._meshes.get(key)
        if mesh is not None:
            return mesh
        self.loading = uri
        try:
            triangles = yield from until_done(self.start(file))
            with np.errstate(over='ignore', invalid='ignore'):  # to what is not finite
                triangles = triangles * scale
            mesh = self._meshes[key] = yield from examined(triangles, planar, form)
        except ValueError as error:
            if len(self._refused) == MOST_REFUSALS:
                del self._refused[next(iter(self._refused))]
            self._refused[key] = str(error)
            raise
        return mesh


def _version(status: os.stat_result) -> tuple[int, ...]:
    """What changes when a file does; ValueError if it is none: a pipe would block."""
    if not stat.S_ISREG(status.st_mode):
        raise ValueError('it is not a file')
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def _share_folder(package: str) -> str:
    from ament_index_python.packages import get_package_share_directory

    if not re.fullmatch('[a-zA-Z0-9][a-zA-Z0-9_-]*', package):
        raise ValueError(f'{shortened(package)!r} is no name of a package')
    try:
        return get_package_share_directory(package, print_warning=False)
    except (LookupError, OSError, ValueError) as error:  # also where no prefix is set
        raise ValueError(f'there is no package {shortened(package)!r}') from error


@contextlib.contextmanager
def _opened(file: MeshFile) -> Iterator[int]:
    """The file, opened, if it still is what was found: a folder may have become a link."""
    try:
        number = os.open(file.path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError as error:
        raise ValueError(f'it cannot be opened: {error.strerror}') from error
    try:
        if _version(os.fstat(number)) != file.version or os.path.realpath(
            f'/proc/self/fd/{number}'
        ) not in (file.path, f'/proc/self/fd/{number}'):
            raise ValueError('it was changed while it was opened')
        yield number
    finally:
        os.close(number)


@cache
def _readers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(AT_ONCE, 'mesh files')


def _read(file: MeshFile, max_triangles: int, max_bytes: int) -> Floats:
    """Triangles of a file, by a process of its own; ValueError that says why there are none."""
    command = COMMAND.format(sys.path, mesh_file.__file__)
    numbers = [str(max_triangles), str(max_bytes)]
    with _opened(file) as data:
        try:
            done = subprocess.run(
                [sys.executable, '-c', command, file.kind, *numbers],
                stdin=data,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=os.environ | {'OPENBLAS_NUM_THREADS': '1'},
                timeout=MOST_SECONDS,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise ValueError(f'reading it takes longer than {MOST_SECONDS:g} s') from error
        except OSError as error:
            raise ValueError(f'there is no process to read it: {error.strerror}') from error
    if done.returncode == mesh_file.REFUSED:
        raise ValueError(shortened(done.stdout.decode('utf-8', 'replace')))
    if done.returncode or len(done.stdout) % 72:
        raise ValueError(f'the process that read it has ended with {done.returncode}')
    return np.frombuffer(done.stdout).reshape(-1, 3, 3)
