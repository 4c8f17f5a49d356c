# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All sides of a box that moves at once, a lane each: the lower ones, and the upper ones with the
other sign, so that each of them is ahead of its front where its gap is positive.

A node's fields `sides` and `rates` hold 2 ndim numbers each, and `EIGHT` fit where each of them
begins; `fronts` holds what of a query meets them, in the same lanes, inf where there is no side,
and from `EIGHT` on how fast that moves. Only to prune by.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from .float64x8 import EIGHT
from .intrinsics import elements_at, index, pick, record_at, splat

_INT, _DOUBLE = ir.IntType(32), ir.DoubleType()


def _width(kind: Any) -> int:
    """How many lanes the sides of a node take."""
    return 4 if kind.dtype.typeof('sides').shape[0] <= 4 else EIGHT


def _same(width: int, number: float) -> Any:
    return ir.Constant(ir.VectorType(_DOUBLE, width), [number] * width)


def _lanes(builder: Any, vector: Any, places: list[int]) -> Any:
    """Lanes of a vector, beyond the last one zeros."""
    zeros = ir.Constant(vector.type, [0.0] * vector.type.count)
    kind = ir.VectorType(_INT, len(places))
    return builder.shuffle_vector(vector, zeros, ir.Constant(kind, places))


def _field(context: Any, builder: Any, signature: Any, args: Any, name: str) -> Any:
    """A field of nodes[node], the first two arguments; zeros where it has no lane."""
    kind = signature.args[0]
    width, count = _width(kind), kind.dtype.typeof(name).shape[0]
    place = record_at(context, builder, kind, args[0], args[1])
    place = builder.gep(place, [index(kind.dtype.offset(name))])
    place = builder.bitcast(place, ir.VectorType(_DOUBLE, width).as_pointer())
    lanes = [lane if lane < count else width for lane in range(width)]
    return _lanes(builder, builder.load(place, align=8), lanes)


def _front(context: Any, builder: Any, signature: Any, args: Any, first: int) -> Any:
    """Numbers of `fronts`, the third argument, from one on."""
    width, given = _width(signature.args[0]), (signature.args[2], args[2])
    place = elements_at(context, builder, *given, index(first), index(width))
    place = builder.bitcast(place, ir.VectorType(_DOUBLE, width).as_pointer())
    return builder.load(place, align=8)


def _gaps(context: Any, builder: Any, signature: Any, args: Any, rates: Any) -> Any:
    """How far each side is ahead of its front, so long after the start: the fourth argument."""
    sides = _field(context, builder, signature, args, 'sides')
    ahead = splat(builder, args[3], sides.type.count)
    then = builder.fadd(sides, builder.fmul(rates, ahead))
    return builder.fsub(then, _front(context, builder, signature, args, 0))


def _folded(builder: Any, vector: Any, fold: Any) -> Any:
    """All lanes as one number."""
    while vector.type.count > 1:
        half = vector.type.count // 2
        low = _lanes(builder, vector, list(range(half)))
        high = _lanes(builder, vector, list(range(half, 2 * half)))
        vector = fold(low, high)
    return builder.extract_element(vector, ir.Constant(_INT, 0))


def _any(builder: Any, truths: Any) -> Any:
    bits = builder.bitcast(truths, ir.IntType(truths.type.count))
    return builder.icmp_unsigned('!=', bits, ir.Constant(bits.type, 0))


@intrinsic
def enter_sides(typingctx, nodes, node, fronts, ahead, pace):
    """(whether a course surely misses the box, where it enters it, 0 or more, where it leaves it):
    inf where it enters none of the sides that are ahead, or leaves none.
    """
    result = types.Tuple((types.boolean, types.float64, types.float64))

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        rates = _field(context, builder, signature, args, 'rates')
        width = rates.type.count
        zero, inf = _same(width, 0.0), _same(width, float('inf'))
        gaps = _gaps(context, builder, signature, args, rates)
        direction = _front(context, builder, signature, args, EIGHT)
        speeds = builder.fsub(direction, builder.fmul(rates, splat(builder, args[4], width)))
        ahead = builder.fcmp_ordered('>', gaps, zero)
        behind = builder.fcmp_ordered('<=', gaps, zero)
        missed = builder.and_(ahead, builder.fcmp_ordered('<=', speeds, zero))
        nearer = builder.and_(ahead, builder.fcmp_ordered('>', speeds, zero))
        parting = builder.and_(behind, builder.fcmp_ordered('<', speeds, zero))
        finite = builder.fcmp_ordered('>', speeds, _same(width, float('-inf')))
        parting = builder.and_(parting, finite)
        distances = builder.fdiv(gaps, speeds)
        # What is not a number is neither more nor less, and bounds nothing.
        entry = builder.select(nearer, distances, zero)
        entry = _folded(builder, entry, lambda a, b: pick(builder, '>', a, b))
        leave = builder.select(parting, distances, inf)
        leave = _folded(builder, leave, lambda a, b: pick(builder, '<', a, b))
        told = _any(builder, missed), entry, leave
        return context.make_tuple(builder, signature.return_type, told)

    given = nodes, types.int64, fronts, types.float64, types.float64
    return result(*given), codegen


@intrinsic
def is_beside(typingctx, nodes, node, fronts, ahead):
    """Whether any side is ahead of its front."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        rates = _field(context, builder, signature, args, 'rates')
        gaps = _gaps(context, builder, signature, args, rates)
        zero = _same(gaps.type.count, 0.0)
        return _any(builder, builder.fcmp_ordered('>', gaps, zero))

    return types.boolean(nodes, types.int64, fronts, types.float64), codegen


@intrinsic
def is_behind(typingctx, nodes, node, fronts, ahead, least):
    """Whether each side is behind its front, by so much at least: a number."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        rates = _field(context, builder, signature, args, 'rates')
        gaps = _gaps(context, builder, signature, args, rates)
        most = splat(builder, builder.fneg(args[4]), gaps.type.count)
        return builder.not_(_any(builder, builder.fcmp_unordered('>', gaps, most)))

    given = nodes, types.int64, fronts, types.float64, types.float64
    return types.boolean(*given), codegen


@intrinsic
def square_beside(typingctx, nodes, node, fronts, ahead):
    """Sum of the squares of the gaps of the sides that are ahead."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        rates = _field(context, builder, signature, args, 'rates')
        gaps = _gaps(context, builder, signature, args, rates)
        gaps = pick(builder, '>', gaps, _same(gaps.type.count, 0.0))
        return _folded(builder, builder.fmul(gaps, gaps), builder.fadd)

    return types.float64(nodes, types.int64, fronts, types.float64), codegen
