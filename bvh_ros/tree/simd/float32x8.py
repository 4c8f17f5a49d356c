# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The vector operations of a split: items into bins, and candidates side by side, one a lane.

A rank is a float32 cost as an integer of the same order, its last six bits replaced by the number
of the candidate: the least of all ranks tells which candidate costs least. Ranks of `NO_COST` or
more are of candidates with an empty side.
"""

import functools
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ..compiler.intrinsics import LANES, WIDTH, elements_at, index, operation, pick, splat

NO_COST = np.uint32(0x7F800000)  # the bits of inf; those of NaN are above
NUMBER = np.uint32(63)  # the bits of a rank that are the candidate's number

_INT, _LONG, _FLOAT = ir.IntType(32), ir.IntType(64), ir.FloatType()
_BOX, _FOUR = ir.VectorType(_FLOAT, LANES), ir.VectorType(_FLOAT, 4)
_HI = 4  # place of the upper bounds in an item
_SIDE = 3 * WIDTH * LANES * 4  # bytes of the bins of one side
BOUNDS = [axis + side for axis in range(3) for side in (0, _HI)]


def ints(numbers: Iterable[int]) -> Any:
    numbers = list(numbers)
    return ir.Constant(ir.VectorType(_INT, len(numbers)), numbers)


def _floats(number: float, lanes: int) -> Any:
    return ir.Constant(ir.VectorType(_FLOAT, lanes), [number] * lanes)


def place_at(context: Any, builder: Any, kind: Any, array: Any, at: Any, vector: Any) -> Any:
    """Where a vector, or one number, lies in an array."""
    count = index(getattr(vector, 'count', 1))
    first = elements_at(context, builder, kind, array, at, count)
    return builder.bitcast(first, vector.as_pointer())


def boxes_from(context: Any, builder: Any, kind: Any, items: Any, start: Any, count: Any) -> Any:
    """Pointer to so many boxes of `items`."""
    at, floats = builder.mul(start, index(LANES)), builder.mul(count, index(LANES))
    first = elements_at(context, builder, kind, items, at, floats)
    return builder.bitcast(first, _BOX.as_pointer())


def larger(builder: Any, a: Any, b: Any) -> Any:
    """The larger, lane by lane; none is NaN.

    Of a comparison and a choice LLVM would make a masked store, which the next load waits for.
    """
    name = f'llvm.maxnum.v{a.type.count}f32'
    largest = operation(builder, name, a.type, [a.type] * 2)
    return builder.call(largest, [a, b], fastmath=('nnan',))


def _half(builder: Any, box: Any, first: int) -> Any:
    return builder.shuffle_vector(box, box, ints(range(first, first + 4)))


def areas(builder: Any, edges: list[Any], planar: Any) -> Any:
    """Half the areas (perimeters) of boxes with these edges."""
    x, y, z = edges
    flat = builder.fadd(x, y)
    solid = builder.fadd(builder.fmul(x, y), builder.fmul(flat, z))
    return builder.select(planar, flat, solid)


def _least_rank(builder: Any, costs: Any, first: Any) -> Any:
    """The least rank of candidates with numbers from `first` on."""
    lanes = costs.type.count
    bits = builder.bitcast(costs, ir.VectorType(_INT, lanes))
    numbers = builder.add(ints(range(lanes)), splat(builder, first, lanes))
    ranks = builder.or_(builder.and_(bits, ints([~int(NUMBER)] * lanes)), numbers)
    least = operation(builder, f'llvm.vector.reduce.umin.v{lanes}i32', _INT, [ranks.type])
    return builder.call(least, [ranks])


# ---- bins


def _bins_of(builder: Any, center: Any, scales: Any) -> Any:
    """Where a box goes: the bytes to a bin of each axis, sixteen bins an axis; what is no number,
    to the first. `scales`: pointer to the least of twice the centres, and bins for a unit of
    these, as vectors of four.
    """
    origin, slope = (builder.load(builder.gep(scales, [index(i)]), align=4) for i in range(2))
    number = builder.fmul(builder.fsub(center, origin), slope)
    number = pick(builder, '>', number, _floats(0.0, 4))
    number = pick(builder, '<', number, _floats(WIDTH - 1.0, 4))
    numbers = builder.fptosi(number, ir.VectorType(_INT, 4))
    return builder.add(builder.shl(numbers, ints([5] * 4)), ints([0, 512, 1024, 0]))


def _add_to_bins(builder: Any, bins: Any, box: Any, places: Any) -> None:
    """Add a box to three bins, so many bytes from pointer `bins` on."""
    one = ir.Constant(_BOX, [0.0] * (LANES - 1) + [1.0])
    first = builder.bitcast(bins, ir.IntType(8).as_pointer())
    for place in places:
        union = builder.bitcast(
            builder.gep(first, [builder.zext(place, _LONG)]), _BOX.as_pointer()
        )
        more = builder.fadd(larger(builder, box, builder.load(union, align=4)), one)
        builder.store(more, union, align=4)


def _box_and_center(context: Any, builder: Any, kind: Any, items: Any, item: Any) -> Any:
    box = builder.load(boxes_from(context, builder, kind, items, item, index(1)), align=4)
    return box, builder.fsub(_half(builder, box, _HI), _half(builder, box, 0))


@intrinsic
def add_to_bins(typingctx, bins, items, item, scales):
    """Add an item to a bin of each axis, sixteen bins an axis. A bin is the union of its boxes and
    in its last place their number, or -inf.

    `scales`, float32: the least of twice the centres, and bins for a unit of these; four places
    for each.
    """
    sig = types.void(bins, items, types.int64, scales)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        bins_kind, items_kind, _, scales_kind = signature.args
        box, center = _box_and_center(context, builder, items_kind, *args[1:3])
        first = boxes_from(context, builder, bins_kind, args[0], index(0), index(3 * WIDTH))
        scales = place_at(context, builder, scales_kind, args[3], index(0), _FOUR)
        places = _bins_of(builder, center, scales)
        lanes = [builder.extract_element(places, ir.Constant(_INT, axis)) for axis in range(3)]
        _add_to_bins(builder, first, box, lanes)
        return context.get_dummy_value()

    return sig, codegen


@intrinsic
def deal_item(typingctx, items, item, left, right, test, axis, binned, plan, bins, at):
    """Copy an item to the place `left` or `right`, and if `binned` write where in that side's bins
    it goes, from bins[at] on, for `add_dealt`; 1 if that is the left, else 0.

    `test`, float32: twice the centre less test[:4], times test[4:8], less test[8:12] is negative
    on the left; on other axes than `axis` it never is. plan[12:24] and
    plan[24:36] begin with the sides' `scales`, see `add_to_bins`.
    """
    places = [types.int64] * 3
    sig = types.int64(items, *places, test, types.int64, types.boolean, plan, bins, types.int64)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        items_kind, _, _, _, test_kind, _, _, plan_kind, bins_kind, _ = signature.args
        items, item, left, right, test, axis, binned, plan, bins, there = args
        box, center = _box_and_center(context, builder, items_kind, items, item)
        limits = [
            builder.load(place_at(context, builder, test_kind, test, index(i), _FOUR), align=4)
            for i in (0, 4, 8)
        ]
        number = builder.fmul(builder.fsub(center, limits[0]), limits[1])
        number = builder.bitcast(builder.fsub(number, limits[2]), ir.VectorType(_INT, 4))
        # Signs, not a comparison: of that LLVM would make a branch, guessed wrong half the time.
        signs = builder.bitcast(builder.icmp_signed('<', number, ints([0] * 4)), ir.IntType(4))
        before = builder.lshr(builder.zext(signs, _LONG), axis)
        place = builder.select(builder.icmp_signed('!=', before, index(0)), left, right)
        place = boxes_from(context, builder, items_kind, items, place, index(1))
        builder.store(box, place, align=4)
        with builder.if_then(binned):
            side = builder.sub(index(1), before)
            at = builder.mul(builder.add(side, index(1)), index(12))
            scales = place_at(context, builder, plan_kind, plan, at, _FOUR)
            places = _bins_of(builder, center, scales)
            far = splat(builder, builder.trunc(builder.mul(side, index(_SIDE)), _INT), 4)
            place = place_at(context, builder, bins_kind, bins, there, places.type)
            builder.store(builder.add(places, far), place, align=4)
        return before

    return sig, codegen


@intrinsic
def add_dealt(typingctx, bins, items, item, places, at):
    """Add an item to its side's bins, which `deal_item` has written from places[at] on, int32."""
    sig = types.void(bins, items, types.int64, places, types.int64)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        bins_kind, items_kind, _, places_kind, _ = signature.args
        bins, items, number, places, at = args
        item = boxes_from(context, builder, items_kind, items, number, index(1))
        first = boxes_from(context, builder, bins_kind, bins, index(0), index(6 * WIDTH))
        row = place_at(context, builder, places_kind, places, at, ir.VectorType(_INT, 4))
        row = builder.bitcast(row, _INT.as_pointer())
        lanes = [builder.load(builder.gep(row, [index(axis)])) for axis in range(3)]
        _add_to_bins(builder, first, builder.load(item, align=4), lanes)
        return context.get_dummy_value()

    return sig, codegen


