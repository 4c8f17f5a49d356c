# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""No kernel reads or writes behind the memory that it is given: it ends where a page begins that
nobody may touch. In a process of its own, which a touch ends.
"""

import ctypes
import mmap
import signal
import sys
from unittest.mock import patch

import numpy as np
import numpy.ma  # before its `empty` is another one
import pytest
from tree.compiler.alone import run_alone

from bvh_ros import DynamicBVH
from bvh_ros.tree.access import make_scratch, take_snapshot

PAGE = mmap.PAGESIZE


def guarded(shape, dtype=float):
    """As `numpy.empty`, with a page behind the last byte that is neither read nor written."""
    dtype = np.dtype(dtype)
    size = int(np.prod(shape)) * dtype.itemsize
    pages = -(-size // PAGE)
    memory = mmap.mmap(-1, (pages + 1) * PAGE)
    start = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    protect = ctypes.CDLL(None, use_errno=True).mprotect
    assert protect(ctypes.c_void_p(start + pages * PAGE), ctypes.c_size_t(PAGE), 0) == 0
    return np.frombuffer(memory, np.uint8, size, pages * PAGE - size).view(dtype).reshape(shape)


def copied(array):
    own = guarded(array.shape, array.dtype)
    own[...] = array
    return own


def guarded_parts(made):
    """A tuple of arrays and numbers, its arrays guarded."""
    parts = (copied(part) if isinstance(part, np.ndarray) else part for part in made)
    return type(made)(*parts)


def ask_everything(ndim: int, boxes: int, rays: int, decade: int) -> None:
    rng = np.random.default_rng(decade + 1000)
    lo = rng.uniform(-1, 1, (boxes, ndim)) * 10.0**decade
    hi = lo + rng.uniform(0, 0.5, lo.shape) * 10.0**decade
    tree = DynamicBVH(ndim, capacity=boxes)
    tree.insert_many(copied(lo), copied(hi))
    plain = tree.raycast_many(lo, hi)
    starts, ways = (
        copied(lo[rng.integers(0, boxes, rays)]),
        copied(hi[rng.integers(0, boxes, rays)]),
    )
    hits = tree.raycast_many(starts, ways)
    assert tree.occluded_many(starts, ways).tolist() == (hits.ids >= 0).tolist()
    # All rays hit, and all of them go the same way.
    inside = tree.raycast_many(copied(np.repeat(lo[:1], rays, axis=0)), np.ones((rays, ndim)))
    assert (inside.t == 0.0).all()
    tree.nearest_many(starts, 3)
    tree.overlap_many(copied(lo), copied(hi))
    tree.overlap_pairs()
    tree.validate()
    assert plain.ids.shape == (boxes,)


def run() -> None:
    def scratch(*sizes):
        return guarded_parts(make_scratch(*sizes))

    def take(*arguments):
        taken = take_snapshot(*arguments)
        return taken if taken is None else guarded_parts(taken)

    patch('bvh_ros.tree.query.ray_queries.scratch_for', scratch).start()
    patch('bvh_ros.tree.store.arrays.take_snapshot', take).start()
    for ndim in (2, 3):  # kernels are compiled with the `empty` that they know
        ask_everything(ndim, 40, 200, 0)
    np.empty = guarded
    for ndim in (2, 3):
        for few_rays in (0, 1000):
            patch('bvh_ros.tree.query.ray_queries.FEW_RAYS', few_rays).start()
            for boxes, rays in ((2, 64), (17, 65), (40, 200)):
                for decade in (-300, -150, -20, 0, 17, 20, 38, 100, 160, 300):
                    ask_everything(ndim, boxes, rays, decade)


@pytest.mark.skipif(not sys.platform.startswith('linux'), reason='mprotect as on Linux')
def test_nothing_behind_the_end_is_touched() -> None:
    run_alone('from tree.batch.test_guard_pages import run; run()')


def test_the_guard_guards() -> None:
    """Who touches that page is ended."""
    touch = 'from tree.batch import test_guard_pages as t; import ctypes; a = t.guarded(3); '
    touch += 'print(a.sum() == 0, flush=True); ctypes.string_at(a.ctypes.data + a.nbytes, 1)'
    ended = run_alone(touch, ends=-signal.SIGSEGV)
    assert ended.stdout == 'True\n', ended.stderr
