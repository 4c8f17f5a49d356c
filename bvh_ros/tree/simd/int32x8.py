# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Eight int32 lanes at once: those of a list that a bit says are wanted."""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ..compiler.intrinsics import each, elements_at, index, operation, splat, variable

AT_ONCE = 8

_BYTE, _INT, _LONG = ir.IntType(8), ir.IntType(32), ir.IntType(64)
_EIGHT, _ROW = ir.VectorType(_INT, AT_ONCE), ir.ArrayType(_BYTE, AT_ONCE)
# For each of the 256 choices of lanes: which they are, the lowest first.
_CHOSEN = [
    sorted(range(AT_ONCE), key=lambda lane: (choice >> lane & 1 == 0, lane))
    for choice in range(1 << AT_ONCE)
]


def _rearranged(builder: Any, numbers: Any, lanes: Any) -> Any:
    """Lane i of the result is lane lanes[i] of `numbers`: one instruction where there is one."""
    found = ir.Constant(_EIGHT, ir.Undefined)
    for i in range(AT_ONCE):
        place = ir.Constant(_INT, i)
        lane = builder.extract_element(lanes, place)
        found = builder.insert_element(found, builder.extract_element(numbers, lane), place)
    return found


def _constant(builder: Any, value: Any) -> Any:
    """Pointer to a constant of the module."""
    name = builder.module.get_unique_name('lanes_chosen')
    constant = ir.GlobalVariable(builder.module, value.type, name)
    constant.initializer, constant.global_constant, constant.linkage = value, True, 'internal'
    return constant


@intrinsic
def list_met8(typingctx, lists, start, count, hits, bit, into):
    """Copy those of lists[start:start + count] whose `hits` has a bit to lists[into:], in their
    order; return where they end. `hits` is 0 for AT_ONCE - 1 more; so many numbers behind the end
    are written, too.

    Without a branch or a store for each: what a ray among others hits can't be guessed.
    """
    sig = types.int64(lists, types.int64, types.int64, hits, types.int64, types.int64)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        _, start, count, _, bit, into = args

        def eight(argument: int, first: Any) -> Any:
            kind = signature.args[argument]
            place = elements_at(context, builder, kind, args[argument], first, index(AT_ONCE))
            return builder.bitcast(place, _EIGHT.as_pointer())

        rows = [ir.Constant(_ROW, lanes) for lanes in _CHOSEN]
        table = ir.Constant(ir.ArrayType(_ROW, len(rows)), rows)
        table = _constant(builder, table)
        up = splat(builder, builder.trunc(builder.sub(index(31), bit), _INT), AT_ONCE)
        end = variable(builder, into)
        groups = builder.lshr(builder.add(count, index(AT_ONCE - 1)), index(3))
        with each(builder, groups) as number:
            first = builder.mul(number, index(AT_ONCE))
            signs = builder.shl(builder.load(eight(3, first), align=4), up)
            wanted = builder.icmp_signed('<', signs, ir.Constant(_EIGHT, [0] * AT_ONCE))
            choice = builder.bitcast(wanted, _BYTE)
            row = builder.gep(table, [index(0), builder.zext(choice, _LONG)])
            lanes = builder.load(
                builder.bitcast(row, ir.VectorType(_BYTE, AT_ONCE).as_pointer()), align=1
            )
            numbers = builder.load(eight(0, builder.add(start, first)), align=4)
            so_far = builder.load(end)
            found = _rearranged(builder, numbers, builder.zext(lanes, _EIGHT))
            builder.store(found, eight(0, so_far), align=4)
            counted = operation(builder, 'llvm.ctpop.i8', _BYTE, [_BYTE])
            more = builder.zext(builder.call(counted, [choice]), _LONG)
            builder.store(builder.add(so_far, more), end)
        return builder.load(end)

    return sig, codegen
