# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The decorators for compiled functions."""

import os
from collections.abc import Callable
from types import FunctionType
from typing import Any

import numba
from numba.core import config
from numba.core.compiler_lock import global_compiler_lock

from .kernel_cache import KernelCache, cache_folder

# Versions of numba whose insides are known to be what `kernel_parts` and `kernel_cache` build on.
# With another one kernels are compiled in numba's own way: as right and as fast, but a cold start
# takes twice as long, and each installation has its own.
KNOWN = (0, 62), (0, 68)

if hasattr(os, 'register_at_fork'):
    # Who forks waits until no thread compiles: its child would have the lock for ever, and nobody
    # in it who gives it back.
    os.register_at_fork(
        before=global_compiler_lock.acquire,
        after_in_parent=global_compiler_lock.release,
        after_in_child=global_compiler_lock.release,
    )


def _compiled(function: Callable[..., Any], **options: Any) -> Any:
    options = {'error_model': 'numpy', 'nogil': True, **options}
    if not KNOWN[0] <= numba.version_info.short <= KNOWN[1]:
        return _compiled_by_numba(function, options)
    from .kernel_parts import Kernel

    # C does not call us.
    compiled = Kernel(function, {'nopython': True, 'no_cfunc_wrapper': True, **options})
    compiled._cache = KernelCache(function)
    return compiled


def _compiled_by_numba(function: Callable[..., Any], options: dict[str, Any]) -> Any:
    folder = cache_folder()
    # numba reads its cache folder when a function is decorated; other users of numba in this
    # process keep their own.
    theirs = config.CACHE_DIR
    config.CACHE_DIR = str(folder)
    try:
        return numba.njit(function, cache=folder is not None, **options)
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


def rewired(original: Any, **calls: Any) -> Any:
    """The same kernel with the same options, compiled again, for this process only, with some of
    the functions it calls replaced.
    """
    python = original.py_func
    function = FunctionType(python.__code__, {**python.__globals__, **calls}, python.__name__)
    own = 'nopython', 'boundscheck', 'no_cfunc_wrapper'
    return numba.njit(
        function, **{k: v for k, v in original.targetoptions.items() if k not in own}
    )


def entry_point(compiled: Any, *arguments: Any) -> Callable[..., Any]:
    """Return the machine code of a kernel for arguments of exactly these types. It does not check
    the types of what it is given: other types are undefined behaviour.

    numba's dispatcher looks at the types of all arguments at every call. For twelve arrays that
    takes 0.4 us, as long as a ray; for twelve in a NamedTuple, 1.3 us.
    """
    code: Callable[..., Any] = compiled.compile(tuple(map(numba.typeof, arguments)))
    return code
