# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tree's own kernels with the exact decision taken out, and with float32 for float64.

They are compiled again from the same source, with another function in the place of the one that
decides. What is left is the slab test as it is usually written.
"""

from collections.abc import Callable
from functools import cache
from typing import Any
from unittest.mock import patch

import numpy as np

from ... import RayHits
from ...tree.access import OpenTree
from ...tree.batch import streams
from ...tree.compiler.compiling import inlined, rewired
from ...tree.nodes import View
from ...tree.query import ray, ray_queries, slab
from ..scenes import Boxes, Rays


@inlined
def _plain_slabs(lo, hi, ray, t_max):
    """(hit, t, axis) by rounded arithmetic."""
    entry, leave, entered = slab.rounded_slabs(lo, hi, ray, t_max)
    return entry <= leave, entry, entered


@inlined
def _plain_precedes(path, hit, other):
    handles = path.tree.handles
    return hit.t < other.t or (hit.t == other.t and handles[hit.slot] < handles[other.slot])


@inlined
def _plain_verdict(lo, hi, ray, best_t):
    hit, t, axis = _plain_slabs(lo, hi, ray, best_t)
    return streams.MEETS if hit else streams.MISSES, t, axis


@inlined
def _plain_axis(lo, hi, ray, t_max, t, entered):
    return entered


@cache
def binary_kernel() -> Any:
    """`ray.raycast_rows` without the exact decision."""
    decide = rewired(ray.decide_box, intersect_exact=_plain_slabs)
    one = rewired(ray.raycast, decide_box=decide, precedes=_plain_precedes)
    return rewired(ray.raycast_rows, raycast_row=rewired(ray.raycast_row, raycast=one))


@cache
def wide_kernel() -> Any:
    """`streams.cast_rows` without the exact decision."""
    better = rewired(streams.is_better, quick_decision=_plain_verdict)
    pile = rewired(
        streams.cast_pile,
        is_first=rewired(streams.is_first, is_better=better),
        write_hit=rewired(streams.write_hit, exact_entry_axis=_plain_axis),
    )
    return rewired(streams.cast_rows, cast_pile=pile)


def replaced(**kernels: Any) -> Any:
    """A context in which batches of rays go through other kernels, all of them large ones."""
    values: dict[str, Any] = {'FEW_RAYS': 0}
    for name, kernel in kernels.items():
        values[name] = lambda ndim, kernel=kernel: kernel
    return patch.multiple(ray_queries, **values)


def rounded_decisions() -> Any:
    """A context in which batches of rays are decided by rounded arithmetic."""
    return replaced(rows_entry=binary_kernel(), cast_entry=wide_kernel())


class BinaryTree(OpenTree):
    """A tree whose batches go through the binary tree, too: no wide snapshot."""

    def _snapshot_for(self, count: int, view: View) -> None:
        return None


def single_precision(boxes: Boxes, rays: Rays) -> Callable[[], RayHits]:
    """A batch through the binary tree whose boxes and rays are rounded to float32."""
    tree = BinaryTree.from_boxes(*boxes)
    arrays = tree.view().tree
    rounded = arrays._replace(nodes=_rounded(arrays.nodes), tight=_rounded(arrays.tight))
    kernel = binary_kernel()

    def rows(_: Any, version: int, batch: Any, hits: RayHits) -> Any:
        origins, directions, t_max = (part.astype(np.float32) for part in batch[:3])
        batch = batch._replace(origins=origins, directions=directions, t_max=t_max)
        return kernel(rounded, version, batch, hits)

    def run() -> RayHits:
        with replaced(rows_entry=rows):
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
