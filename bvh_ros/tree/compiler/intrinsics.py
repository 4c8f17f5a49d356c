# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What numba's own language lacks: small arrays on the stack, and LLVM's vector operations."""

import contextlib
import math
from collections.abc import Iterator
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

LANES = 8  # floats of a box: lower and upper bounds, padded
WIDTH = 16  # children of a wide node
CACHE_LINE = 64  # bytes

_FLOAT, _BIT, _BYTE = ir.FloatType(), ir.IntType(1), ir.IntType(8)
_INT, _LONG = ir.IntType(32), ir.IntType(64)
_VECTOR = ir.VectorType(_FLOAT, LANES)


@intrinsic(prefer_literal=True)
def stack_array(typingctx, shape, dtype):
    """Uninitialised array of a constant `shape`, a number or several, that lives until the calling
    kernel returns; it must not be returned. `dtype` may be an array: of the same dtype.
    """
    several = shape.types if isinstance(shape, types.BaseTuple) else (shape,)
    lengths = [one.literal_value for one in several]
    kind = types.Array(dtype.dtype, len(lengths), 'C')

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        item = context.get_data_type(kind.dtype)
        room = on_stack(builder, ir.ArrayType(item, math.prod(lengths)))
        size = context.get_abi_sizeof(item)
        if size * math.prod(lengths) >= CACHE_LINE:
            room.align = CACHE_LINE
        array = context.make_array(kind)(context, builder)
        steps = [size * math.prod(lengths[axis + 1 :]) for axis in range(len(lengths))]
        data = builder.bitcast(room, item.as_pointer())
        context.populate_array(
            array,
            data=data,
            shape=[*map(index, lengths)],
            strides=[*map(index, steps)],
            itemsize=index(size),
            meminfo=None,
        )
        return array._getvalue()

    return kind(shape, dtype), codegen


def index(value: int) -> Any:
    """An int64 constant."""
    return ir.Constant(_LONG, value)


def on_stack(builder: Any, kind: Any) -> Any:
    """Room on the stack, made once a call."""
    with builder.goto_entry_block():
        return builder.alloca(kind)


def variable(builder: Any, value: Any) -> Any:
    """Pointer to a value on the stack."""
    place = on_stack(builder, value.type)
    builder.store(value, place)
    return place


@contextlib.contextmanager
def each(builder: Any, count: Any) -> Iterator[Any]:
    """What is built within is done for every number from 0 to below `count`."""
    before = builder.block
    head, body, after = (builder.append_basic_block(f'each.{part}') for part in ('', 'do', 'end'))
    builder.branch(head)
    builder.position_at_end(head)
    number = builder.phi(_LONG)
    number.add_incoming(index(0), before)
    builder.cbranch(builder.icmp_signed('<', number, count), body, after)
    builder.position_at_end(body)
    yield number
    number.add_incoming(builder.add(number, index(1)), builder.block)
    builder.branch(head)
    builder.position_at_end(after)


def operation(builder: Any, name: str, result: Any, arguments: list[Any]) -> Any:
    """One of LLVM's own functions, of these types."""
    known = builder.module.globals.get(name)
    return known or ir.Function(builder.module, ir.FunctionType(result, arguments), name)


def splat(builder: Any, scalar: Any, lanes: int) -> Any:
    """A vector with one number in all lanes."""
    empty = ir.Constant(ir.VectorType(scalar.type, lanes), ir.Undefined)
    one = builder.insert_element(empty, scalar, ir.Constant(_INT, 0))
    first = ir.Constant(ir.VectorType(_INT, lanes), [0] * lanes)
    return builder.shuffle_vector(one, empty, first)


def pick(builder: Any, order: str, a: Any, b: Any) -> Any:
    return builder.select(builder.fcmp_ordered(order, a, b), a, b)


