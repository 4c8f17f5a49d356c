# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels that Python calls, and the parts that they are made of.

By default numba optimises every jitted function, assembles it and wraps it for Python, and does
the same to its code again in each function that calls it: of ten short functions, one calling
the next, the last is optimised ten times. Here only what Python calls is. A kernel that is called
by another one is handed over simplified, and optimised there, in its place. That halves the time
of a cold start, and leaves the machine code as fast as it was. What it was simplified to is kept,
so that kernels which share parts can be compiled in several processes, and each part in one.
"""

import contextlib
import gc
import hashlib
import itertools
import os
import secrets
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any, ClassVar

from numba.core.bytecode import FunctionIdentity
from numba.core.cgutils import if_unlikely, unpack_tuple
from numba.core.compiler import Compiler, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import register_pass
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.typed_passes import InlineOverloads, NativeLowering, NopythonRewrites
from numba.core.types import BooleanLiteral, Dispatcher, Function, IntegerLiteral, Record
from numba.core.types.misc import unliteral
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.core.untyped_passes import InlineClosureLikes, InlineInlinables
from numba.extending import intrinsic

from .kernel_files import KernelCache, PartCache, PartCode
from .workers import is_here


def _count_from_anywhere() -> None:
    """numba puts a number into the name of each function, and counts from 1 in every process. Two
    functions in parts from two processes must not have one name.
    """
    FunctionIdentity._unique_ids = itertools.count(secrets.randbits(60))


_count_from_anywhere()
if hasattr(os, 'register_at_fork'):
    # A fork waits until no thread compiles, or looks for what is kept: else its child would have
    # this lock, or one that is taken below it, and no thread that releases it.
    os.register_at_fork(
        before=global_compiler_lock.acquire,
        after_in_parent=global_compiler_lock.release,
        after_in_child=global_compiler_lock.release,
    )
    os.register_at_fork(after_in_child=_count_from_anywhere)


def _name_by_fields(record: Record) -> tuple[str, tuple[int]]:
    return 'Record', (int(hashlib.sha256(record.name.encode()).hexdigest()[:15], 16),)


_BY_FIELDS = property(_name_by_fields)


@contextlib.contextmanager
def _records_named_by_fields() -> Iterator[None]:
    """While this thread compiles, and no other one, name record types by a hash of their fields.

    numba puts a number into the name of machine code that takes a record type, and counts record
    types anew in every process. So code for 2D nodes from one process and code for 3D nodes from
    another could have one name, and a process that loaded both ran one in place of the other.
    """
    with global_compiler_lock:
        theirs = Record.mangling_args
        Record.mangling_args = _BY_FIELDS  # type: ignore[assignment, method-assign]
        try:
            yield
        finally:
            Record.mangling_args = theirs  # type: ignore[method-assign]


@contextlib.contextmanager
def _garbage_is_seldom_looked_for() -> Iterator[None]:
    """numba makes millions of small objects: with Python's threshold of 700 a tenth of the time
    goes into looking for cycles among them; with this one 2 %, and 20 MB more.
    """
    first, *others = gc.get_threshold()
    gc.set_threshold(max(first, 200_000) if first else 0, *others)
    try:
        yield
    finally:
        gc.set_threshold(first, *others)


@contextlib.contextmanager
def _calls_typed_once() -> Iterator[None]:
    """While a kernel is compiled, look up the signature of each call once.

    numba does so again in each round in which it infers types, seven times on average: 6 % of the
    time of a cold start. Must run with numba's compiler lock held.
    """
    context = cpu_target.typing_context
    if 'resolve_function_type' in vars(context):  # for the kernel that calls this one
        yield
        return
    look_up = context.resolve_function_type
    known: dict[Any, Any] = {}

    def resolve(called: Any, args: Any, kws: Any) -> Any:
        call = called, tuple(args)
        try:
            found = None if kws else known.get(call)
        except TypeError:  # the type of a literal slice has no hash
            return look_up(called, args, kws)
        if found is None:
            found = look_up(called, args, kws)
            if not kws:
                known[call] = found
        return found

    context.resolve_function_type = resolve
    try:
        yield
    finally:
        del context.resolve_function_type


NOTICE = 'bvh_ros: compiling for this machine, once; later starts load it'
SILENT = 1.0  # seconds of compiling, all in all, of which nothing is said

_silent_left = SILENT


def _say() -> None:
    print(NOTICE, file=sys.stderr, flush=True)


@contextlib.contextmanager
def _notice() -> Iterator[None]:
    """While something is compiled: a first use takes seconds, and would seem to hang. Said once,
    to people only: where standard error is a terminal, and not by a worker.
    """
    global _silent_left
    if _silent_left <= 0.0 or is_here() or sys.stderr is None or not sys.stderr.isatty():
        yield
        return
    timer, began = threading.Timer(_silent_left, _say), time.monotonic()
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        _silent_left -= time.monotonic() - began


@register_pass(mutates_CFG=True, analysis_only=False)
class _LowerPart(NativeLowering):
    """numba's last step, without machine code or a way in from Python."""

    _name = 'lower_part'

    def run_pass(self, state: Any) -> bool:
        flags = state.flags
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        state.library = PartCode(state.targetctx.codegen(), state.func_id.func_qualname)
        super().run_pass(state)
        # What callers know it by; elsewhere that is the function that Python would call.
        entry = object()
        lowered = state['cr']
        state.targetctx.insert_user_function(entry, lowered.fndesc, [state.library])
        state['cr'] = lowered._replace(cfunc=entry)
        return True


def _number_of(function: Any) -> int:
    """A part has one name in all processes: where two that call it are linked, it is there once.
    Of closures there may be several in one place.
    """
    if function.func.__closure__:
        return int(function.unique_id)
    place = f'{function.modname} {function.firstlineno} {function.func_qualname}'
    return int(hashlib.sha256(place.encode()).hexdigest()[:15], 16)


