# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels that Python calls, and the parts that they are made of.

By default numba optimises every jitted function, assembles it and wraps it for Python, and does
the same to its code again in each function that calls it: of ten short functions, one calling
the next, the last is optimised ten times. Here only what Python calls is. A kernel that is called
by another one is handed over simplified, and optimised there, in its place. That halves the time
of a cold start, and leaves the machine code as fast as it was.
"""

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, DefaultPassBuilder, Flags
from numba.core.compiler_machinery import register_pass
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import NativeLowering


def _same_hash(_flags: Flags) -> int:
    return _ANY_FLAGS


def _are_equal(some: Flags, other: object) -> bool:
    return some is other or (isinstance(other, Flags) and some._values == other._values)


# For every operator in a kernel numba looks up dozens of implementations by the flags it compiles
# with, and for each compares all flags by name. What is set is enough: flags that differ only in
# that one says what is so anyway count as different, and such an implementation is made twice.
_ANY_FLAGS = hash(Flags())  # by the names of flags, so that of all
Flags.__hash__ = _same_hash
Flags.__eq__ = _are_equal


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

    def add_overload(self, result: Any) -> None:
        self.overloads[tuple(result.signature.args)] = result


class Kernel(CPUDispatcher):
    """A function that Python calls, or that kernels call: these get its part."""

    def __init__(self, function: Any, options: dict[str, Any]) -> None:
        super().__init__(function, targetoptions=options)
        self._part = _Part(function, targetoptions=options, pipeline_class=_PartCompiler)

    def compile(self, sig: Any) -> Any:
        try:
            return super().compile(sig)
        finally:
            self._cache.release()

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return self._part.get_call_template(args, kws)

    def get_overload(self, sig: Any) -> Any:
        return self._part.get_overload(sig)
