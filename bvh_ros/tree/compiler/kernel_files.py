# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The machine code of the kernels on disk, and beside it what their parts were simplified to.

numba's own disk cache looks only at the file of the function that is called: after an edit in a
callee's file it would still run the old code. So a kernel's code is named by a hash of every
source that it depends on (`kernel_sources`), and the cache folder by a hash of every setting of
numba that changes code. Kernels go by their place in the package, not on the disk: equal sources
share machine code wherever they are installed.

A crash, a full disk or a stray copy may leave anything there. So each file begins with a hash of
its name and content, and is looked into only if that hash is right. Else the kernel is compiled
again.
"""

import functools
import hashlib
import os
import pickle
import sys
import time
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
from numba.core import caching
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import compile_result
from numba.core.runtime import rtsys
from numba.core.serialize import dumps

from . import kernel_sources, shipped
from .kernel_cache import PART, cache_folder, settings, warn
from .shipped import is_ours_alone, write_whole

# ---- Of processes that want the same machine code, one compiles, and the others wait for it


if sys.platform != 'win32':
    import fcntl

LOCK = 'lock'
POLL = 0.02  # seconds between two looks
PATIENCE = 120.0  # seconds; a process that holds a lock for longer has been stopped


@functools.cache
def _open(folder: Path, _process: int) -> int:
    """The folder's lock file, open once in each process: closing it gives up all locks."""
    return os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)


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


# ---- Files of machine code, one a kernel and signature


SEAL = hashlib.sha256().digest_size


class _Place(caching._CacheLocator):
    """A kernel's place in the package."""

    def __init__(self, function: Any, source: str) -> None:
        self._function = function
        self._py_file = source

    @classmethod
    def from_function(cls, function: Any, source: str) -> '_Place':
        return cls(function, source)

    def get_cache_path(self) -> str:
        return ''  # `SealedFiles` looks for the folder when there is something to keep

    def ensure_cache_path(self) -> None:
        pass

    def get_source_stamp(self) -> str:
        return ''  # `SealedFiles` asks for it when there is something to look for

    def depends_on(self) -> str:
        """Hash of the sources that this function's code depends on."""
        source = Path(self._py_file).resolve()
        if self._function.__closure__ is None and source.is_relative_to(kernel_sources.PACKAGE):
            return kernel_sources.digest(source)
        # What a closure holds, or a file elsewhere imports, may be anything.
        own_digest = hashlib.sha256(source.read_bytes()).hexdigest()
        return f'{own_digest} {kernel_sources.digest_of_all()}'

    def get_disambiguator(self) -> str:
        room = Path(self._py_file).resolve().parent.relative_to(kernel_sources.PACKAGE)
        return '-'.join((*room.parts, str(self._function.__code__.co_firstlineno)))


class _Kept(caching.CompileResultCacheImpl):
    """What is kept of a kernel: machine code, and not what that was made from, in LLVM's terms.
    numba would link it into callers, but these are given a part of their own. It is half of a
    file, and reading it took a seventh of a start with kept kernels. Nor are environments kept
    that hold nothing: numba would import what of itself they come from.
    """

    _locator_classes = (_Place,)

    def reduce(self, data: Any) -> Any:
        (name, kind, (code, bitcode)), *rest, environments = super().reduce(data)
        used = tuple(one for one in environments if one.consts)
        return (name, kind, (code, _names_in(bitcode))), *rest, used


class _KeptPart(caching.CompileResultCacheImpl):
    """What is kept of a part: what it was simplified to, in LLVM's terms, to be linked."""

    _locator_classes = (_Place,)

    def reduce(self, data: Any) -> Any:
        data.fndesc.typemap = data.fndesc.calltypes = None  # of no use any more, and large
        code = data.library.serialize_using_bitcode()
        environments = data.environment, data._find_referenced_environments()
        return code, data.fndesc, environments, data.signature, data.reload_init

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        (name, _, bitcode), fndesc, environments, signature, reload_init = payload
        for initialise in reload_init:
            initialise()
        return compile_result(
            typing_context=target_context.typing_context,
            target_context=target_context,
            library=PartCode.of_bitcode(target_context.codegen(), name, bitcode),
            environment=environments[0],
            referenced_envs=environments[1],
            fndesc=fndesc,
            signature=signature,
            reload_init=reload_init,
            objectmode=False,
            lifted=(),
        )


def _names_in(bitcode: bytes) -> bytes:
    """Bitcode that defines the same names as nothing: numba asks it which names there are."""
    module = llvm.parse_bitcode(bitcode)
    functions = (f.name for f in module.functions if not f.is_declaration)
    variables = (v.name for v in module.global_variables if not v.is_declaration)
    lines = [
        *(f'define void @"{name}"() {{ ret void }}' for name in functions),
        *(f'@"{name}" = global i8 0' for name in variables),
    ]
    names: bytes = llvm.parse_assembly('\n'.join(lines)).as_bitcode()
    return names


