# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the decorators refuse."""

from pathlib import Path
from typing import NamedTuple

import pytest

from bvh_ros.tree.access import checks
from bvh_ros.tree.compiler import (
    chosen_by_types,
    entry_point,
    inlined,
    kernel,
    kernel_cache,
    lean_kernel,
)


class Pair(NamedTuple):
    first: int
    second: int


def pair():
    return Pair(1, 2)


def test_what_a_kernel_returns_is_made_without_python(monkeypatch):
    """A signal handler that raises while numba makes a NamedTuple would end the process."""
    if kernel_cache.parts() is None:
        pytest.skip('there are entry points only with the inside of numba')
    monkeypatch.setattr('bvh_ros.tree.compiler.kernel_sources.PACKAGE', Path(__file__).parent)
    with pytest.raises(TypeError, match='plain tuple'):
        entry_point(lean_kernel(pair))


def test_a_kernel_is_inlined_where_it_says_so_only():
    """numba hands the wish on to what it compiles meanwhile, unless that says what it wants."""
    if kernel_cache.parts() is None:
        pytest.skip('only with the inside of numba')
    for decorate, wanted in ((kernel, False), (lean_kernel, False), (inlined, True)):
        made = decorate(checks.first_not_finite.py_func)
        assert made.targetoptions['forceinline'] is wanted


def test_a_function_that_types_choose_is_for_kernels():
    with pytest.raises(TypeError, match='pair is for kernels only'):
        chosen_by_types(pair)()
