# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tree's own kernels with the exact decision taken out, and with float32 for float64.

They are compiled again from the same source, with another function in the place of the one that
decides. What is left is the slab test as it is usually written.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np

from ... import DynamicBVH, RayHits
from ...tree.batch import streams as best_hit
from ...tree.batch import streams as wide_raycasting
from ...tree.compiler.compiling import inlined, rewired
from ...tree.nodes import View
from ...tree.query import ray as ray_hits
from ...tree.query import ray as raycasting
from ...tree.query import ray_queries as ray_batches
from ...tree.query import slab as slab
from ..scenes import Boxes, Rays


@inlined
def _plain_slabs(lo, hi, ray, leave):
    """(met, t, axis) by rounded arithmetic."""
    entry, leave, entered = slab.rounded_slabs(lo, hi, ray, leave)
    return entry <= leave, entry, entered


@inlined
def _plain_meets(lo, hi, ray, t_max):
    return _plain_slabs(lo, hi, ray, t_max)


@inlined
def _plain_is_before(tree, ray, hit, other):
    return hit[1] < other[1] or (
        hit[1] == other[1] and tree.handles[hit[0]] < tree.handles[other[0]]
    )


@inlined
def _plain_verdict(lo, hi, ray, best_t):
    met, t, axis = _plain_slabs(lo, hi, ray, best_t)
    return best_hit.MEETS if met else best_hit.MISSES, t, axis


@inlined
def _plain_axis(lo, hi, ray, t_max, t, entered):
    return entered


@cache
def binary_kernel() -> Any:
    """`ray_hits.raycast_rows` without the exact decision."""
    one = rewired(raycasting.raycast, intersect_exact=_plain_meets, is_before=_plain_is_before)
    return rewired(ray_hits.raycast_rows, raycast_row=rewired(ray_hits.raycast_row, raycast=one))


@cache
def wide_kernel() -> Any:
    """`wide.raycasting.cast_rows` without the exact decision."""
    better = rewired(best_hit.is_better, quick_decision=_plain_verdict)
    pile = rewired(
        wide_raycasting.cast_pile,
        is_first=rewired(wide_raycasting.is_first, is_better=better),
        write_hit=rewired(wide_raycasting.write_hit, exact_entry_axis=_plain_axis),
    )
    return rewired(wide_raycasting.cast_rows, cast_pile=pile)


@contextmanager
def replaced(**kernels: Any) -> Iterator[None]:
    """Batches of rays go through other kernels, all of them large ones."""
    kept = {name: getattr(ray_batches, name) for name in ('rows_entry', 'cast_entry')}
    kept['FEW_RAYS'] = ray_batches.FEW_RAYS
    try:
        ray_batches.FEW_RAYS = 0
        for name, kernel in kernels.items():
            setattr(ray_batches, name, lambda ndim, kernel=kernel: kernel)
        yield
    finally:
        for name, value in kept.items():
            setattr(ray_batches, name, value)


def rounded_decisions() -> Any:
    """A context in which batches of rays are decided by rounded arithmetic."""
    return replaced(rows_entry=binary_kernel(), cast_entry=wide_kernel())


class BinaryTree(DynamicBVH):
    """A tree whose batches go through the binary tree, too: no wide snapshot."""

    def snapshot_for(self, count: int, view: View) -> None:
        return None


def single_precision(boxes: Boxes, rays: Rays) -> Callable[[], RayHits]:
    """A batch through the binary tree whose boxes and rays are rounded to float32."""
    tree = BinaryTree.from_boxes(*boxes)
    arrays = tree.view().tree
    rounded = arrays._replace(nodes=_rounded(arrays.nodes), tight=_rounded(arrays.tight))
    kernel = binary_kernel()

    def rows(_: Any, version: int, asked: Any, hits: RayHits) -> Any:
        origins, directions, t_max = (part.astype(np.float32) for part in asked[:3])
        asked = asked._replace(origins=origins, directions=directions, t_max=t_max)
        return kernel(rounded, version, asked, hits)

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
