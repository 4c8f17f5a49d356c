# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All sides of a box that moves at once, an axis a lane: the lower ones, and the upper ones with
the other sign, so that each of them is ahead of its front where its gap is positive.

A node's fields `lower` and `upper` hold ndim numbers each, and so do their rates; as many lanes as
there are in a vector can be read where each of them begins. `fronts` holds what of a query meets
the lower sides, from HALF on what meets the upper ones, inf in other lanes; and from 2 HALF on how
fast those move. Only to prune by.
"""

import math
from functools import partial
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ..compiler.intrinsics import (
    elements_at,
    first_numbers,
    index,
    operation,
    pick,
    record_at,
    splat,
)

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


def _loaded(
    builder: Any, record: Any, kind: Any, name: str, of: Any, width: int, align: int = 4
) -> Any:
    """A field of a record and what stands behind it, as so many numbers."""
    place = builder.gep(record, [index(kind.dtype.offset(name))])
    return builder.load(builder.bitcast(place, ir.VectorType(of, width).as_pointer()), align=align)


def _field(context: Any, builder: Any, signature: Any, args: Any, name: str) -> Any:
    """A field of nodes[node], the first two arguments; zeros where it has no lane."""
    kind = signature.args[0]
    count = kind.dtype.typeof(name).shape[0]
    width = count + count % 2
    record = record_at(context, builder, kind, args[0], args[1])
    lanes = [lane if lane < count else width for lane in range(width)]
    return _lanes(builder, _loaded(builder, record, kind, name, _DOUBLE, width, 8), lanes)


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


def _folded(builder: Any, vector: Any, order: str = '') -> Any:
    """The largest or the least lane, or the sum of all."""
    fold = partial(pick, builder, order) if order else builder.fadd
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
        entry = _folded(builder, entry, '>')
        leave = pick(builder, '<', leave, later)
        leave = _folded(builder, leave, '<')
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
        return _folded(builder, builder.fmul(gaps, gaps))

    return types.float64(nodes, types.int64, fronts, types.float64), codegen


# ---- A course against the slabs of a box that moves, all axes at once: what batches decide


_BIT, _LONG = ir.IntType(1), ir.IntType(64)


def _bits(builder: Any, truths: Any) -> Any:
    return builder.zext(builder.bitcast(truths, ir.IntType(truths.type.count)), _LONG)


@intrinsic
def moving_slabs(typingctx, leaves, slot, origin, direction, since, pace, more, slowest):
    """How a course meets leaves[slot], of `leaves.leaf_dtype`, larger by `more` on all sides, if
    it is anywhere within its bounds: (whether it surely misses it, whether this cannot decide
    that it meets it, entry, leave, entered_by, others_by, surely, lanes, negative, whether it
    surely touches the box at the start). An axis along which it comes nearer more slowly than
    `slowest` bounds nothing.

    Entry is the latest, 0 or more, on the axes of the bits `lanes`, and `entered_by` when the box
    itself is surely entered on these; `others_by` on the others; leave is when the bounds are left
    first, `surely` the box; `negative` are the axes along which the course goes down.
    """
    ndim = leaves.dtype.typeof('lo').shape[0]
    width = ndim + ndim % 2
    number, bits = types.float64, types.int64
    truth = types.boolean
    result = types.Tuple((truth, truth, *(number,) * 5, bits, bits, truth))

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kind = signature.args[0]
        vector = ir.VectorType(_DOUBLE, width)
        zero, least, most = (ir.Constant(vector, [n] * width) for n in (0.0, -math.inf, math.inf))
        all_axes = index((1 << ndim) - 1)
        axes = ir.Constant(ir.VectorType(_BIT, width), [axis < ndim for axis in range(width)])
        since, pace, more, slowest = (splat(builder, one, width) for one in args[4:])
        record = record_at(context, builder, kind, args[0], args[1])
        lo = _loaded(builder, record, kind, 'lo', _DOUBLE, width)
        # Behind it lies a velocity, of which two numbers may be one below the normal doubles: to
        # multiply such a one takes a processor forty times as long.
        hi = builder.select(axes, _loaded(builder, record, kind, 'hi', _DOUBLE, width), zero)
        velocity = _loaded(builder, record, kind, 'velocity', ir.FloatType(), width)
        velocity = builder.fpext(velocity, vector)
        loose = builder.fpext(
            _loaded(builder, record, kind, 'loose', ir.FloatType(), 1), ir.VectorType(_DOUBLE, 1)
        )
        loose = splat(builder, builder.extract_element(loose, ir.Constant(_INT, 0)), width)
        start = first_numbers(context, builder, signature.args[2], args[2], ndim, width)
        travel = builder.fmul(velocity, since)
        rate = first_numbers(context, builder, signature.args[3], args[3], ndim, width)
        rate = builder.fsub(rate, builder.fmul(velocity, pace))
        below = builder.fsub(builder.fadd(builder.fsub(lo, start), travel), more)
        above = builder.fadd(builder.fadd(builder.fsub(hi, start), travel), more)
        size = operation(builder, f'llvm.fabs.v{width}f64', vector, [vector])
        slow = builder.fcmp_ordered('<', builder.call(size, [rate]), slowest)
        slow, quick = builder.and_(slow, axes), builder.and_(builder.not_(slow), axes)
        still = builder.and_(slow, builder.fcmp_ordered('==', rate, zero))
        outside = builder.or_(
            builder.fcmp_ordered('>', below, zero), builder.fcmp_ordered('<', above, zero)
        )
        inside = builder.and_(
            builder.fcmp_ordered('<', below, builder.fneg(loose)),
            builder.fcmp_ordered('>', above, loose),
        )
        missed = _bits(builder, builder.and_(still, outside))
        doubt = builder.and_(slow, builder.not_(builder.and_(still, inside)))
        inverse = builder.fdiv(ir.Constant(vector, [1.0] * width), rate)
        up = builder.fcmp_ordered('>', inverse, zero)
        at_lo, at_hi = builder.fmul(below, inverse), builder.fmul(above, inverse)
        near, far = builder.select(up, at_lo, at_hi), builder.select(up, at_hi, at_lo)
        near, far = builder.select(quick, near, least), builder.select(quick, far, most)
        later = builder.call(size, [builder.fmul(loose, inverse)])
        later = builder.select(quick, later, zero)
        entered, left = builder.fadd(near, later), builder.fsub(far, later)
        doubt = builder.or_(doubt, builder.fcmp_unordered('uno', entered, left))
        entry = pick(builder, '>', _folded(builder, near, '>'), ir.Constant(_DOUBLE, 0.0))
        latest = builder.fcmp_ordered('==', near, splat(builder, entry, width))
        latest = builder.and_(latest, builder.fcmp_ordered('>', near, zero))
        entered_by = _folded(builder, builder.select(latest, entered, zero), '>')
        others_by = _folded(builder, builder.select(latest, zero, entered), '>')
        others_by = pick(builder, '>', others_by, ir.Constant(_DOUBLE, 0.0))
        answer = (
            builder.icmp_unsigned('!=', missed, index(0)),
            builder.icmp_unsigned('!=', _bits(builder, doubt), index(0)),
            *(entry, _folded(builder, far, '<'), entered_by, others_by),
            *(_folded(builder, left, '<'), _bits(builder, latest)),
            _bits(builder, builder.and_(quick, builder.fcmp_ordered('<', inverse, zero))),
            builder.icmp_unsigned('==', _bits(builder, builder.and_(axes, inside)), all_axes),
        )
        return context.make_tuple(builder, signature.return_type, answer)

    given = leaves, types.int64, origin, direction, *(number,) * 4
    return result(*given), codegen
