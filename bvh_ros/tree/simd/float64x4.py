# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Four float64 lanes at once: the axes of a ray."""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ..compiler.intrinsics import elements_at, first_numbers, index, operation, pick, splat

FOUR = 4

_INT, _DOUBLE = ir.IntType(32), ir.DoubleType()
_LONGS = ir.VectorType(ir.IntType(64), FOUR)
_VECTOR, _NARROW = ir.VectorType(_DOUBLE, FOUR), ir.VectorType(ir.FloatType(), FOUR)


def _each(builder: Any, name: str, *operands: Any) -> Any:
    """LLVM's function of this name, lane by lane."""
    function = operation(builder, f'llvm.{name}.v4f64', _VECTOR, [_VECTOR] * len(operands))
    return builder.call(function, operands)


def _moved_row(context: Any, builder: Any, kind: Any, given: Any, ndim: int) -> Any:
    """The numbers of an array, or of (an array, another, so many times which it loses)."""
    if isinstance(kind, types.Array):
        return first_numbers(context, builder, kind, given, ndim, FOUR)
    start, direction, times = (builder.extract_value(given, place) for place in range(3))
    direction = first_numbers(context, builder, kind[1], direction, ndim, FOUR)
    # -0.0 becomes 0.0, or a -0.0 that loses nothing would lose its sign.
    zero = ir.Constant(_VECTOR, [0.0] * FOUR)
    lost = builder.fadd(builder.fmul(direction, splat(builder, times, FOUR)), zero)
    return builder.fsub(first_numbers(context, builder, kind[0], start, ndim, FOUR), lost)


def _any(builder: Any, truths: Any) -> Any:
    bits = builder.bitcast(truths, ir.IntType(FOUR))
    return builder.icmp_unsigned('!=', bits, ir.Constant(bits.type, 0))


def _all(builder: Any, truths: Any) -> Any:
    bits = builder.bitcast(truths, ir.IntType(FOUR))
    return builder.icmp_unsigned('==', bits, ir.Constant(bits.type, -1))


def _octant(builder: Any, direction: Any) -> Any:
    """Bit k: the number of lane k has a sign."""
    signs = builder.bitcast(direction, _LONGS)
    negative = builder.icmp_signed('<', signs, ir.Constant(_LONGS, [0] * FOUR))
    return builder.zext(builder.bitcast(negative, ir.IntType(FOUR)), ir.IntType(64))


def _largest(builder: Any, numbers: Any) -> Any:
    """The largest lane; none is less than 0."""
    lanes = [builder.extract_element(numbers, ir.Constant(_INT, i)) for i in range(FOUR - 1)]
    return pick(builder, '>', pick(builder, '>', lanes[0], lanes[1]), lanes[2])


@intrinsic
def set_slopes(typingctx, ray, origin, direction, center, per_length, bounds):
    """Write how a ray meets planes, `slope`, `near_shift`, `far_shift` and `octant` of a record as
    of `filtering.ray_dtype`; what lies in the four bytes behind the first three is lost. Returns
    the largest component of the direction, and whether the ray is within `bounds`. Origin and
    direction are arrays, or each (an array, another, so many times which it loses).

    `bounds`, float64: how far an origin may be, least and largest component that is not zero; how
    large an inverse becomes, and the pad.
    """
    ndim = ray.typeof('slope').shape[0]
    result = types.Tuple((types.float64, types.boolean))

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        def row(argument: int) -> Any:
            kind = signature.args[argument]
            return _moved_row(context, builder, kind, args[argument], ndim)

        def store(name: str, numbers: Any) -> None:
            place = builder.gep(record, [index(ray.offset(name))])
            place = builder.bitcast(place, _NARROW.as_pointer())
            builder.store(builder.fptrunc(numbers, _NARROW), place, align=4)

        record = builder.bitcast(args[0], ir.IntType(8).as_pointer())
        given = (builder.extract_value(args[5], place) for place in range(5))
        farthest, least, most, steepest, pad = (splat(builder, one, FOUR) for one in given)
        direction, zero, one = row(2), *(ir.Constant(_VECTOR, [n] * FOUR) for n in (0.0, 1.0))
        length = _each(builder, 'fabs', direction)
        largest = _largest(builder, length)
        inverse = builder.fdiv(splat(builder, largest, FOUR), direction)
        steepness = pick(builder, '<', _each(builder, 'fabs', inverse), steepest)
        slope = _each(builder, 'copysign', steepness, inverse)
        start = builder.fsub(row(1), row(3))
        start = builder.fmul(start, splat(builder, args[4], FOUR))
        distance = _each(builder, 'fabs', start)
        pad = builder.fmul(builder.fmul(pad, steepness), builder.fadd(one, distance))
        shift = builder.fneg(builder.fmul(start, slope))
        octant = builder.trunc(_octant(builder, direction), ir.IntType(8))
        builder.store(octant, builder.gep(record, [index(ray.offset('octant'))]))
        store('slope', slope)
        store('near_shift', builder.fsub(shift, pad))
        store('far_shift', builder.fadd(shift, pad))
        within = builder.and_(
            builder.fcmp_ordered('>', length, least), builder.fcmp_ordered('<', length, most)
        )
        within = builder.or_(within, builder.fcmp_ordered('==', length, zero))
        within = builder.and_(within, builder.fcmp_ordered('<', distance, farthest))
        return context.make_tuple(builder, signature.return_type, (largest, _all(builder, within)))

    return result(ray, origin, direction, center, per_length, bounds), codegen


@intrinsic
def look_ahead(typingctx, ray, origin, direction, whole):
    """Whether a ray begins beyond a box on an axis and comes no nearer there, so that it meets
    nothing in it, exactly; one that is not finite does not. And its octant, bit k: it flies down
    axis k, as its slope does, that of -0.0, too.

    `whole` is the box' lower and upper corner, FOUR numbers each; `ray` a record as of
    `filtering.ray_dtype`, which says how many axes there are, and no more.
    """
    ndim = ray.typeof('slope').shape[0]
    result = types.Tuple((types.boolean, types.int64))

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        def side(first: int) -> Any:
            kind = signature.args[3]
            place = elements_at(context, builder, kind, args[3], index(first), index(FOUR))
            return builder.load(builder.bitcast(place, _VECTOR.as_pointer()), align=8)

        start, along = (
            first_numbers(context, builder, signature.args[k], args[k], ndim, FOUR) for k in (1, 2)
        )
        zero = ir.Constant(_VECTOR, [0.0] * FOUR)
        above = builder.and_(
            builder.fcmp_ordered('>', start, side(FOUR)), builder.fcmp_ordered('>=', along, zero)
        )
        below = builder.and_(
            builder.fcmp_ordered('<', start, side(0)), builder.fcmp_ordered('<=', along, zero)
        )
        nothing = builder.fadd(builder.fsub(start, start), builder.fsub(along, along))
        finite = _all(builder, builder.fcmp_ordered('==', nothing, zero))
        away = builder.and_(_any(builder, builder.or_(above, below)), finite)
        return context.make_tuple(builder, signature.return_type, (away, _octant(builder, along)))

    return result(ray, origin, direction, whole), codegen
