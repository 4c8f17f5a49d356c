# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels that Python calls, and the parts that they are made of.

By default numba optimises every jitted function, assembles it and wraps it for Python, and does
the same to its code again in each function that calls it: of ten short functions, one calling
the next, the last is optimised ten times. Here only what Python calls is. A kernel that is called
by another one is handed over simplified, and optimised there, in its place. That halves the time
of a cold start, and leaves the machine code as fast as it was.
"""

import contextlib
import gc
import hashlib
import os
from collections.abc import Iterator
from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import register_pass
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.typed_passes import NativeLowering
from numba.core.types import IntegerLiteral, Record
from numba.core.types.misc import unliteral

from .kernel_files import KernelCache

if hasattr(os, 'register_at_fork'):
    # Who forks waits until no thread compiles: its child would have the lock for ever, and nobody
    # in it who gives it back.
    os.register_at_fork(
        before=global_compiler_lock.acquire,
        after_in_parent=global_compiler_lock.release,
        after_in_child=global_compiler_lock.release,
    )


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


class _Code(JITCodeLibrary):
    """The code of a part: it is linked into those who call it, and nowhere else."""

    def _optimize_final_module(self) -> None:
        """Simplify, so that whoever calls it sees how little there is to inline.

        Left as it is, code is inlined otherwise than numba would (a swept ball took a quarter
        longer), and is more work for every caller.
        """
        passes, builder = self._codegen._module_pass_manager(
            loop_vectorize=False, slp_vectorize=False, opt=0, cost='cheap'
        )
        passes.run(self._final_module, builder)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _LowerPart(NativeLowering):
    """numba's last step, without machine code or a way in from Python."""

    _name = 'lower_part'

    def run_pass(self, state: Any) -> bool:
        flags = state.flags
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        state.library = _Code(state.targetctx.codegen(), state.func_id.func_qualname)
        super().run_pass(state)
        # What callers know it by; elsewhere that is the function that Python would call.
        entry = object()
        lowered = state['cr']
        state.targetctx.insert_user_function(entry, lowered.fndesc, [state.library])
        state['cr'] = lowered._replace(cfunc=entry)
        return True


class _PartCompiler(Compiler):
    def define_pipelines(self) -> list[Any]:
        steps = DefaultPassBuilder.define_nopython_pipeline(self.state)
        steps.passes = [
            (_LowerPart if step is NativeLowering else step, text) for step, text in steps.passes
        ]
        steps.finalize()
        return [steps]


class _Part(CPUDispatcher):
    """A function as other kernels call it."""

    def compile(self, sig: Any) -> Any:
        with _records_named_by_fields():
            return super().compile(sig)

    def add_overload(self, result: Any) -> None:
        self.overloads[tuple(result.signature.args)] = result


class Kernel(CPUDispatcher):
    """A function that Python calls, or that kernels call: these get its part."""

    def __init__(self, function: Any, options: dict[str, Any]) -> None:
        options = {'nopython': True, 'no_cfunc_wrapper': True, **options}  # C does not call us
        super().__init__(function, targetoptions=options)
        self._part = _Part(function, targetoptions=options, pipeline_class=_PartCompiler)
        self._cache = KernelCache(function)

    def compile(self, sig: Any) -> Any:
        """Return the machine code for these types."""
        with _records_named_by_fields(), _garbage_is_seldom_looked_for():
            try:
                return super().compile(sig)
            finally:
                self._cache.release()

    def is_kept(self, sig: Any) -> bool:
        """Whether the machine code for these types need not be compiled."""
        return self._cache.is_kept(sig, self.targetctx)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """One part for a number written in the call and one that is computed, not two."""
        args = tuple(unliteral(one) if isinstance(one, IntegerLiteral) else one for one in args)
        return self._part.get_call_template(args, kws)

    def get_overload(self, sig: Any) -> Any:
        return self._part.get_overload(sig)


def code_generator() -> tuple[str, str, str]:
    """Return the triple, processor and features that numba names machine code by."""
    found: tuple[str, str, str] = cpu_target.target_context.codegen().magic_tuple()
    return found
