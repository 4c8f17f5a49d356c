# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The decorators for compiled functions."""

from collections.abc import Callable
from types import FunctionType
from typing import Any

import numba
from numba import types
from numba.extending import overload

from . import inside, kernel_cache
from .workers import is_here, run_beside

kernel_cache.parts = inside.parts


def _compiled(function: Callable[..., Any], **private: Any) -> Any:
    """A kernel; `private` are options that numba does not document. `forceinline` is always among
    them, as a kernel that does not say it takes it from the one in which it is compiled first.
    """
    options = {'error_model': 'numpy', 'nogil': True}
    parts = inside.parts()
    if parts is None:
        return numba.njit(function, **options)
    return parts.Kernel(function, {**options, **private})


def kernel(function: Callable[..., Any]) -> Any:
    """Compile with numba at the first call, keep the machine code on disk, and release the GIL
    while running.

    Division by zero follows IEEE 754, as in numpy. `fastmath` stays off: a kernel that decides
    must round as written.
    """
    return _compiled(function, _nrt=True, forceinline=False)


def lean_kernel(function: Callable[..., Any]) -> Any:
    """A kernel that makes no arrays, and so need not count references.

    Counting is two atomic operations for every array passed to a function: ten arrays a ray cost
    more than the ray.
    """
    return _compiled(function, _nrt=False, forceinline=False)


def inlined(function: Callable[..., Any]) -> Any:
    """A lean kernel that becomes part of its callers."""
    return _compiled(function, _nrt=False, forceinline=True)


def chosen_by_types(choose: Callable[..., Any]) -> Callable[..., Any]:
    """A function for kernels: the kernel that `choose` returns for the types of its arguments.

    numba compiles both sides of `x is None`, whatever the type of x: a result that is None on one
    side has another type then, and all that takes it is compiled for both.
    """

    def called(*arguments: Any) -> Any:
        raise TypeError(f'{choose.__name__} is for kernels only')

    parts = inside.parts()
    if parts is not None:
        parts.choose_kernels(called, choose)
        return called

    @overload(called, jit_options={'error_model': 'numpy'}, strict=False)
    def wrap(*types: Any) -> Callable[..., Any]:
        chosen = choose(*types)
        return lambda *arguments: chosen(*arguments)

    return called


def rewired(original: Any, **calls: Any) -> Any:
    """The same kernel with the same options, compiled again, for this process only, with some of
    the functions it calls replaced.
    """
    python = original.py_func
    if unknown := calls.keys() - {*python.__code__.co_names}:
        raise NameError(f'{python.__name__} does not call {sorted(unknown)}')
    function = FunctionType(python.__code__, {**python.__globals__, **calls}, python.__name__)
    own = 'nopython', 'boundscheck', 'no_cfunc_wrapper'
    return numba.njit(
        function, **{k: v for k, v in original.targetoptions.items() if k not in own}
    )


def entry_point(
    compiled: Any, *arguments: Any, alongside: Callable[[], object] | None = None
) -> Callable[..., Any]:
    """Return the machine code of a kernel for arguments of exactly these types. It does not check
    the types of what it is given: other types are undefined behaviour. Where it has to be
    compiled, another process calls `alongside` meanwhile: that compiles what will be wanted next.

    numba's dispatcher looks at the types of all arguments at every call. For twelve arrays that
    takes 0.4 us, as long as a ray; for twelve in a NamedTuple, 1.3 us.
    """
    code: Callable[..., Any] = compiled
    signature = tuple(map(numba.typeof, arguments))
    if inside.parts() is not None:
        if alongside is not None and not compiled.is_kept(signature):
            run_beside(alongside)
        code = compiled.compile(signature)
        if isinstance(compiled.overloads[signature].signature.return_type, types.BaseNamedTuple):
            # numba makes it with Python code; where a signal handler raises in that, it crashes.
            raise TypeError(f'{compiled.py_func.__name__} must return a plain tuple')
    return code


def address_of(compiled: Any, *arguments: Any) -> int:
    """Return where the machine code of a kernel for arguments of exactly these types is, for
    `called_at`.
    """
    if inside.parts() is None:
        return 0
    address: int = compiled.address_of(tuple(map(numba.typeof, arguments)))
    return address


def called_at(compiled: Any) -> Any:
    """A function for kernels: call(address, arguments) runs the machine code that another kernel
    has at an address, as of `address_of`. What calls it holds no copy, which would be compiled
    for a second time.
    """
    parts = inside.parts()
    if parts is None:
        return numba.njit(lambda address, arguments: compiled(*arguments))
    return parts.called_at(compiled)


def prepare(compiled: Any, *arguments: Any) -> None:
    """Compile what becomes a part of kernels that get arguments of these types, while another
    process compiles what else they are made of. Only in a worker: loading kernels needs none.
    """
    if inside.parts() is not None and is_here():
        compiled.prepare(tuple(map(numba.typeof, arguments)))
