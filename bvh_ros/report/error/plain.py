# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tree's own kernels with the exact decision taken out, and with float32 for float64.

They are compiled again from the same source, with another function in the place of the one that
decides. What is left is the slab test as it is usually written.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from types import FunctionType
from typing import Any

import numba
import numpy as np

from ...tree import DynamicBVH, raycasting, wide_raycasting
from ...tree.nodes import ALL
from ...tree.slab import INSIDE, INVERSE, ORIGIN
from ..scenes import Rays
from .scoring import Answer


def rewired(original: Any, **calls: Any) -> Any:
    """The same kernel with the same options, some of the functions it calls replaced."""
    python = original.py_func
    function = FunctionType(python.__code__, {**python.__globals__, **calls}, python.__name__)
    options = {k: v for k, v in original.targetoptions.items() if k not in ('nopython', 'boundscheck')}
    return numba.njit(function, **options)


@numba.njit(error_model='numpy', forceinline=True, _nrt=False)
def _plain_slabs(lo, hi, ray, leave):
    """(met, t, axis) by rounded arithmetic."""
    entry = 0.0
    entered = INSIDE
    for axis in range(lo.shape[0]):
        inverse = ray[INVERSE, axis]
        at_lo = (lo[axis] - ray[ORIGIN, axis]) * inverse
        at_hi = (hi[axis] - ray[ORIGIN, axis]) * inverse
        near, far = (at_lo, at_hi) if inverse > 0.0 else (at_hi, at_lo)
        if near > entry:
            entry, entered = near, axis
        leave = far if far < leave else leave
    return entry <= leave, entry, entered


@numba.njit(error_model='numpy', forceinline=True, _nrt=False)
def _plain_meets(lo, hi, ray, t_max):
    return _plain_slabs(lo, hi, ray, t_max)


@numba.njit(error_model='numpy', forceinline=True, _nrt=False)
def _plain_is_before(nodes, tight, handles, ray, slot, t, axis, other, other_t, other_axis):
    return t < other_t or (t == other_t and handles[slot] < handles[other])


@numba.njit(error_model='numpy', forceinline=True, _nrt=False)
def _plain_verdict(lo, hi, ray, best_t):
    met, t, axis = _plain_slabs(lo, hi, ray, best_t)
    return wide_raycasting.MEETS if met else wide_raycasting.MISSES, t, axis


@cache
def binary_kernel() -> Any:
    """`raycasting.raycast_rows` without the exact decision."""
    one = rewired(raycasting.raycast, meets=_plain_meets, is_before=_plain_is_before)
    return rewired(raycasting.raycast_rows, raycast=one)


@cache
def wide_kernel() -> Any:
    """`wide_raycasting.cast_rows` without the exact decision."""
    return rewired(
        wide_raycasting.cast_rows,
        cast=rewired(wide_raycasting.cast, quick_decision=_plain_verdict),
    )


@contextmanager
def rounded_decisions() -> Iterator[None]:
    """Batches of rays are decided by rounded arithmetic."""
    kept = wide_raycasting.cast_rows, raycasting.raycast_rows
    wide_raycasting.cast_rows, raycasting.raycast_rows = wide_kernel(), binary_kernel()
    try:
        yield
    finally:
        wide_raycasting.cast_rows, raycasting.raycast_rows = kept


class BinaryCast:
    """Rays through the binary tree, in their order, by one kernel.

    Parameters
    ----------
    kernel
        `raycasting.raycast_rows` or its `binary_kernel`.
    number
        float64, or float32 for boxes and rays rounded to that.
    """

    def __init__(self, tree: DynamicBVH, rays: Rays, kernel: Any, number: type = np.float64):
        nodes, tight, handles, root = tree._tree()
        self._kernel = kernel
        self._tree = _as(nodes, number), _as(tight, number), handles, root
        self._rays = rays.origins.astype(number), rays.directions.astype(number)
        self._scratch = np.empty((3, tree.ndim), number)

    def __call__(self) -> Answer:
        """Cast all rays; rows are the places among the tree's ids."""
        count = len(self._rays[0])
        slots, ts, axes = np.empty(count, np.int64), np.empty(count), np.empty(count, np.int64)
        limits = np.full(count, np.inf), np.full(count, ALL, np.uint32)
        self._kernel(
            *self._tree, self._scratch, *self._rays, *limits, False, raycasting.CLOSEST,
            np.arange(count), slots, ts, axes,
        )
        # A tree built from boxes at once gives its slots out in their order.
        return Answer(slots, ts)


def _as(records: Any, number: type) -> Any:
    """Records with the planes of their boxes rounded to another type."""
    if number is np.float64:
        return records
    fields = [
        (name, number if name in ('lo', 'hi') else kind.base, kind.shape)
        for name, (kind, _) in records.dtype.fields.items()
    ]
    with np.errstate(all='ignore'):  # free places hold anything
        return records.astype(fields)
