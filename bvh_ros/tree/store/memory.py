# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Memory of arrays."""

import mmap
from typing import Any

import numpy as np
from numpy.typing import NDArray


def touch(array: NDArray[Any]) -> None:
    """Have the system give the memory of a new array now: write to each page what is there."""
    array.view(np.uint8)[:: mmap.PAGESIZE] += 0


def copy_bytes(array: NDArray[Any], into: NDArray[Any]) -> None:
    """Copy an array to the begin of another one: of records numpy would copy field by field."""
    into.view(np.uint8)[: array.nbytes] = array.view(np.uint8)
