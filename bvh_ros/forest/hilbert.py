# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Cells of a grid in the order of a Hilbert curve: consecutive ones are neighbours."""

import itertools
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

CELL_BITS = 4  # an axis


def cells(centers: NDArray[np.float64], lo: Any, hi: Any) -> NDArray[np.int64]:
    """Number on the curve of the cell of each center, shape (n, ndim), in a grid over the box from
    `lo` to `hi`: from 0 to ``2**(CELL_BITS * ndim) - 1``.
    """
    lo, hi = np.asarray(lo), np.asarray(hi)
    half = np.maximum(hi * 0.5 - lo * 0.5, 1e-300)
    place = (centers * 0.5 - lo * 0.5) / half  # halves: a difference of finite doubles is finite
    last = (1 << CELL_BITS) - 1
    columns = np.clip(place * (last + 1), 0, last).astype(np.int64).T
    return _numbers(centers.shape[1])[tuple(columns)]


@cache
def _numbers(ndim: int) -> NDArray[np.int64]:
    """The number of every cell, shape (2**CELL_BITS,) * ndim."""
    numbers = np.empty((1 << CELL_BITS,) * ndim, np.int64)
    for cell in itertools.product(range(1 << CELL_BITS), repeat=ndim):
        numbers[cell] = _number(list(cell))
    return numbers


def _number(axes: list[int]) -> int:
    """Skilling 2004, "Programming the Hilbert curve": from a cell to the bits of its number, which
    come out transposed.
    """
    bit = 1 << (CELL_BITS - 1)
    while bit > 1:
        for i in range(len(axes)):
            if axes[i] & bit:
                axes[0] ^= bit - 1
            else:
                flipped = (axes[0] ^ axes[i]) & (bit - 1)
                axes[0] ^= flipped
                axes[i] ^= flipped
        bit >>= 1
    for i in range(1, len(axes)):
        axes[i] ^= axes[i - 1]
    flips, bit = 0, 1 << (CELL_BITS - 1)
    while bit > 1:
        if axes[-1] & bit:
            flips ^= bit - 1
        bit >>= 1
    number = 0
    for level in reversed(range(CELL_BITS)):
        for axis in axes:
            number = number << 1 | ((axis ^ flips) >> level & 1)
    return number
