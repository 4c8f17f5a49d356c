# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sixteen float32 lanes at once: the boxes of a wide node, and its triangles."""

import functools
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ..compiler.intrinsics import (
    WIDTH,
    each,
    elements_at,
    index,
    operation,
    pick,
    record_at,
    splat,
    variable,
)

_FLOAT, _BIT, _INT, _LONG = ir.FloatType(), ir.IntType(1), ir.IntType(32), ir.IntType(64)
_WIDE = ir.VectorType(_FLOAT, WIDTH)


def _near_and_far(builder: Any, planes: Any, octant: Any, ndim: int) -> list[Any]:
    """The near and far ones of a wide node's planes, axis by axis."""

    def side(axis: int, upper: Any) -> Any:
        row = builder.select(upper, index(axis + ndim), index(axis))
        place = builder.gep(planes, [builder.mul(row, index(WIDTH))])
        return builder.load(builder.bitcast(place, _WIDE.as_pointer()), align=4)

    down = [builder.trunc(builder.lshr(octant, index(k)), _BIT) for k in range(ndim)]
    return [(side(k, down[k]), side(k, builder.not_(down[k]))) for k in range(ndim)]


def _slabs(builder: Any, boxes: list[Any], field: Any) -> tuple[Any, Any]:
    """Distances at which a ray enters the boxes, and whether that is before it leaves them and its
    limit; field(name, axis) is a number of the ray. The distance of a plane is fma(plane, slope,
    shift).
    """
    fma = operation(builder, 'llvm.fma.v16f32', _WIDE, [_WIDE] * 3)
    entry, leave = ir.Constant(_WIDE, [0.0] * WIDTH), field('limit')
    for axis, (near, far) in enumerate(boxes):
        slope = field('slope', axis)
        intersect_node = builder.call(fma, [near, slope, field('near_shift', axis)])
        leaves = builder.call(fma, [far, slope, field('far_shift', axis)])
        entry, leave = pick(builder, '>', intersect_node, entry), pick(builder, '<', leaves, leave)
    return entry, builder.fcmp_ordered('<=', entry, leave)


@intrinsic
def stream16(typingctx, planes, node, octant, rays, places, hits, nearest):
    """Test the rays of `places` against the sixteen boxes of a wide node.

    hits[i] becomes the bit mask of the boxes that the i-th of them meets, `nearest` the bits of
    the least distance of each box, as integers of the same order, or nearest[i] of the distances
    of the i-th, where it meets the box; returns which boxes any ray meets. The rays are records as
    of `filtering.ray_dtype`; bit k of `octant` says that they fly down axis k; where it is
    negative, the octant of each ray does. An unsigned one never is.
    """
    sig = types.uint32(planes, node, octant, rays, places, hits, nearest)
    record = rays.dtype

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        node, octant, rays = args[1:4]

        def part(k: int, first: Any, length: Any) -> Any:
            return elements_at(context, builder, signature.args[k], args[k], first, length)

        count = context.make_array(signature.args[4])(context, builder, args[4]).nitems
        ndim = record.typeof('slope').shape[0]
        floats = index(2 * ndim * WIDTH)
        planes = part(0, builder.mul(node, floats), floats)
        places, hits = part(4, index(0), count), part(5, index(0), count)
        each_own = signature.args[6].ndim == 2
        numbers = builder.mul(count, index(WIDTH)) if each_own else index(WIDTH)
        nearest = part(6, index(0), numbers)
        least = variable(builder, ir.Constant(_WIDE, [float('inf')] * WIDTH))
        any_hits = variable(builder, ir.Constant(_INT, 0))

        def write(distances: Any, first: Any) -> None:
            row = builder.bitcast(builder.gep(nearest, [first]), _WIDE.as_pointer())
            builder.store(distances, row, align=4)

        def test_rays(boxes_for: Any) -> None:
            with each(builder, count) as number:
                place = builder.zext(builder.load(builder.gep(places, [number])), _LONG)
                ray = record_at(context, builder, signature.args[3], rays, place)

                def field(name: str, axis: int = 0) -> Any:
                    at = builder.gep(ray, [index(record.offset(name) + 4 * axis)])
                    number = builder.load(builder.bitcast(at, _FLOAT.as_pointer()))
                    return splat(builder, number, WIDTH)

                entry, hit = _slabs(builder, boxes_for(ray), field)
                if each_own:
                    write(entry, builder.mul(number, index(WIDTH)))
                else:
                    far = ir.Constant(_WIDE, [float('inf')] * WIDTH)
                    nearer = builder.select(hit, entry, far)
                    builder.store(pick(builder, '<', nearer, builder.load(least)), least)
                bits = builder.zext(builder.bitcast(hit, ir.IntType(WIDTH)), _INT)
                builder.store(bits, builder.gep(hits, [number]))
                builder.store(builder.or_(builder.load(any_hits), bits), any_hits)

        def boxes_of(ray: Any) -> list[Any]:
            own = builder.load(builder.gep(ray, [index(record.offset('octant'))]))
            return _near_and_far(builder, planes, builder.zext(own, _LONG), ndim)

        def test_all_alike() -> None:
            boxes = _near_and_far(builder, planes, octant, ndim)
            test_rays(lambda ray: boxes)

        if signature.args[2].signed:
            differ = builder.icmp_signed('<', octant, ir.Constant(octant.type, 0))
            with builder.if_else(differ) as (mixed, same):
                with mixed:
                    test_rays(boxes_of)
                with same:
                    test_all_alike()
        else:
            test_all_alike()
        if not each_own:
            write(builder.load(least), index(0))
        return builder.load(any_hits)

    return sig, codegen


