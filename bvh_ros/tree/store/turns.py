# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whose turn it is: any number of queries at a time, or one change.

Each kernel that walks through the tree takes its turn when it begins and gives it back when it
ends, with one atomic instruction each on a word of the state array. No signal handler runs within
a kernel and none raises an exception, so no turn is ever left behind, whatever interrupts the
Python around it. Contending calls fail at once with a RuntimeError.

What takes several kernels names the version of the tree that the first one saw, and the others
refuse any other one.
"""

from typing import Any

from numba import types
from numba.extending import intrinsic

from ..compiler import elements_at, index, inlined
from ..nodes import CHANGES, EXACT_RAYS, RAYS, TURN

ANY_VERSION = -1

# The word counts queries; these are far below zero, whatever is counted on top of them.
CHANGING = -(1 << 40)
UNFILLED = -(1 << 50)  # storage that waits for what it is to hold

# Why a kernel did nothing.
QUERIED, CHANGED = -1, -2
# Why a query of one box or ray did nothing: its numbers are not finite, or it got no turn.
NOT_FINITE, REFUSED = -2, -3
IS_QUERIED = 'the tree is being queried by another thread'
IS_CHANGED = 'the tree is being changed by another thread'


@intrinsic
def add_atomically(typingctx, array, place, amount):
    """array[place] += amount (an int64 array); what it was before."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        word = elements_at(context, builder, signature.args[0], args[0], args[1], index(1))
        return builder.atomic_rmw('add', word, args[2], 'acq_rel')

    return types.int64(array, types.int64, types.int64), codegen


@intrinsic
def replace_atomically(typingctx, array, place, expected, value):
    """array[place] = value if it is as expected (an int64 array); what it was before."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        word = elements_at(context, builder, signature.args[0], args[0], args[1], index(1))
        previous = builder.cmpxchg(word, args[2], args[3], 'acq_rel', 'acquire')
        return builder.extract_value(previous, 0)

    return types.int64(array, types.int64, types.int64, types.int64), codegen


@inlined
def begin_query(state, version):
    """Whether there is a turn, and the tree is of this version (or ANY_VERSION will do)."""
    if add_atomically(state, TURN, 1) >= 0 and (
        version == ANY_VERSION or state[CHANGES] == version
    ):
        return True
    add_atomically(state, TURN, -1)
    return False


@inlined
def end_query(state):
    add_atomically(state, TURN, -1)


def accepted(done: int) -> int:
    """What a query's kernel returned; RuntimeError if that is negative: it did not get a turn."""
    if done < 0:
        raise RuntimeError(IS_CHANGED)
    return done


@inlined
def count_rays(state, rays, exact):
    """Count rays, and those of them that took exact arithmetic, while others do."""
    add_atomically(state, RAYS, rays)
    add_atomically(state, EXACT_RAYS, exact)


@inlined
def begin_change(state, version):
    """0 if there is a turn, and the tree is of this version; else QUERIED or CHANGED."""
    previous = replace_atomically(state, TURN, 0, CHANGING)
    if previous != 0:
        return QUERIED if previous > 0 else CHANGED
    if version != ANY_VERSION and state[CHANGES] != version:
        add_atomically(state, TURN, -CHANGING)
        return CHANGED
    return 0


@inlined
def end_change(state, changed):
    """Give the turn back; `changed`: the tree is of another version now."""
    state[CHANGES] += changed
    add_atomically(state, TURN, -CHANGING)
