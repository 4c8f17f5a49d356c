# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A kernel with other parts in it, to measure what each part is worth."""

from types import FunctionType
from typing import Any

import numba


def rewired(original: Any, **calls: Any) -> Any:
    """The same kernel with the same options, compiled again with some of the functions it calls
    replaced.
    """
    python = original.py_func
    function = FunctionType(python.__code__, {**python.__globals__, **calls}, python.__name__)
    options = {
        k: v for k, v in original.targetoptions.items() if k not in ('nopython', 'boundscheck')
    }
    return numba.njit(function, **options)