@intrinsic
def seen16(typingctx, masks, at, mask):
    """Bit mask of those of masks[at:at + 16] that have a bit of `mask` (uint32)."""
    sig = types.uint32(masks, types.int64, types.uint32)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        words = ir.VectorType(_INT, WIDTH)
        first = elements_at(context, builder, signature.args[0], args[0], args[1], index(WIDTH))
        place = builder.bitcast(first, words.as_pointer())
        common = builder.and_(builder.load(place, align=4), splat(builder, args[2], WIDTH))
        visible = builder.icmp_unsigned('!=', common, ir.Constant(words, [0] * WIDTH))
        return builder.zext(builder.bitcast(visible, ir.IntType(WIDTH)), _INT)

    return sig, codegen


@intrinsic
def at_most16(typingctx, numbers, at, limit):
    """Bit mask of those of numbers[at:at + 16], float32 or int32, that are not above a limit."""
    kind = numbers.dtype
    sig = types.uint32(numbers, types.int64, kind)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        wide = ir.VectorType(context.get_value_type(kind), WIDTH)
        first = elements_at(context, builder, signature.args[0], args[0], args[1], index(WIDTH))
        row = builder.load(builder.bitcast(first, wide.as_pointer()), align=4)
        compare = builder.icmp_signed if kind == types.int32 else builder.fcmp_ordered
        within = compare('<=', row, splat(builder, args[2], WIDTH))
        return builder.zext(builder.bitcast(within, ir.IntType(WIDTH)), _INT)

    return sig, codegen


@intrinsic
def least16(typingctx, numbers):
    """The least of sixteen float32."""
    sig = types.float32(numbers)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        first = elements_at(context, builder, signature.args[0], args[0], index(0), index(WIDTH))
        row = builder.load(builder.bitcast(first, _WIDE.as_pointer()), align=4)
        count = WIDTH // 2
        while count > 0:  # halves are compared at once
            upper = ir.Constant(ir.VectorType(_INT, count), [*range(count, 2 * count)])
            lower = ir.Constant(ir.VectorType(_INT, count), [*range(count)])
            halves = (builder.shuffle_vector(row, row, half) for half in (lower, upper))
            row, count = pick(builder, '<', *halves), count // 2
        return builder.extract_element(row, ir.Constant(_INT, 0))

    return sig, codegen


@intrinsic
def near16(typingctx, planes, node, box, limit, nearest):
    """Bit mask of the sixteen boxes of a wide node whose squared distance from a box is within a
    limit, float32; `nearest` becomes the bits of the squares. The other box is its three lower and
    three upper sides.
    """
    sig = types.uint32(planes, types.int64, box, types.float32, nearest)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        def part(k: int, first: Any, length: Any) -> Any:
            return elements_at(context, builder, signature.args[k], args[k], first, length)

        fma = operation(builder, 'llvm.fma.v16f32', _WIDE, [_WIDE] * 3)
        floats = index(6 * WIDTH)
        sides, box = part(0, builder.mul(args[1], floats), floats), part(2, index(0), index(6))
        total = zero = ir.Constant(_WIDE, [0.0] * WIDTH)
        for axis in range(3):
            below, above = (
                builder.load(
                    builder.bitcast(builder.gep(sides, [index(row * WIDTH)]), _WIDE.as_pointer()),
                    align=4,
                )
                for row in (axis, axis + 3)
            )
            low, high = (
                splat(builder, builder.load(builder.gep(box, [index(row)])), WIDTH)
                for row in (axis, axis + 3)
            )
            gap = pick(builder, '>', builder.fsub(below, high), builder.fsub(low, above))
            gap = pick(builder, '>', gap, zero)
            total = builder.call(fma, [gap, gap, total])
        squares = builder.bitcast(part(4, index(0), index(WIDTH)), _WIDE.as_pointer())
        builder.store(total, squares, align=4)
        near = builder.fcmp_ordered('<=', total, splat(builder, args[3], WIDTH))
        return builder.zext(builder.bitcast(near, ir.IntType(WIDTH)), _INT)

    return sig, codegen