# Steps of numba that change nothing in kernels without closures and without expressions of whole
# arrays, and take 5 % of the time.
IDLE = InlineClosureLikes, InlineInlinables, InlineOverloads, NopythonRewrites


class _KernelCompiler(Compiler):
    last_step = NativeLowering

    def define_pipelines(self) -> list[Any]:
        steps = DefaultPassBuilder.define_nopython_pipeline(self.state)
        steps.passes = [
            (self.last_step if step is NativeLowering else step, text)
            for step, text in steps.passes
            if step not in IDLE
        ]
        steps.finalize()
        return [steps]


class _PartCompiler(_KernelCompiler):
    last_step = _LowerPart

    def define_pipelines(self) -> list[Any]:
        self.state.func_id.unique_id = _number_of(self.state.func_id)
        return super().define_pipelines()


class _Part(CPUDispatcher):
    """A function as other kernels call it."""

    def __init__(self, function: Any, options: dict[str, Any]) -> None:
        super().__init__(function, targetoptions=options, pipeline_class=_PartCompiler)
        # What a closure holds has no name that other processes know it by.
        self._files = None if function.__closure__ else PartCache(function)

    def compile(self, sig: Any) -> Any:
        """Have it ready for these types. numba would count time at every step, once for each of
        the functions that wait for this one: a tenth of all.
        """
        with _records_named_by_fields(), _calls_typed_once():
            args = tuple(sig)
            if args not in self.overloads:
                self.add_overload(self._ready(args))

    def _ready(self, args: Any) -> Any:
        """What was kept, or what is compiled, and kept from now on."""
        if self._files is None:
            return self._compiler.compile(args, None)
        try:
            found = self._files.load_overload(args, self.targetctx)
            if found is None:
                found = self._compiler.compile(args, None)
                self._files.save_overload(args, found)
                return found
        finally:
            self._files.release()
        found = found._replace(entry_point=object())
        self.targetctx.insert_user_function(found.entry_point, found.fndesc, [found.library])
        return found

    def add_overload(self, result: Any) -> None:
        self.overloads[tuple(result.signature.args)] = result


class Kernel(CPUDispatcher):
    """A function that Python calls, or that kernels call: these get its part."""

    def __init__(self, function: Any, options: dict[str, Any]) -> None:
        options = {'nopython': True, 'no_cfunc_wrapper': True, **options}  # C does not call us
        super().__init__(function, targetoptions=options, pipeline_class=_KernelCompiler)
        self._part = _Part(function, options)
        self._cache = KernelCache(function)

    def compile(self, sig: Any) -> Any:
        """Return the machine code for these types."""
        shown = contextlib.nullcontext() if self.is_kept(sig) else _notice()
        with (
            _records_named_by_fields(),
            _garbage_is_seldom_looked_for(),
            _calls_typed_once(),
            shown,
        ):
            try:
                return super().compile(sig)
            finally:
                self._cache.release()

    def prepare(self, sig: Any) -> None:
        """Have what kernels get that call this one with these types."""
        with _garbage_is_seldom_looked_for():
            self._part.compile(sig)

    def address_of(self, sig: Any) -> int:
        """Where the machine code for these types is."""
        self.compile(sig)
        code = self.overloads[sig]
        address: int = code.library.get_pointer_to_function(code.fndesc.llvm_func_name)
        return address

    def is_kept(self, sig: Any) -> bool:
        """Whether the machine code for these types need not be compiled."""
        with global_compiler_lock:
            return self._cache.is_kept(sig, self.targetctx)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """One part for a number written in the call and one that is computed, not two."""
        written = IntegerLiteral, BooleanLiteral
        args = tuple(unliteral(one) if isinstance(one, written) else one for one in args)
        return self._part.get_call_template(args, kws)

    def get_overload(self, sig: Any) -> Any:
        return self._part.get_overload(sig)


def choose_kernels(called: Any, choose: Any) -> None:
    """In kernels, a call of `called` is one of the `Kernel` that `choose` returns for the types of
    the arguments. numba's `overload` would compile a function around it, in each process.
    """

    class Chosen(AbstractTemplate):
        key = called
        entries: ClassVar[dict[Any, Any]] = {}

        def generic(self, args: Any, kws: Any) -> Any:
            kernel = Dispatcher(choose(*args, **kws))
            signature: Any = kernel.get_call_type(self.context, args, kws)
            self.entries[signature.args] = kernel.get_overload(signature)
            return signature

        def get_impl_key(self, sig: Any) -> Any:
            return self.entries[sig.args]

    infer_global(called, Function(Chosen))


def called_at(compiled: Kernel) -> Any:
    """As `compiling.called_at`."""

    @intrinsic
    def call(typingctx: Any, address: Any, arguments: Any) -> Any:
        code = compiled.overloads.get(arguments.types)
        if code is None:
            raise TypeError(f'{compiled.py_func.__name__} has no code for {arguments.types}')
        result, kinds = code.signature.return_type, arguments.types

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            called = context.call_conv.get_function_type(result, kinds).as_pointer()
            place, values = builder.inttoptr(args[0], called), unpack_tuple(builder, args[1])
            status, value = context.call_conv.call_function(builder, place, result, kinds, values)
            with if_unlikely(builder, status.is_error):
                context.call_conv.return_status_propagate(builder, status)
            return value

        return result(address, arguments), codegen

    return call


def code_generator() -> tuple[str, str, str]:
    """Return the triple, processor and features that numba names machine code by."""
    with global_compiler_lock:
        found: tuple[str, str, str] = cpu_target.target_context.codegen().magic_tuple()
    return found