def _columns(builder: Any, rows: list[Any]) -> list[Any]:
    """Of vectors of four lanes: all first lanes, all second ones and so on."""
    count = len(rows)
    while len(rows) > 1:
        both = ints(range(2 * rows[0].type.count))
        pairs = zip(rows[::2], rows[1::2], strict=True)
        rows = [builder.shuffle_vector(a, b, both) for a, b in pairs]
    every = rows[0]
    return [
        builder.shuffle_vector(every, every, ints(range(axis, 4 * count, 4))) for axis in range(4)
    ]


def _union_edges(builder: Any, boxes: list[Any]) -> list[Any]:
    """Edges of the unions of the first one, two, three ... boxes."""
    union, edges = boxes[0], []
    for box in boxes:
        union = larger(builder, union, box)
        edges.append(builder.fadd(_half(builder, union, 0), _half(builder, union, _HI)))
    return edges


def _running_sums(builder: Any, numbers: Any) -> Any:
    """Of each lane and all before it."""
    lanes, step = numbers.type.count, 1
    while step < lanes:
        order = [lanes] * step + list(range(lanes - step))
        shifted = builder.shuffle_vector(numbers, _floats(0.0, lanes), ints(order))
        numbers = builder.fadd(numbers, shifted)
        step *= 2
    return numbers