@intrinsic
def above16(typingctx, planes, node, plane):
    """Bit mask of the sixteen boxes of a wide node that reach a plane: the three numbers of its
    normal and where it lies along that, float32.
    """
    sig = types.uint32(planes, types.int64, plane)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        def part(k: int, first: Any, length: Any) -> Any:
            return elements_at(context, builder, signature.args[k], args[k], first, length)

        fma = operation(builder, 'llvm.fma.v16f32', _WIDE, [_WIDE] * 3)
        floats = index(6 * WIDTH)
        sides, plane = part(0, builder.mul(args[1], floats), floats), part(2, index(0), index(4))
        height = ir.Constant(_WIDE, [0.0] * WIDTH)
        *normal, place = (builder.load(builder.gep(plane, [index(k)])) for k in range(4))
        for axis, along in enumerate(normal):
            up = builder.fcmp_ordered('>', along, ir.Constant(_FLOAT, 0.0))
            row = builder.select(up, index((axis + 3) * WIDTH), index(axis * WIDTH))
            corner = builder.bitcast(builder.gep(sides, [row]), _WIDE.as_pointer())
            along = splat(builder, along, WIDTH)
            height = builder.call(fma, [builder.load(corner, align=4), along, height])
        above = builder.fcmp_ordered('>=', height, splat(builder, place, WIDTH))
        return builder.zext(builder.bitcast(above, ir.IntType(WIDTH)), _INT)

    return sig, codegen


@intrinsic
def crossed16(typingctx, triangles, node, axis, line, depths):
    """Bit mask of the sixteen triangles of a wide node that a line may cross; `depths` becomes how
    far it goes at most until it crosses each, inf where it may not do so after its origin; and
    behind that how far at least. `triangles32` tells what a line is, (7,) float32, and bounds the
    rounding.
    """
    sig = types.uint32(triangles, types.int64, types.int64, line, depths)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        def part(k: int, first: Any, length: Any) -> Any:
            return elements_at(context, builder, signature.args[k], args[k], first, length)

        def row(corner: int, axis: Any) -> Any:
            first = builder.mul(builder.add(axis, index(3 * corner)), index(WIDTH))
            place = builder.bitcast(builder.gep(corners, [first]), _WIDE.as_pointer())
            return builder.load(place, align=4)

        def determinant(one: Any, other: Any) -> Any:
            product = builder.fneg(builder.fmul(one[1], other[0]))
            return builder.call(fma, [one[0], other[1], product])

        def most(order: str, values: list[Any]) -> Any:
            return functools.reduce(lambda a, b: pick(builder, order, a, b), values)

        fma = operation(builder, 'llvm.fma.v16f32', _WIDE, [_WIDE] * 3)
        size = operation(builder, 'llvm.fabs.v16f32', _WIDE, [_WIDE])
        floats = index(9 * WIDTH)
        corners, line = part(0, builder.mul(args[1], floats), floats), part(3, index(0), index(7))
        slope_x, slope_y, place_x, place_y, ahead, start, pad = (
            splat(builder, builder.load(builder.gep(line, [index(k)])), WIDTH) for k in range(7)
        )
        one, other = (builder.urem(builder.add(args[2], index(k)), index(3)) for k in (1, 2))
        places, forward = [], []
        for corner in range(3):
            along = row(corner, args[2])
            back = builder.fneg(along)
            x = builder.call(fma, [back, slope_x, builder.fsub(row(corner, one), place_x)])
            y = builder.call(fma, [back, slope_y, builder.fsub(row(corner, other), place_y)])
            places.append((x, y))
            forward.append(builder.call(fma, [along, ahead, builder.fneg(start)]))
        a, b, c = places
        sides = [determinant(b, c), determinant(c, a), determinant(a, b)]
        far = most('>', [builder.call(size, [number]) for place in places for number in place])
        about, more = (ir.Constant(_WIDE, [x] * WIDTH) for x in (2.0**-16, 2.0**-38))
        slack = builder.call(fma, [far, about, more])
        lowest, highest, minus = most('<', sides), most('>', sides), builder.fneg(slack)
        below = builder.fcmp_ordered('<', lowest, minus)
        above = builder.fcmp_ordered('>', highest, slack)
        sure = builder.or_(
            builder.fcmp_ordered('>', lowest, slack), builder.fcmp_ordered('<', highest, minus)
        )
        sure = builder.and_(sure, builder.fcmp_ordered('>', most('<', forward), pad))
        beyond = builder.fadd(most('>', forward), pad)
        beyond = builder.select(sure, beyond, ir.Constant(_WIDE, [float('inf')] * WIDTH))
        least = builder.fsub(most('<', forward), pad)
        for number, depth in enumerate((beyond, least)):
            out = builder.bitcast(part(4, index(number * WIDTH), index(WIDTH)), _WIDE.as_pointer())
            builder.store(depth, out, align=4)
        crossed = builder.not_(builder.and_(below, above))
        return builder.zext(builder.bitcast(crossed, ir.IntType(WIDTH)), _INT)

    return sig, codegen
