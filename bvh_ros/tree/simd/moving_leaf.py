# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A course against the slabs of a box that moves, all axes at once: what `wide_casting` decides
by where rounding cannot matter.
"""

import math
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ..compiler.intrinsics import elements_at, index, operation, pick, record_at, splat

_BIT, _INT, _LONG, _DOUBLE = ir.IntType(1), ir.IntType(32), ir.IntType(64), ir.DoubleType()


def _row(context: Any, builder: Any, signature: Any, args: Any, place: int, shape: Any) -> Any:
    """The first numbers of an array, and zeros."""
    ndim, width = shape
    first = elements_at(
        context, builder, signature.args[place], args[place], index(0), index(ndim)
    )
    numbers = ir.Constant(ir.VectorType(_DOUBLE, width), [0.0] * width)
    for axis in range(ndim):
        number = builder.load(builder.gep(first, [index(axis)]))
        numbers = builder.insert_element(numbers, number, ir.Constant(_INT, axis))
    return numbers


def _field(builder: Any, record: Any, kind: Any, name: str, of: Any, width: int) -> Any:
    """A field of a record and what stands behind it, as so many numbers."""
    vector = ir.VectorType(of, width)
    place = builder.gep(record, [index(kind.dtype.offset(name))])
    return builder.load(builder.bitcast(place, vector.as_pointer()), align=4)


def _folded(builder: Any, vector: Any, order: str) -> Any:
    """The largest or the least lane."""
    while vector.type.count > 1:
        half = vector.type.count // 2
        kind = ir.VectorType(_INT, half)
        low, high = (
            builder.shuffle_vector(vector, vector, ir.Constant(kind, [*range(k, k + half)]))
            for k in (0, half)
        )
        vector = pick(builder, order, low, high)
    return builder.extract_element(vector, ir.Constant(_INT, 0))


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
        kind, shape = signature.args[0], (ndim, width)
        vector = ir.VectorType(_DOUBLE, width)
        zero, least, most = (ir.Constant(vector, [n] * width) for n in (0.0, -math.inf, math.inf))
        all_axes = index((1 << ndim) - 1)
        axes = ir.Constant(ir.VectorType(_BIT, width), [axis < ndim for axis in range(width)])
        since, pace, more, slowest = (splat(builder, one, width) for one in args[4:])
        record = record_at(context, builder, kind, args[0], args[1])
        lo = _field(builder, record, kind, 'lo', _DOUBLE, width)
        # Behind it lies a velocity, of which two numbers may be one below the normal doubles: to
        # multiply such a one takes a processor forty times as long.
        hi = builder.select(axes, _field(builder, record, kind, 'hi', _DOUBLE, width), zero)
        velocity = _field(builder, record, kind, 'velocity', ir.FloatType(), width)
        velocity = builder.fpext(velocity, vector)
        loose = builder.fpext(
            _field(builder, record, kind, 'loose', ir.FloatType(), 1), ir.VectorType(_DOUBLE, 1)
        )
        loose = splat(builder, builder.extract_element(loose, ir.Constant(_INT, 0)), width)
        start = _row(context, builder, signature, args, 2, shape)
        travel = builder.fmul(velocity, since)
        rate = _row(context, builder, signature, args, 3, shape)
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
