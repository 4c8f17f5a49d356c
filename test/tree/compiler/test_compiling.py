# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the decorators refuse."""

import pytest

from bvh_ros.scene.cast.query import no_hit
from bvh_ros.scene.cast.shapes import radius_of
from bvh_ros.tree import checks
from bvh_ros.tree.compiler import entry_point, inlined, inside, kernel, lean_kernel


def test_what_a_kernel_returns_is_made_without_python():
    """A signal handler that raises while numba makes a NamedTuple would end the process."""
    if inside.parts() is None:
        pytest.skip('there are entry points only with the inside of numba')
    with pytest.raises(TypeError, match='plain tuple'):
        entry_point(no_hit)


def test_a_kernel_is_inlined_where_it_says_so_only():
    """numba hands the wish on to what it compiles meanwhile, unless that says what it wants."""
    if inside.parts() is None:
        pytest.skip('only with the inside of numba')
    for decorate, wanted in ((kernel, False), (lean_kernel, False), (inlined, True)):
        made = decorate(checks.first_not_finite.py_func)
        assert made.targetoptions['forceinline'] is wanted


def test_a_function_that_types_choose_is_for_kernels():
    with pytest.raises(TypeError, match='radius_of is for kernels only'):
        radius_of(1.0)
