# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The vector operations of a split: candidates side by side, one a lane.

A rank is a float32 cost as an integer of the same order, its last six bits replaced by the number
of the candidate: the least of all ranks tells which candidate costs least. Ranks of `NO_COST` or
more are of candidates with an empty side.
"""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from .intrinsics import LANES, WIDTH, each, elements_at, index, operation, pick, splat, variable

NO_COST = np.uint32(0x7F800000)  # the bits of inf; those of NaN are above
NUMBER = np.uint32(63)  # the bits of a rank that are the candidate's number

_INT, _LONG, _FLOAT = ir.IntType(32), ir.IntType(64), ir.FloatType()
_BOX, _FOUR = ir.VectorType(_FLOAT, LANES), ir.VectorType(_FLOAT, 4)
_HI = 4  # place of the upper bounds in an item
_BOUNDS = [axis + side for axis in range(3) for side in (0, _HI)]


def _ints(numbers: Iterable[int]) -> Any:
    numbers = list(numbers)
    return ir.Constant(ir.VectorType(_INT, len(numbers)), numbers)


def _floats(number: float, lanes: int) -> Any:
    return ir.Constant(ir.VectorType(_FLOAT, lanes), [number] * lanes)


def _place(context: Any, builder: Any, kind: Any, array: Any, at: Any, vector: Any) -> Any:
    """Where a vector, or one number, lies in an array."""
    count = index(getattr(vector, 'count', 1))
    first = elements_at(context, builder, kind, array, at, count)
    return builder.bitcast(first, vector.as_pointer())


def _boxes_from(context: Any, builder: Any, kind: Any, items: Any, start: Any, count: Any) -> Any:
    """Pointer to so many boxes of `items`."""
    at, floats = builder.mul(start, index(LANES)), builder.mul(count, index(LANES))
    first = elements_at(context, builder, kind, items, at, floats)
    return builder.bitcast(first, _BOX.as_pointer())


def _larger(builder: Any, a: Any, b: Any) -> Any:
    """The larger, lane by lane; none is NaN.

    Of a comparison and a choice LLVM would make a masked store, which the next load waits for.
    """
    name = f'llvm.maxnum.v{a.type.count}f32'
    largest = operation(builder, name, a.type, [a.type] * 2)
    return builder.call(largest, [a, b], fastmath=('nnan',))


def _half(builder: Any, box: Any, first: int) -> Any:
    return builder.shuffle_vector(box, box, _ints(range(first, first + 4)))


def _areas(builder: Any, edges: list[Any], planar: Any) -> Any:
    """Half the areas (perimeters) of boxes with these edges."""
    x, y, z = edges
    flat = builder.fadd(x, y)
    solid = builder.fadd(builder.fmul(x, y), builder.fmul(flat, z))
    return builder.select(planar, flat, solid)


def _least_rank(builder: Any, costs: Any, first: Any) -> Any:
    """The least rank of candidates with numbers from `first` on."""
    lanes = costs.type.count
    bits = builder.bitcast(costs, ir.VectorType(_INT, lanes))
    numbers = builder.add(_ints(range(lanes)), splat(builder, first, lanes))
    ranks = builder.or_(builder.and_(bits, _ints([~int(NUMBER)] * lanes)), numbers)
    least = operation(builder, f'llvm.vector.reduce.umin.v{lanes}i32', _INT, [ranks.type])
    return builder.call(least, [ranks])


# ---- bins


@intrinsic
def add_to_bins(typingctx, boxes, counts, items, item, scales):
    """Add an item to a bin of each axis, sixteen bins an axis; what is no number, to the first.

    `scales`, twelve float32: the least of twice the centres, bins for a unit of these, number of
    the last bin; four places for each.
    """
    sig = types.void(boxes, counts, items, types.int64, scales)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        def place(argument: int, at: Any, vector: Any) -> Any:
            kind, array = signature.args[argument], args[argument]
            return _place(context, builder, kind, array, at, vector)

        box = builder.load(place(2, builder.mul(args[3], index(LANES)), _BOX), align=4)
        origin, slope, last = (
            builder.load(place(4, index(start), _FOUR), align=4) for start in (0, 4, 8)
        )
        center = builder.fsub(_half(builder, box, _HI), _half(builder, box, 0))
        number = builder.fmul(builder.fsub(center, origin), slope)
        number = pick(builder, '>', number, _floats(0.0, 4))
        number = pick(builder, '<', number, last)
        bins = builder.fptosi(number, ir.VectorType(_INT, 4))
        for axis in range(3):
            chosen = builder.zext(builder.extract_element(bins, ir.Constant(_INT, axis)), _LONG)
            chosen = builder.add(chosen, index(axis * WIDTH))
            union = place(0, builder.mul(chosen, index(LANES)), _BOX)
            builder.store(_larger(builder, box, builder.load(union, align=4)), union, align=4)
            count = place(1, chosen, _INT)
            builder.store(builder.add(builder.load(count), ir.Constant(_INT, 1)), count)
        return context.get_dummy_value()

    return sig, codegen


def _columns(builder: Any, rows: list[Any]) -> list[Any]:
    """Of vectors of four lanes: all first lanes, all second ones, all third ones."""
    count = len(rows)
    while len(rows) > 1:
        both = _ints(range(2 * rows[0].type.count))
        pairs = zip(rows[::2], rows[1::2], strict=True)
        rows = [builder.shuffle_vector(a, b, both) for a, b in pairs]
    every = rows[0]
    return [
        builder.shuffle_vector(every, every, _ints(range(axis, 4 * count, 4))) for axis in range(3)
    ]


def _union_edges(builder: Any, boxes: list[Any]) -> list[Any]:
    """Edges of the unions of the first one, two, three ... boxes."""
    union, edges = boxes[0], []
    for box in boxes:
        union = _larger(builder, union, box)
        edges.append(builder.fadd(_half(builder, union, 0), _half(builder, union, _HI)))
    return edges


def _running_sums(builder: Any, numbers: Any) -> Any:
    """Of each lane and all before it."""
    lanes, step = numbers.type.count, 1
    while step < lanes:
        order = [lanes] * step + list(range(lanes - step))
        shifted = builder.shuffle_vector(numbers, _ints([0] * lanes), _ints(order))
        numbers = builder.add(numbers, shifted)
        step *= 2
    return numbers


@intrinsic
def rank_bins(typingctx, boxes, counts, axis, total, planar):
    """The least rank of the splits between the bins of an axis, which hold `total` boxes; its
    number is 16 * axis + the last bin on the left.
    """
    sig = types.uint32(boxes, counts, types.int64, types.int64, types.boolean)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        boxes, counts, axis, total, planar = args
        first, tally = builder.mul(axis, index(WIDTH)), ir.VectorType(_INT, WIDTH)
        row = _boxes_from(context, builder, signature.args[0], boxes, first, index(WIDTH))
        row = [builder.load(builder.gep(row, [index(i)]), align=4) for i in range(WIDTH)]
        left = _union_edges(builder, row)
        # Right of the last bin there is nothing.
        right = [*_union_edges(builder, row[:0:-1])[::-1], _floats(float('-inf'), 4)]
        numbers = _place(context, builder, signature.args[1], counts, first, tally)
        lefts = _running_sums(builder, builder.load(numbers, align=4))
        rights = builder.sub(splat(builder, builder.trunc(total, _INT), WIDTH), lefts)
        costs = [
            builder.fmul(
                _areas(builder, _columns(builder, edges), planar),
                builder.sitofp(number, ir.VectorType(_FLOAT, WIDTH)),
            )
            for edges, number in ((left, lefts), (right, rights))
        ]
        return _least_rank(builder, builder.fadd(*costs), builder.trunc(first, _INT))

    return sig, codegen


# ---- few boxes


def _division_costs(
    builder: Any, boxes: Any, count: Any, planar: Any, lanes: int, on_left: Callable[[Any], Any]
) -> Any:
    """Costs of as many divisions of boxes as lanes; `on_left` tells in which of them a box is on
    the left.
    """
    lowest, none, one = (_floats(number, lanes) for number in (float('-inf'), 0.0, 1.0))
    left, right = ([variable(builder, lowest) for _ in _BOUNDS] for _ in '12')
    so_far = variable(builder, none)
    with each(builder, count) as number:
        box = builder.bitcast(builder.gep(boxes, [number]), _FLOAT.as_pointer())
        chosen = on_left(number)
        for i, a, b in zip(_BOUNDS, left, right, strict=True):
            bound = splat(builder, builder.load(builder.gep(box, [index(i)])), lanes)
            for side, here in ((a, chosen), (b, builder.not_(chosen))):
                old = builder.load(side)
                builder.store(builder.select(here, _larger(builder, old, bound), old), side)
        more = builder.select(chosen, one, none)
        builder.store(builder.fadd(builder.load(so_far), more), so_far)
    lefts = builder.load(so_far)
    rights = builder.fsub(splat(builder, builder.sitofp(count, _FLOAT), lanes), lefts)
    costs = []
    for side, boxes_there in ((left, lefts), (right, rights)):
        bounds = [builder.load(bound) for bound in side]
        edges = [builder.fadd(bounds[i], bounds[i + 1]) for i in (0, 2, 4)]
        costs.append(builder.fmul(_areas(builder, edges, planar), boxes_there))
    return builder.fadd(*costs)


@intrinsic
def rank_subsets(typingctx, items, start, count, planar):
    """The least rank of all divisions of three to five boxes; its number has a bit for each box on
    the left.
    """
    sig = types.uint32(items, types.int64, types.int64, types.boolean)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        items, start, count, planar = args
        boxes = _boxes_from(context, builder, signature.args[0], items, start, count)

        def on_left(box: Any) -> Any:
            bit = builder.shl(ir.Constant(_INT, 1), builder.trunc(box, _INT))
            bits = builder.and_(_ints(range(WIDTH)), splat(builder, bit, WIDTH))
            return builder.icmp_unsigned('!=', bits, _ints([0] * WIDTH))

        costs = _division_costs(builder, boxes, count, planar, WIDTH, on_left)
        return _least_rank(builder, costs, ir.Constant(_INT, 0))

    return sig, codegen


def _ranking_planes(lanes: int) -> Any:
    @intrinsic
    def rank_planes(typingctx, items, start, count, planes, axis, planar):
        """The least rank of the divisions of boxes at planes[16 * axis:]; its number is that of
        the plane.

        The boxes with their centre before or in the plane are on the left. `planes` are float32,
        twice the coordinate.
        """
        sig = types.uint32(items, types.int64, types.int64, planes, types.int64, types.boolean)

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            items, start, count, planes, axis, planar = args
            first = builder.mul(axis, index(WIDTH))
            boxes = _boxes_from(context, builder, signature.args[0], items, start, count)
            row = ir.VectorType(_FLOAT, lanes)
            row = _place(context, builder, signature.args[3], planes, first, row)
            here, bounds = builder.load(row, align=4), builder.bitcast(boxes, _FLOAT.as_pointer())

            def on_left(box: Any) -> Any:
                side = builder.add(builder.mul(box, index(LANES)), axis)
                low, high = (
                    builder.load(builder.gep(bounds, [builder.add(side, index(i))]))
                    for i in (0, _HI)
                )
                center = splat(builder, builder.fsub(high, low), lanes)
                return builder.fcmp_ordered('<=', center, here)

            costs = _division_costs(builder, boxes, count, planar, lanes, on_left)
            return _least_rank(builder, costs, builder.trunc(first, _INT))

        return sig, codegen

    return rank_planes


rank_planes8, rank_planes16 = _ranking_planes(LANES), _ranking_planes(WIDTH)
