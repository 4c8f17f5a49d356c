# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sixteen float32 lanes at once: the boxes of a wide node."""

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from .machine import WIDTH, bytes_at, data_of, pick

_FLOAT, _BIT, _INT, _LONG = ir.FloatType(), ir.IntType(1), ir.IntType(32), ir.IntType(64)
_WIDE = ir.VectorType(_FLOAT, WIDTH)


def _splat(builder: Any, scalar: Any, vector: Any = _WIDE) -> Any:
    empty = ir.Constant(vector, ir.Undefined)
    one = builder.insert_element(empty, scalar, ir.Constant(_INT, 0))
    return builder.shuffle_vector(one, empty, ir.Constant(ir.VectorType(_INT, WIDTH), [0] * WIDTH))


@intrinsic
def stream16(typingctx, planes, node, octant, rays, list_, start, count, hits, nearest):
    """Test the rays list_[start:start + count] against the sixteen boxes of a wide node.

    hits[i] becomes the bit mask of the boxes that the i-th of them meets, `nearest` the bits of
    the least distance of each box (see `float_bits`); returns which boxes any ray meets. The rays
    are records as of `wide_filter.ray_dtype`; bit k of `octant` says that they fly down axis k.
    The distance of a plane is fma(plane, slope, shift).
    """
    axes = range(rays.dtype.typeof('slope').shape[0])
    sig = types.uint32(planes, node, octant, rays, list_, start, count, hits, nearest)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kinds = signature.args
        _, node, octant, _, _, start, count, _, _ = args
        planes, _, _, _, list_, _, _, hits, nearest = (
            data_of(context, builder, kind, array) if isinstance(kind, types.Array) else None
            for kind, array in zip(kinds, args, strict=True)
        )
        fma = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(_WIDE, [_WIDE] * 3), 'llvm.fma.v16f32'
        )

        def number(value: int) -> Any:
            return ir.Constant(_LONG, value)

        def side(axis: int, upper: Any) -> Any:
            """The lower or upper planes of an axis."""
            row = builder.select(upper, number(axis + len(axes)), number(axis))
            row = builder.add(builder.mul(node, number(2 * len(axes))), row)
            place = builder.gep(planes, [builder.mul(row, number(WIDTH))])
            return builder.load(builder.bitcast(place, _WIDE.as_pointer()), align=4)

        def sides(axis: int) -> tuple[Any, Any]:
            """The near and far planes of an axis."""
            down = builder.trunc(builder.lshr(octant, number(axis)), _BIT)
            return side(axis, down), side(axis, builder.not_(down))

        boxes = [sides(axis) for axis in axes]
        least = cgutils.alloca_once_value(builder, ir.Constant(_WIDE, [float('inf')] * WIDTH))
        any_hits = cgutils.alloca_once_value(builder, ir.Constant(_INT, 0))
        with cgutils.for_range(builder, count) as loop:
            number_of_ray = builder.load(builder.gep(list_, [builder.add(start, loop.index)]))
            place = builder.zext(number_of_ray, _LONG)
            ray = bytes_at(context, builder, kinds[3], args[3], place)

            def constant(name: str, axis: int = 0, ray: Any = ray) -> Any:
                offset = kinds[3].dtype.offset(name) + 4 * axis
                float_ = builder.bitcast(builder.gep(ray, [number(offset)]), _FLOAT.as_pointer())
                return _splat(builder, builder.load(float_))

            entry, leave = ir.Constant(_WIDE, [0.0] * WIDTH), constant('limit')
            for axis, (near, far) in enumerate(boxes):
                slope = constant('slope', axis)
                enters = builder.call(fma, [near, slope, constant('near_shift', axis)])
                leaves = builder.call(fma, [far, slope, constant('far_shift', axis)])
                entry, leave = (
                    pick(builder, '>', enters, entry),
                    pick(builder, '<', leaves, leave),
                )
            met = builder.fcmp_ordered('<=', entry, leave)
            so_far = builder.load(least)
            nearer = pick(builder, '<', entry, so_far)
            builder.store(builder.select(met, nearer, so_far), least)
            bits = builder.zext(builder.bitcast(met, ir.IntType(WIDTH)), _INT)
            builder.store(bits, builder.gep(hits, [loop.index]))
            builder.store(builder.or_(builder.load(any_hits), bits), any_hits)
        builder.store(builder.load(least), builder.bitcast(nearest, _WIDE.as_pointer()), align=4)
        return builder.load(any_hits)

    return sig, codegen


@intrinsic
def seen16(typingctx, masks, at, mask):
    """Bit mask of those of masks[at:at + 16] that have a bit of `mask` (uint32)."""
    sig = types.uint32(masks, types.int64, types.uint32)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        words = ir.VectorType(_INT, WIDTH)
        data = data_of(context, builder, signature.args[0], args[0])
        place = builder.bitcast(builder.gep(data, [args[1]]), words.as_pointer())
        common = builder.and_(builder.load(place, align=4), _splat(builder, args[2], words))
        seen = builder.icmp_unsigned('!=', common, ir.Constant(words, [0] * WIDTH))
        return builder.zext(builder.bitcast(seen, ir.IntType(WIDTH)), _INT)

    return sig, codegen
