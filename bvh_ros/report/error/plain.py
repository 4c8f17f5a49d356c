# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tree's own kernels with the exact decision taken out, and with float32 for float64.

They are compiled again from the same source, with another function in the place of the one that
decides. What is left is the slab test as it is usually written.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from types import FunctionType
from typing import Any

import numba
import numpy as np

from ... import DynamicBVH, RayHits
from ...tree.rays import ray_hits, raycasting
from ...tree.store.arrays import View
from ...tree.wide import best_hit
from ...tree.wide import raycasting as wide_raycasting
from ..scenes import Boxes, Rays


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


@numba.njit(error_model='numpy', forceinline=True, _nrt=False)
def _plain_slabs(lo, hi, ray, leave):
    """(met, t, axis) by rounded arithmetic."""
    entry, leave, entered = best_hit.rounded_slabs(lo, hi, ray, leave)
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
    return best_hit.MEETS if met else best_hit.MISSES, t, axis


@numba.njit(error_model='numpy', forceinline=True, _nrt=False)
def _plain_axis(lo, hi, ray, t_max, t, entered):
    return entered


@cache
def binary_kernel() -> Any:
    """`ray_hits.raycast_rows` without the exact decision."""
    one = rewired(raycasting.raycast, intersect_exact=_plain_meets, is_before=_plain_is_before)
    return rewired(ray_hits.raycast_rows, raycast=one)


@cache
def wide_kernel() -> Any:
    """`wide.raycasting.cast_rows` without the exact decision."""
    better = rewired(best_hit.is_better, quick_decision=_plain_verdict)
    visit = rewired(wide_raycasting.visit_leaf, is_better=better)
    group = rewired(
        wide_raycasting.cast_group,
        traverse=rewired(wide_raycasting.traverse, visit_leaf=visit),
        write_hits=rewired(wide_raycasting.write_hits, exact_entry_axis=_plain_axis),
    )
    return rewired(wide_raycasting.cast_rows, cast_group=group)


@contextmanager
def replaced(cast_rows: Any, raycast_rows: Any) -> Iterator[None]:
    """Batches of rays go through other kernels."""
    kept = wide_raycasting.cast_rows, ray_hits.raycast_rows
    wide_raycasting.cast_rows, ray_hits.raycast_rows = cast_rows, raycast_rows
    try:
        yield
    finally:
        wide_raycasting.cast_rows, ray_hits.raycast_rows = kept


def rounded_decisions() -> Any:
    """A context in which batches of rays are decided by rounded arithmetic."""
    return replaced(wide_kernel(), binary_kernel())


class BinaryTree(DynamicBVH):
    """A tree whose batches go through the binary tree, too: no wide snapshot."""

    def _snapshot_for(self, count: int, view: View) -> None:
        return None


def single_precision(boxes: Boxes, rays: Rays) -> Callable[[], RayHits]:
    """A batch through the binary tree whose boxes and rays are rounded to float32."""
    tree = BinaryTree.from_boxes(*boxes)
    storage = tree._storage
    nodes, tight = _rounded(storage.nodes), _rounded(storage.tight)
    tree._storage = storage._replace(nodes=nodes, tight=tight)
    kernel = binary_kernel()

    def rows(*arguments: Any) -> Any:
        view, rays, rest = arguments[:5], arguments[5:8], arguments[8:]
        return kernel(*view, *(array.astype(np.float32) for array in rays), *rest)

    def run() -> RayHits:
        with replaced(wide_raycasting.cast_rows, rows):
            return tree.raycast_many(*rays)

    return run


def _rounded(records: Any) -> Any:
    """Records with the planes of their boxes in float32."""
    fields = [
        (name, np.float32 if name in ('lo', 'hi') else kind.base, kind.shape)
        for name, (kind, _) in records.dtype.fields.items()
    ]
    with np.errstate(all='ignore'):  # free places hold anything
        return records.astype(fields)
