# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the decorators refuse."""

from typing import NamedTuple

import pytest

from bvh_ros.tree.jit import inside
from bvh_ros.tree.jit.compiling import entry_point, inlined


class Interval(NamedTuple):
    lo: int
    hi: int


@inlined
def as_interval(number):
    return Interval(number, number)


@inlined
def as_tuple(number):
    return number, number


def test_what_a_kernel_returns_is_made_without_python():
    """A signal handler that raises while numba makes a NamedTuple would end the process."""
    if inside.parts() is None:
        pytest.skip('there are entry points only with the inside of numba')
    assert entry_point(as_tuple, 1)(2) == (2, 2)
    with pytest.raises(TypeError, match='plain tuple'):
        entry_point(as_interval, 1)
