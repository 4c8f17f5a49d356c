# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the decorators refuse, and a kernel that calls another one at its address."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numba.core.errors import NumbaError

from bvh_ros.tree.access import checks
from bvh_ros.tree.compiler import (
    address_of,
    called_at,
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


def scaled_sum(values, pair):
    return pair[0] * values[0] + pair[1] * values[1], values.shape[0]


def test_a_kernel_calls_another_one_at_its_address(monkeypatch):
    monkeypatch.setattr('bvh_ros.tree.compiler.kernel_sources.PACKAGE', Path(__file__).parent)
    called, values = lean_kernel(scaled_sum), np.array([2.0, 5.0])
    there = called_at(called)

    def calls(address, values, pair):
        total, count = there(address, (values, pair))
        return total + 1.0, count

    caller = lean_kernel(calls)
    address = address_of(called, values, (1, 2))
    assert entry_point(caller, address, values, (1, 2))(address, values, (3, 4)) == (27.0, 2)
    if kernel_cache.parts() is not None:
        with pytest.raises((NumbaError, TypeError), match='no code for'):
            entry_point(caller, address, values, (1.0, 2.0))
