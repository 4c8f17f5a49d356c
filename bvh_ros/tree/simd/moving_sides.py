# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All sides of a box that moves at once, an axis a lane: the lower ones, and the upper ones with
the other sign, so that each of them is ahead of its front where its gap is positive.

A node's fields `lower` and `upper` hold ndim numbers each, and so do their rates; as many lanes as
there are in a vector can be read where each of them begins. `fronts` holds what of a query meets
the lower sides, from HALF on what meets the upper ones, inf in other lanes; and from 2 HALF on how
fast those move. Only to prune by.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ..compiler.intrinsics import elements_at, index, operation, pick, record_at, splat

HALF = 4
FRONTS = 4 * HALF

_INT, _DOUBLE = ir.IntType(32), ir.DoubleType()
_FIELDS = ('lower', 'lower_rates'), ('upper', 'upper_rates')


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
    count = kind.dtype.typeof(name).shape[0]
    width = count + count % 2
    place = record_at(context, builder, kind, args[0], args[1])
    place = builder.gep(place, [index(kind.dtype.offset(name))])
    place = builder.bitcast(place, ir.VectorType(_DOUBLE, width).as_pointer())
    lanes = [lane if lane < count else width for lane in range(width)]
    return _lanes(builder, builder.load(place, align=8), lanes)


def _front(context: Any, builder: Any, signature: Any, args: Any, first: int, width: int) -> Any:
    """Numbers of `fronts`, the third argument, from one on."""
    given = signature.args[2], args[2]
    place = elements_at(context, builder, *given, index(first), index(width))
    place = builder.bitcast(place, ir.VectorType(_DOUBLE, width).as_pointer())
    return builder.load(place, align=8)


def _multiplied(builder: Any, one: Any, other: Any, more: Any) -> Any:
    """one * other + more, rounded once."""
    kind = one.type
    name = f'llvm.fma.v{kind.count}f64'
    return builder.call(operation(builder, name, kind, [kind] * 3), [one, other, more])


def _gaps(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    """How far the lower and the upper sides are ahead of their fronts, so long after the start:
    the fourth argument; and their rates.
    """
    gaps, rates = [], []
    for half, (name, speed) in enumerate(_FIELDS):
        rate = _field(context, builder, signature, args, speed)
        side, width = _field(context, builder, signature, args, name), rate.type.count
        then = _multiplied(builder, rate, splat(builder, args[3], width), side)
        front = _front(context, builder, signature, args, half * HALF, width)
        gaps.append(builder.fsub(then, front))
        rates.append(rate)
    return gaps, rates


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
        found = []
        for half, (gaps, rates) in enumerate(
            zip(*_gaps(context, builder, signature, args), strict=True)
        ):
            width = gaps.type.count
            zero, inf = _same(width, 0.0), _same(width, float('inf'))
            first = (2 + half) * HALF
            direction = _front(context, builder, signature, args, first, width)
            back = builder.fneg(splat(builder, args[4], width))
            speeds = _multiplied(builder, rates, back, direction)
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
            found.append((missed, entry, builder.select(parting, distances, inf)))
        (missed, entry, leave), (also, other, later) = found
        entry = pick(builder, '>', entry, other)
        entry = _folded(builder, entry, lambda a, b: pick(builder, '>', a, b))
        leave = pick(builder, '<', leave, later)
        leave = _folded(builder, leave, lambda a, b: pick(builder, '<', a, b))
        answer = _any(builder, builder.or_(missed, also)), entry, leave
        return context.make_tuple(builder, signature.return_type, answer)

    given = nodes, types.int64, fronts, types.float64, types.float64
    return result(*given), codegen


@intrinsic
def is_beside(typingctx, nodes, node, fronts, ahead):
    """Whether any side is ahead of its front."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        lower, upper = _gaps(context, builder, signature, args)[0]
        zero = _same(lower.type.count, 0.0)
        ahead = (builder.fcmp_ordered('>', gaps, zero) for gaps in (lower, upper))
        return _any(builder, builder.or_(*ahead))

    return types.boolean(nodes, types.int64, fronts, types.float64), codegen


@intrinsic
def is_behind(typingctx, nodes, node, fronts, ahead, least):
    """Whether each side is behind its front, by so much at least: a number."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        lower, upper = _gaps(context, builder, signature, args)[0]
        most = splat(builder, builder.fneg(args[4]), lower.type.count)
        ahead = (builder.fcmp_unordered('>', gaps, most) for gaps in (lower, upper))
        return builder.not_(_any(builder, builder.or_(*ahead)))

    given = nodes, types.int64, fronts, types.float64, types.float64
    return types.boolean(*given), codegen


@intrinsic
def square_beside(typingctx, nodes, node, fronts, ahead):
    """Sum over the axes of the square of the larger gap, if it is ahead."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        gaps = pick(builder, '>', *_gaps(context, builder, signature, args)[0])
        gaps = pick(builder, '>', gaps, _same(gaps.type.count, 0.0))
        return _folded(builder, builder.fmul(gaps, gaps), builder.fadd)

    return types.float64(nodes, types.int64, fronts, types.float64), codegen
