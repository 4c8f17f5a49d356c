# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What numba's own language lacks: small arrays on the stack, and LLVM's vector operations."""

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array

LANES = 8  # floats of a box: lower and upper bounds, padded
WIDTH = 16  # children of a wide node

_FLOAT, _BIT, _INT = ir.FloatType(), ir.IntType(1), ir.IntType(32)
_VECTOR = ir.VectorType(_FLOAT, LANES)
_WIDE = ir.VectorType(_FLOAT, WIDTH)


@intrinsic(prefer_literal=True)
def stack_array(typingctx, size, dtype):
    """Uninitialised array of a constant `size` that lives until the calling kernel returns; it
    must not be returned.
    """
    kind = types.Array(dtype.dtype, 1, 'C')
    length = size.literal_value

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        item = context.get_data_type(kind.dtype)
        room = cgutils.alloca_once(builder, ir.ArrayType(item, length))
        array = make_array(kind)(context, builder)
        extent = context.get_constant(types.intp, length)
        step = context.get_constant(types.intp, context.get_abi_sizeof(item))
        data = builder.bitcast(room, item.as_pointer())
        populate_array(
            array, data=data, shape=[extent], strides=[step], itemsize=step, meminfo=None
        )
        return array._getvalue()

    return kind(size, dtype), codegen


def _splat(builder: Any, scalar: Any, vector: Any = _WIDE) -> Any:
    empty = ir.Constant(vector, ir.Undefined)
    one = builder.insert_element(empty, scalar, ir.Constant(_INT, 0))
    return builder.shuffle_vector(one, empty, ir.Constant(ir.VectorType(_INT, WIDTH), [0] * WIDTH))


def _pick(builder: Any, order: str, a: Any, b: Any) -> Any:
    return builder.select(builder.fcmp_ordered(order, a, b), a, b)


@intrinsic
def slab16(typingctx, planes, base, near, far, inverse, near_shift, far_shift, limit, entries):
    """Test one ray against the sixteen boxes that begin at planes[base]; entries get the bits of
    their distances (see `float_bits`); returns a bit mask of hits.

    near, far: where the near and far planes of each axis begin in a node, a tuple of ndim ints
    each; inverse, near_shift, far_shift: tuples of ndim float32. The distance of a plane is
    fma(plane, inverse, shift).
    """
    sig = types.uint32(planes, base, near, far, inverse, near_shift, far_shift, limit, entries)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        out = context.make_array(signature.args[-1])(context, builder, args[-1]).data
        base, near, far, inverse, near_shift, far_shift, limit = args[1:8]
        fma = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(_WIDE, [_WIDE] * 3), 'llvm.fma.v16f32'
        )

        def distance(offsets: Any, shifts: Any, axis: int) -> Any:
            place = builder.gep(data, [builder.add(base, builder.extract_value(offsets, axis))])
            plane = builder.load(builder.bitcast(place, _WIDE.as_pointer()), align=4)
            slope = _splat(builder, builder.extract_value(inverse, axis))
            return builder.call(
                fma, [plane, slope, _splat(builder, builder.extract_value(shifts, axis))]
            )

        entry, leave = ir.Constant(_WIDE, [0.0] * WIDTH), _splat(builder, limit)
        for axis in range(signature.args[2].count):
            entry = _pick(builder, '>', distance(near, near_shift, axis), entry)
            leave = _pick(builder, '<', distance(far, far_shift, axis), leave)
        builder.store(entry, builder.bitcast(out, _WIDE.as_pointer()), align=4)
        return builder.zext(
            builder.bitcast(builder.fcmp_ordered('<=', entry, leave), ir.IntType(WIDTH)), _INT
        )

    return sig, codegen


@intrinsic
def seen16(typingctx, masks, at, mask):
    """Bit mask of those of masks[at:at + 16] that have a bit of `mask` (uint32)."""
    sig = types.uint32(masks, types.int64, types.uint32)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        words = ir.VectorType(_INT, WIDTH)
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        place = builder.bitcast(builder.gep(data, [args[1]]), words.as_pointer())
        common = builder.and_(builder.load(place, align=4), _splat(builder, args[2], words))
        seen = builder.icmp_unsigned('!=', common, ir.Constant(words, [0] * WIDTH))
        return builder.zext(builder.bitcast(seen, ir.IntType(WIDTH)), _INT)

    return sig, codegen