class PartCode(JITCodeLibrary):
    """The code of a part: it is linked into its callers, and nowhere else."""

    _dynamic_globals: list[str]

    @classmethod
    def of_bitcode(cls, codegen: Any, name: str, bitcode: bytes) -> 'PartCode':
        """What was kept."""
        code = cls(codegen, name)
        code._final_module = llvm.parse_bitcode(bitcode)
        code._finalize_final_module()
        return code

    def _optimize_final_module(self) -> None:
        """Simplify, so that a caller's inliner sees how small it is.

        Left as it is, code is inlined otherwise than numba would (a swept ball took a quarter
        longer), and is more work for every caller.
        """
        passes, builder = self._codegen._module_pass_manager(
            loop_vectorize=False, slp_vectorize=False, opt=0, cost='cheap'
        )
        passes.run(self._final_module, builder)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        if self._dynamic_globals:
            # numba asks for the address of a function that is handed over, too, and nothing uses
            # it: a part that only defines the address can be kept. One that hands the function
            # over twice defines it twice.
            lines = str(self._final_module).splitlines()
            self._dynamic_globals = [
                name
                for name in self._dynamic_globals
                if any(name in line and not line.startswith(f'@{name}') for line in lines)
            ]
        self._finalized = True


class SealedFiles:
    """Files for one kernel or part: for each signature one, which needs no other one.

    So processes that compile the same kernel at once just write equal files, one after the other.
    """

    warned = False

    def __init__(self, name: str, locator: _Place, suffix: str) -> None:
        self._name = name
        self._locator = locator
        self._suffix = suffix

    @functools.cached_property
    def _stamp(self) -> str:
        """Of the sources; most kernels are only called by others, and never need it."""
        return self._locator.depends_on()

    def load(self, key: Any) -> Any:
        """Return what is kept or shipped under this key; None if that is nothing, or no longer
        whole.
        """
        ready_made = shipped.find(settings())
        if ready_made is not None:
            signature, _, hashes = key
            name = self.name_of((signature, ready_made.codegen, hashes))
            content = self._read(ready_made.folder / name, or_of_root=True)
            if content is not None:
                return pickle.loads(content)
        path = self._path(key)
        content = None if path is None else self._read(path)
        return None if content is None else pickle.loads(content)

    def is_there(self, key: Any) -> bool:
        """Whether there may be something to load, or nowhere to keep it."""
        if shipped.find(settings()) is not None:
            return True
        path = self._path(key)
        return path is None or path.exists()

    def _read(self, path: Path, *, or_of_root: bool = False) -> bytes | None:
        try:
            with path.open('rb') as file:
                if not is_ours_alone(os.fstat(file.fileno()), or_of_root=or_of_root):
                    return None
                seal, content = file.read(SEAL), file.read()
        except OSError:
            return None
        if seal != self.seal_of(path, content):
            return None
        caching._cache_log('[cache] data loaded from %r', str(path))
        return content

    def save(self, key: Any, data: Any) -> None:
        """Keep data under this key. Where that fails, it is this process's only: said once."""
        path = self._path(key)
        if path is None:
            return
        content = dumps(data)
        try:
            write_whole(path, self.seal_of(path, content) + content)
        except OSError as error:
            if not SealedFiles.warned:
                SealedFiles.warned = True
                warn(f'not kept: {error}')
            return
        caching._cache_log('[cache] data saved to %r', str(path))

    def _path(self, key: Any) -> Path | None:
        folder = cache_folder()
        return None if folder is None else folder / self.name_of(key)

    def name_of(self, key: Any) -> str:
        signature = hashlib.sha256(repr((self._stamp, key)).encode()).hexdigest()
        return f'{self._name}.{signature[:32]}{self._suffix}'

    @staticmethod
    def seal_of(path: Path, content: bytes) -> bytes:
        """Hash of what the content is, and of the content: a renamed file is not whole, either."""
        digest = hashlib.sha256(f'{path.parent.name}/{path.name}\n'.encode())
        digest.update(content)
        return digest.digest()


class KernelCache(caching.FunctionCache):
    """A kernel's machine code on disk, which one process compiles while others wait for it."""

    _impl_class: Any = _Kept
    _suffix = '.nbc'

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._cache_file = SealedFiles(self._impl.filename_base, self._impl.locator, self._suffix)
        self._lock = EntryLock()

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what is kept. Else the caller has to compile it, to save it and to call
        `release`; until then other processes that want it wait.
        """
        found = self._load(sig, target_context)
        if found is not None or (folder := cache_folder()) is None:
            return found
        key = self._index_key(sig, target_context.codegen())
        if self._lock.acquire(folder, self._cache_file.name_of(key)):
            found = self._load(sig, target_context)  # compiled while we waited
        return found

    def is_kept(self, sig: Any, target_context: Any) -> bool:
        """Whether this need not be compiled, as far as is known without loading it."""
        return self._cache_file.is_there(self._index_key(sig, target_context.codegen()))

    def release(self) -> None:
        """Let others compile what was not there."""
        self._lock.release()

    def _load(self, sig: Any, target_context: Any) -> Any:
        # numba would also import all that it compiles with. What is compiled needs but this.
        rtsys.initialize(target_context)
        try:
            return self._load_overload(sig, target_context)
        except Exception:
            # Whole, but not for this Python, numpy or llvmlite. That may raise anything.
            return None


class PartCache(KernelCache):
    """The same for a part. A start that compiles nothing does not look at it."""

    _impl_class = _KeptPart
    _suffix = PART