def elements_at(context: Any, builder: Any, kind: Any, array: Any, first: Any, count: Any) -> Any:
    """Pointer to array[first], to read or write so many elements from there.

    With NUMBA_BOUNDSCHECK they must be there, as for what numba itself reads and writes.
    """
    view = context.make_array(kind)(context, builder, array)
    if context.enable_boundscheck:
        from numba.core import cgutils

        last = builder.sub(builder.add(first, count), index(1))
        for place in (first, last):
            cgutils.do_boundscheck(context, builder, place, view.nitems)
    return builder.gep(view.data, [first])


def record_at(context: Any, builder: Any, kind: Any, array: Any, place: Any) -> Any:
    """Pointer to the bytes of array[place], checked as `elements_at` does."""
    here = elements_at(context, builder, kind, array, place, index(1))
    return builder.bitcast(here, _BYTE.as_pointer())


def first_numbers(context: Any, builder: Any, kind: Any, array: Any, ndim: int, width: int) -> Any:
    """The first doubles of an array, and zeros, as a vector."""
    first = elements_at(context, builder, kind, array, index(0), index(ndim))
    numbers = ir.Constant(ir.VectorType(ir.DoubleType(), width), [0.0] * width)
    for axis in range(ndim):
        number = builder.load(builder.gep(first, [index(axis)]))
        numbers = builder.insert_element(numbers, number, ir.Constant(_INT, axis))
    return numbers


def _bytes_at(context: Any, builder: Any, kind: Any, array: Any, place: Any) -> Any:
    """Pointer to the bytes of array[place], wherever that is: not to be read."""
    size = context.get_abi_sizeof(context.get_data_type(kind.dtype))
    start = builder.bitcast(
        context.make_array(kind)(context, builder, array).data, _BYTE.as_pointer()
    )
    return builder.gep(start, [builder.mul(place, index(size))])


@intrinsic(prefer_literal=True)
def prefetch(typingctx, array, place, lines):
    """Ask for the cache lines from array[place] on, so many, before they are wanted."""
    count = lines.literal_value

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kinds = [_BYTE.as_pointer(), _INT, _INT, _INT]
        ask = operation(builder, 'llvm.prefetch.p0i8', ir.VoidType(), kinds)
        first = _bytes_at(context, builder, signature.args[0], args[0], args[1])
        for line in range(count):
            how = [ir.Constant(_INT, flag) for flag in (0, 3, 1)]  # to be read, near, data
            builder.call(ask, [builder.gep(first, [index(64 * line)]), *how])
        return context.get_dummy_value()

    return types.void(array, types.int64, lines), codegen


@intrinsic
def trailing_zeros(typingctx, bits):
    """Number of zero bits below the lowest one; `bits` is not zero."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(_BIT, 1))

    return types.uint32(bits), codegen


@intrinsic
def fma(typingctx, a, b, c):
    """a * b + c, rounded once; all float32, or all float64."""
    kind = 'f32' if a == types.float32 else 'f64'

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kinds = [arg.type for arg in args]
        return builder.call(operation(builder, f'llvm.fma.{kind}', kinds[0], kinds), args)

    return a(a, a, a), codegen


@intrinsic
def bits_of(typingctx, number):
    """The bits of a float32, as an int64: of two that are not negative, the larger has the larger
    ones.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.sext(builder.bitcast(args[0], _INT), _LONG)

    return types.int64(types.float32), codegen


def _vector_at(context: Any, builder: Any, kind: Any, array: Any, place: Any) -> Any:
    first = elements_at(context, builder, kind, array, place, index(LANES))
    return builder.bitcast(first, _VECTOR.as_pointer())


@intrinsic
def largest8(typingctx, into, at, values, start):
    """into[at:at + 8] = the larger of it and values[start:start + 8], float by float (float32
    arrays).
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        here = _vector_at(context, builder, signature.args[0], args[0], args[1])
        there = _vector_at(context, builder, signature.args[2], args[2], args[3])
        a, b = builder.load(here, align=4), builder.load(there, align=4)
        builder.store(pick(builder, '>', a, b), here, align=4)
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
        builder.store(pick(builder, '>', a, difference), here, align=4)
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