@intrinsic
def float_bits(typingctx, number):
    """The bits of a float32 as an integer; of numbers that are not negative they have their
    order.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], _INT)

    return types.int32(number), codegen


@intrinsic
def trailing_zeros(typingctx, bits):
    """Number of zero bits below the lowest one; `bits` is not zero."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(_BIT, 1))

    return types.uint32(bits), codegen


def _vector_at(context: Any, builder: Any, kind: Any, array: Any, place: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [place]), _VECTOR.as_pointer())


@intrinsic
def largest8(typingctx, into, at, values, start):
    """into[at:at + 8] = the larger of it and values[start:start + 8], float by float (float32
    arrays).
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        here = _vector_at(context, builder, signature.args[0], args[0], args[1])
        there = _vector_at(context, builder, signature.args[2], args[2], args[3])
        a, b = builder.load(here, align=4), builder.load(there, align=4)
        builder.store(_pick(builder, '>', a, b), here, align=4)
        return context.get_dummy_value()

    return types.void(into, at, values, start), codegen


@intrinsic
def swap8(typingctx, values, i, j):
    """Exchange values[i:i + 8] and values[j:j + 8] (a float32 array)."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        here = _vector_at(context, builder, signature.args[0], args[0], args[1])
        there = _vector_at(context, builder, signature.args[0], args[0], args[2])
        a, b = builder.load(here, align=4), builder.load(there, align=4)
        builder.store(b, here, align=4)
        builder.store(a, there, align=4)
        return context.get_dummy_value()

    return types.void(values, i, j), codegen


@intrinsic
def largest_difference8(typingctx, into, at, values, start):
    """As `largest8`, with each float less the one of the other half: of [-lo, hi] that is [-(lo +
    hi), lo + hi].
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        here = _vector_at(context, builder, signature.args[0], args[0], args[1])
        there = _vector_at(context, builder, signature.args[2], args[2], args[3])
        a, b = builder.load(here, align=4), builder.load(there, align=4)
        halves = ir.Constant(ir.VectorType(_INT, LANES), [4, 5, 6, 7, 0, 1, 2, 3])
        difference = builder.fsub(b, builder.shuffle_vector(b, b, halves))
        builder.store(_pick(builder, '>', a, difference), here, align=4)
        return context.get_dummy_value()

    return types.void(into, at, values, start), codegen


@intrinsic
def clear8(typingctx, into, at):
    """into[at:at + 8] = -inf (float32), from where any maximum can start."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        here = _vector_at(context, builder, signature.args[0], args[0], args[1])
        builder.store(ir.Constant(_VECTOR, [float('-inf')] * LANES), here, align=4)
        return context.get_dummy_value()

    return types.void(into, at), codegen


@intrinsic
def copy8(typingctx, into, at, values, start):
    """into[at:at + 8] = values[start:start + 8] (float32 arrays)."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        here = _vector_at(context, builder, signature.args[0], args[0], args[1])
        there = _vector_at(context, builder, signature.args[2], args[2], args[3])
        builder.store(builder.load(there, align=4), here, align=4)
        return context.get_dummy_value()

    return types.void(into, at, values, start), codegen


@intrinsic
def prefetch(typingctx, records, index):
    """Fetch records[index] to the near caches."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        byte = ir.IntType(8).as_pointer()
        place = builder.bitcast(builder.gep(data, [args[1]]), byte)
        kind = ir.FunctionType(ir.VoidType(), [byte, _INT, _INT, _INT])
        fetch = cgutils.get_or_insert_function(builder.module, kind, 'llvm.prefetch.p0')
        builder.call(fetch, [place, *(ir.Constant(_INT, hint) for hint in (1, 3, 1))])
        return context.get_dummy_value()

    return types.void(records, types.int64), codegen
