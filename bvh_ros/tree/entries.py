# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How Python calls the kernels of a tree: as machine code, see `compiling.entry_point`."""

import functools
from collections.abc import Callable
from typing import Any

from .compiler import entry_point
from .nodes import empty_tree


def entry_points(
    kernel: Any, *arguments: Any, alongside: Callable[[int], object] | None = None
) -> Callable[[int], Callable[..., Any]]:
    """Return what gives, for a number of dimensions, the `entry_point` of a kernel of a tree and
    arguments of these types; compiled or loaded at its first use. An argument whose type depends
    on that number is a function of it. `alongside` takes it, too, see `entry_point`.
    """

    @functools.cache
    def of_dimensions(ndim: int) -> Callable[..., Any]:
        others = (argument(ndim) if callable(argument) else argument for argument in arguments)
        next_one = None if alongside is None else functools.partial(alongside, ndim)
        return entry_point(kernel, empty_tree(ndim), *others, alongside=next_one)

    return of_dimensions
