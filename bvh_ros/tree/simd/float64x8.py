# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Eight float64 lanes at once, for queries that share their way through the tree.

Comparisons and differences are the same doubles as one by one: nothing here is a filter that needs
a pad.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ..compiler.intrinsics import elements_at, index, operation, pick, record_at, splat

EIGHT = 8
WHEN = 3  # the row of times in a packet of points

_DOUBLE = ir.DoubleType()
_VECTOR = ir.VectorType(_DOUBLE, EIGHT)


def _field(context: Any, builder: Any, kind: Any, records: Any, row: Any, name: str) -> Any:
    """Pointer to the doubles of a field of records[row]."""
    record = record_at(context, builder, kind, records, row)
    place = builder.gep(record, [index(kind.dtype.offset(name))])
    return builder.bitcast(place, _DOUBLE.as_pointer())


def _eight_at(context: Any, builder: Any, kind: Any, array: Any, at: Any) -> Any:
    """Pointer to eight doubles from array[at] on."""
    first = elements_at(context, builder, kind, array, at, index(EIGHT))
    return builder.bitcast(first, _VECTOR.as_pointer())


def _load8(builder: Any, doubles: Any, at: Any) -> Any:
    place = builder.bitcast(builder.gep(doubles, [at]), _VECTOR.as_pointer())
    return builder.load(place, align=8)


def _load_all(builder: Any, doubles: Any, at: Any) -> Any:
    """One double in all lanes."""
    return splat(builder, builder.load(builder.gep(doubles, [at])), EIGHT)


def _bits(builder: Any, truths: Any) -> Any:
    return builder.zext(builder.bitcast(truths, ir.IntType(EIGHT)), ir.IntType(32))


@intrinsic
def gap_squares8(typingctx, nodes, node, points, squares, at):
    """squares[at:at + 8] = squared distances of eight points (ndim rows of eight) from the box of
    a node.
    """
    axes = range(nodes.dtype.typeof('lo').shape[0])

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind, _, points_kind, squares_kind, _ = signature.args
        nodes, node, points, squares, at = args
        lo = _field(context, builder, kind, nodes, node, 'lo')
        hi = _field(context, builder, kind, nodes, node, 'hi')
        total = None
        for axis in axes:
            row = _eight_at(context, builder, points_kind, points, index(axis * EIGHT))
            point = builder.load(row, align=8)
            below = builder.fsub(_load_all(builder, lo, index(axis)), point)
            above = builder.fsub(point, _load_all(builder, hi, index(axis)))
            outside = pick(builder, '>', below, above)
            gap = pick(builder, '>', outside, ir.Constant(_VECTOR, [0.0] * 8))
            square = builder.fmul(gap, gap)
            total = square if total is None else builder.fadd(total, square)
        builder.store(total, _eight_at(context, builder, squares_kind, squares, at), align=8)
        return context.get_dummy_value()

    return types.void(nodes, node, points, squares, at), codegen


@intrinsic
def moving_squares8(typingctx, nodes, node, points, squares, at):
    """The same of bounds that move, see `moving_sides`, only to prune by: row WHEN of the
    points is how long after the start of their span.
    """
    axes = range(nodes.dtype.typeof('lower').shape[0])

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind, _, points_kind, squares_kind, _ = signature.args
        nodes, node, points, squares, at = args
        fused = operation(builder, 'llvm.fma.v8f64', _VECTOR, [_VECTOR] * 3)

        def row(axis: int) -> Any:
            place = _eight_at(context, builder, points_kind, points, index(axis * EIGHT))
            return builder.load(place, align=8)

        def side(name: str, axis: int) -> Any:
            parts = []
            for part in (f'{name}_rates', name):
                field = _field(context, builder, kind, nodes, node, part)
                parts.append(_load_all(builder, field, index(axis)))
            return builder.call(fused, [parts[0], ahead, parts[1]])

        zero, ahead = ir.Constant(_VECTOR, [0.0] * 8), row(WHEN)
        total = zero
        for axis in axes:
            point = row(axis)
            below = builder.fsub(side('lower', axis), point)
            above = builder.fadd(side('upper', axis), point)
            gap = pick(builder, '>', pick(builder, '>', below, above), zero)
            total = builder.call(fused, [gap, gap, total])
        builder.store(total, _eight_at(context, builder, squares_kind, squares, at), align=8)
        return context.get_dummy_value()

    return types.void(nodes, node, points, squares, at), codegen


@intrinsic
def at_most8(typingctx, values, at, limits):
    """Bit mask of the lanes in which values[at:at + 8] <= limits[:8]."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        values = _eight_at(context, builder, signature.args[0], args[0], args[1])
        limits = _eight_at(context, builder, signature.args[2], args[2], index(0))
        values, limits = builder.load(values, align=8), builder.load(limits, align=8)
        return _bits(builder, builder.fcmp_ordered('<=', values, limits))

    return types.uint32(values, at, limits), codegen


@intrinsic
def count_bits(typingctx, bits):
    """How many bits are set."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.ctpop(args[0])

    return types.uint32(bits), codegen


@intrinsic
def touching8(typingctx, blocks, block, others, other, lane):
    """Bit mask of the eight boxes of a block that touch the box in one lane of another block.

    A block's fields `lo` and `hi` hold ndim rows of eight; NaN touches nothing.
    """
    axes = range(blocks.dtype.typeof('lo').shape[0])
    types_of = types.uint32(blocks, types.int64, others, types.int64, types.int64)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind, other_kind = signature.args[0], signature.args[2]
        blocks, block, others, other, lane = args
        lo = _field(context, builder, kind, blocks, block, 'lo')
        hi = _field(context, builder, kind, blocks, block, 'hi')
        other_lo = _field(context, builder, other_kind, others, other, 'lo')
        other_hi = _field(context, builder, other_kind, others, other, 'hi')
        touch = ir.Constant(ir.VectorType(ir.IntType(1), EIGHT), [1] * EIGHT)
        for axis in axes:
            row, at = index(axis * EIGHT), builder.add(lane, index(axis * EIGHT))
            low, high = _load8(builder, lo, row), _load8(builder, hi, row)
            below = _load_all(builder, other_hi, at)
            above = _load_all(builder, other_lo, at)
            touch = builder.and_(touch, builder.fcmp_ordered('<=', low, below))
            touch = builder.and_(touch, builder.fcmp_ordered('>=', high, above))
        return _bits(builder, touch)

    return types_of, codegen