@intrinsic
def rank_bins(typingctx, bins, first, axis, total, planar):
    """The least rank of the splits between the bins of an axis, which hold `total` boxes; its
    number is 16 * axis + the last bin on the left. The bins of the first axis begin at `first`.
    """
    sig = types.uint32(bins, types.int64, types.int64, types.int64, types.boolean)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        bins, begin, axis, total, planar = args
        number = builder.mul(axis, index(WIDTH))
        begin = builder.add(begin, number)
        row = boxes_from(context, builder, signature.args[0], bins, begin, index(WIDTH))
        row = [builder.load(builder.gep(row, [index(i)]), align=4) for i in range(WIDTH)]
        left = _union_edges(builder, row)
        # Right of the last bin there is nothing.
        right = [*_union_edges(builder, row[:0:-1])[::-1], _floats(float('-inf'), 4)]
        counts = _columns(builder, [_half(builder, box, _HI) for box in row])[3]
        counts = pick(builder, '>', counts, _floats(0.0, WIDTH))
        lefts = _running_sums(builder, counts)
        rights = builder.fsub(splat(builder, builder.sitofp(total, _FLOAT), WIDTH), lefts)
        costs = [
            builder.fmul(areas(builder, _columns(builder, edges)[:3], planar), number_there)
            for edges, number_there in ((left, lefts), (right, rights))
        ]
        return _least_rank(builder, builder.fadd(*costs), builder.trunc(number, _INT))

    return sig, codegen


def joined_by_halves(builder: Any, join: Callable[[Any, Any], Any], parts: list[Any]) -> Any:
    """All of them joined, pair by pair: no long chain of operations that wait for each other."""
    while len(parts) > 1:
        parts = [join(a, b) for a, b in zip(parts[::2], parts[1::2], strict=True)]
    return parts[0]


@intrinsic
def join_sides(typingctx, bins, first, last, unions):
    """Write the unions of sixteen bins, which begin at `first`: of those up to number `last`, and
    of the others.
    """
    sig = types.void(bins, types.int64, types.int64, unions)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        bins, first, last, unions = args
        row = boxes_from(context, builder, signature.args[0], bins, first, index(WIDTH))
        row = [builder.load(builder.gep(row, [index(i)]), align=4) for i in range(WIDTH)]
        before = [builder.icmp_signed('<=', index(i), last) for i in range(WIDTH)]
        lowest = _floats(float('-inf'), LANES)
        for side in range(2):
            chosen = [
                builder.select(here, *((box, lowest), (lowest, box))[side])
                for here, box in zip(before, row, strict=True)
            ]
            union = joined_by_halves(builder, functools.partial(larger, builder), chosen)
            place = boxes_from(context, builder, signature.args[3], unions, index(side), index(1))
            builder.store(union, place, align=4)
        return context.get_dummy_value()

    return sig, codegen
