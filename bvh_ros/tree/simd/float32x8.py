# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The vector operations of a build: items into bins, candidates for a split side by side, one a
lane, and eight boxes that are joined pair by pair.

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

from ..compiler.intrinsics import (
    LANES,
    WIDTH,
    each,
    elements_at,
    index,
    on_stack,
    operation,
    pick,
    splat,
    variable,
)

NO_COST = np.uint32(0x7F800000)  # the bits of inf; those of NaN are above
NUMBER = np.uint32(63)  # the bits of a rank that are the candidate's number
NAME = 511  # the bits of an area that give way to which two boxes it is of

_INT, _LONG, _FLOAT = ir.IntType(32), ir.IntType(64), ir.FloatType()
_BOX, _FOUR = ir.VectorType(_FLOAT, LANES), ir.VectorType(_FLOAT, 4)
_HI = 4  # place of the upper bounds in an item
_SIDE = 3 * WIDTH * LANES * 4  # bytes of the bins of one side
_BOUNDS = [axis + side for axis in range(3) for side in (0, _HI)]


def _ints(numbers: Iterable[int]) -> Any:
    numbers = list(numbers)
    return ir.Constant(ir.VectorType(_INT, len(numbers)), numbers)


def _floats(number: float, lanes: int) -> Any:
    return ir.Constant(ir.VectorType(_FLOAT, lanes), [number] * lanes)


def _place_at(context: Any, builder: Any, kind: Any, array: Any, at: Any, vector: Any) -> Any:
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
    return builder.add(builder.shl(numbers, _ints([5] * 4)), _ints([0, 512, 1024, 0]))


def _add_to_bins(builder: Any, bins: Any, box: Any, places: Any) -> None:
    """Add a box to three bins, so many bytes from pointer `bins` on."""
    one = ir.Constant(_BOX, [0.0] * (LANES - 1) + [1.0])
    first = builder.bitcast(bins, ir.IntType(8).as_pointer())
    for place in places:
        union = builder.bitcast(
            builder.gep(first, [builder.zext(place, _LONG)]), _BOX.as_pointer()
        )
        more = builder.fadd(_larger(builder, box, builder.load(union, align=4)), one)
        builder.store(more, union, align=4)


def _box_and_center(context: Any, builder: Any, kind: Any, items: Any, item: Any) -> Any:
    box = builder.load(_boxes_from(context, builder, kind, items, item, index(1)), align=4)
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
        first = _boxes_from(context, builder, bins_kind, args[0], index(0), index(3 * WIDTH))
        scales = _place_at(context, builder, scales_kind, args[3], index(0), _FOUR)
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
            builder.load(_place_at(context, builder, test_kind, test, index(i), _FOUR), align=4)
            for i in (0, 4, 8)
        ]
        number = builder.fmul(builder.fsub(center, limits[0]), limits[1])
        number = builder.bitcast(builder.fsub(number, limits[2]), ir.VectorType(_INT, 4))
        # Signs, not a comparison: of that LLVM would make a branch, guessed wrong half the time.
        signs = builder.bitcast(builder.icmp_signed('<', number, _ints([0] * 4)), ir.IntType(4))
        before = builder.lshr(builder.zext(signs, _LONG), axis)
        place = builder.select(builder.icmp_signed('!=', before, index(0)), left, right)
        place = _boxes_from(context, builder, items_kind, items, place, index(1))
        builder.store(box, place, align=4)
        with builder.if_then(binned):
            side = builder.sub(index(1), before)
            at = builder.mul(builder.add(side, index(1)), index(12))
            scales = _place_at(context, builder, plan_kind, plan, at, _FOUR)
            places = _bins_of(builder, center, scales)
            far = splat(builder, builder.trunc(builder.mul(side, index(_SIDE)), _INT), 4)
            place = _place_at(context, builder, bins_kind, bins, there, places.type)
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
        item = _boxes_from(context, builder, items_kind, items, number, index(1))
        first = _boxes_from(context, builder, bins_kind, bins, index(0), index(6 * WIDTH))
        row = _place_at(context, builder, places_kind, places, at, ir.VectorType(_INT, 4))
        row = builder.bitcast(row, _INT.as_pointer())
        lanes = [builder.load(builder.gep(row, [index(axis)])) for axis in range(3)]
        _add_to_bins(builder, first, builder.load(item, align=4), lanes)
        return context.get_dummy_value()

    return sig, codegen


def _columns(builder: Any, rows: list[Any]) -> list[Any]:
    """Of vectors of four lanes: all first lanes, all second ones and so on."""
    count = len(rows)
    while len(rows) > 1:
        both = _ints(range(2 * rows[0].type.count))
        pairs = zip(rows[::2], rows[1::2], strict=True)
        rows = [builder.shuffle_vector(a, b, both) for a, b in pairs]
    every = rows[0]
    return [
        builder.shuffle_vector(every, every, _ints(range(axis, 4 * count, 4))) for axis in range(4)
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
        shifted = builder.shuffle_vector(numbers, _floats(0.0, lanes), _ints(order))
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
        row = _boxes_from(context, builder, signature.args[0], bins, begin, index(WIDTH))
        row = [builder.load(builder.gep(row, [index(i)]), align=4) for i in range(WIDTH)]
        left = _union_edges(builder, row)
        # Right of the last bin there is nothing.
        right = [*_union_edges(builder, row[:0:-1])[::-1], _floats(float('-inf'), 4)]
        counts = _columns(builder, [_half(builder, box, _HI) for box in row])[3]
        counts = pick(builder, '>', counts, _floats(0.0, WIDTH))
        lefts = _running_sums(builder, counts)
        rights = builder.fsub(splat(builder, builder.sitofp(total, _FLOAT), WIDTH), lefts)
        costs = [
            builder.fmul(_areas(builder, _columns(builder, edges)[:3], planar), number_there)
            for edges, number_there in ((left, lefts), (right, rights))
        ]
        return _least_rank(builder, builder.fadd(*costs), builder.trunc(number, _INT))

    return sig, codegen


def _joined_by_halves(builder: Any, join: Callable[[Any, Any], Any], parts: list[Any]) -> Any:
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
        row = _boxes_from(context, builder, signature.args[0], bins, first, index(WIDTH))
        row = [builder.load(builder.gep(row, [index(i)]), align=4) for i in range(WIDTH)]
        before = [builder.icmp_signed('<=', index(i), last) for i in range(WIDTH)]
        lowest = _floats(float('-inf'), LANES)
        for side in range(2):
            chosen = [
                builder.select(here, *((box, lowest), (lowest, box))[side])
                for here, box in zip(before, row, strict=True)
            ]
            union = _joined_by_halves(builder, functools.partial(_larger, builder), chosen)
            place = _boxes_from(context, builder, signature.args[3], unions, index(side), index(1))
            builder.store(union, place, align=4)
        return context.get_dummy_value()

    return sig, codegen


# ---- at most eight boxes joined pair by pair, all pairs side by side in vectors (agglomerative
# build of Walter et al. 2008, "Fast Agglomerative Clustering for Rendering")

_KEYS = ir.VectorType(_INT, LANES)
_LANE, _NO_PAIR = _ints(range(LANES)), _ints([-1] * LANES)


def _all_lanes(builder: Any, box: Any, place: int) -> Any:
    """One number of a box in all lanes."""
    return builder.shuffle_vector(box, box, _ints([place] * LANES))


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """Eight vectors of eight: all first lanes, all second ones and so on."""

    def both(a: Any, b: Any, order: list[int]) -> Any:
        return builder.shuffle_vector(a, b, _ints(order))

    low, high = [0, 8, 1, 9, 4, 12, 5, 13], [2, 10, 3, 11, 6, 14, 7, 15]
    pairs = [[both(rows[i], rows[i + 1], o) for o in (low, high)] for i in (0, 2, 4, 6)]
    low, high = [0, 1, 8, 9, 4, 5, 12, 13], [2, 3, 10, 11, 6, 7, 14, 15]
    fours = [
        [both(pairs[i][h], pairs[i + 1][h], o) for h in (0, 1) for o in (low, high)]
        for i in (0, 2)
    ]
    low, high = [0, 1, 2, 3, 8, 9, 10, 11], [4, 5, 6, 7, 12, 13, 14, 15]
    return [both(fours[0][i], fours[1][i], o) for o in (low, high) for i in range(4)]


class _Clusters:
    """Boxes by number, as rows in memory and as columns of vectors, and for each a row of keys: of
    the union with each one older, the area, then its own age, its number and that of the other.
    Least keys are of the closest pairs; those of no pair are all ones.
    """

    def __init__(self, builder: Any, boxes: Any, count: Any, planar: Any) -> None:
        self.builder, self.planar = builder, planar
        rows = [builder.load(builder.gep(boxes, [index(i)]), align=4) for i in range(LANES)]
        self.boxes = on_stack(builder, ir.ArrayType(rows[0].type, LANES))
        self.boxes.align = 32
        for i, row in enumerate(rows):
            builder.store(row, self.box_at(index(i)))
        lines = _transposed(builder, rows)
        self.columns = [variable(builder, lines[i]) for i in _BOUNDS]
        self.table = on_stack(builder, ir.ArrayType(_KEYS, LANES))
        self.table.align = 32
        builder.store(_NO_PAIR, self.row_at(index(0)))
        for i in range(1, LANES):
            names = _ints([8 * i + k if k < i else -1 for k in range(LANES)])
            keys = builder.or_(self.areas_with(rows[i])[1], names)
            there = builder.icmp_signed('<', ir.Constant(_INT, i), count)
            builder.store(builder.select(there, keys, _NO_PAIR), self.row_at(index(i)))
        self.done = variable(builder, self._ones('>=', count))
        self.stale = variable(builder, _ints([0] * LANES))

    def box_at(self, number: Any) -> Any:
        return self.builder.gep(self.boxes, [index(0), number])

    def row_at(self, number: Any) -> Any:
        return self.builder.gep(self.table, [index(0), number])

    def _ones(self, order: str, number: Any) -> Any:
        """All ones in the lanes of numbers in this order to a number."""
        limit = splat(self.builder, number, LANES)
        return self.builder.sext(self.builder.icmp_signed(order, _LANE, limit), _KEYS)

    def areas_with(self, box: Any) -> tuple[list[Any], Any]:
        """Sides of a box, each in all lanes; and areas of its unions with all, as integers of the
        same order.
        """
        builder = self.builder
        sides = [_all_lanes(builder, box, i) for i in _BOUNDS]
        joined = [
            _larger(builder, side, builder.load(column))
            for side, column in zip(sides, self.columns, strict=True)
        ]
        edges = [builder.fadd(joined[i], joined[i + 1]) for i in (0, 2, 4)]
        bits = builder.bitcast(_areas(builder, edges, self.planar), _KEYS)
        return sides, builder.and_(bits, _ints([~NAME] * LANES))

    def closest(self) -> Any:
        """The end of the least key, after those of what was joined last are made none."""
        builder, found = self.builder, []
        least = operation(builder, f'llvm.umin.v{LANES}i32', _KEYS, [_KEYS] * 2)
        lowest = operation(builder, f'llvm.vector.reduce.umin.v{LANES}i32', _INT, [_KEYS])
        stale = builder.load(self.stale)
        for i in range(LANES):
            found.append(builder.or_(builder.load(self.row_at(index(i))), stale))
            builder.store(found[-1], self.row_at(index(i)))
        all_least = _joined_by_halves(builder, lambda a, b: builder.call(least, [a, b]), found)
        return builder.and_(builder.call(lowest, [all_least]), ir.Constant(_INT, 63))

    def join(self, older: Any, younger: Any, age: Any) -> None:
        """Make the older one the union of both, as young as `age`."""
        builder = self.builder
        first, second = (builder.zext(one, _LONG) for one in (older, younger))
        boxes = [builder.load(self.box_at(one)) for one in (first, second)]
        union = _larger(builder, *boxes)
        builder.store(union, self.box_at(first))
        sides, keys = self.areas_with(union)
        here, there = self._ones('==', older), self._ones('==', younger)
        chosen = builder.icmp_signed('!=', here, _ints([0] * LANES))
        for side, column in zip(sides, self.columns, strict=True):
            builder.store(builder.select(chosen, side, builder.load(column)), column)
        builder.store(builder.or_(builder.load(self.done), there), self.done)
        builder.store(builder.or_(here, there), self.stale)
        name = builder.shl(older, ir.Constant(_INT, 3))
        name = builder.or_(name, builder.shl(age, ir.Constant(_INT, 6)))
        for more in (splat(builder, name, LANES), _LANE, builder.load(self.done), here):
            keys = builder.or_(keys, more)
        builder.store(_NO_PAIR, self.row_at(second))
        builder.store(keys, self.row_at(first))


@intrinsic
def pair_up(typingctx, items, start, count, other, other_count, planar, pairs):
    """Join at most eight boxes pair by pair: each time the two whose union is least, of equal ones
    those that were joined first. And at most eight from `other` on: a step waits for the one
    before it nearly all the time, so two groups take hardly longer than one. Eight of `items` must
    be there for each.

    pairs[i], int32, says which two: 8 * the younger one's number + the older one's, which is that
    of their union from then on. From pairs[8] on, those of the other group; what follows the last
    of a group means nothing.
    """
    places = [types.int64] * 4
    sig = types.void(items, *places, types.boolean, pairs)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        items, *places, planar, pairs = args
        groups = []
        for start, count in (places[:2], places[2:]):
            boxes = _boxes_from(context, builder, signature.args[0], items, start, index(LANES))
            groups.append(_Clusters(builder, boxes, builder.trunc(count, _INT), planar))
        more = builder.icmp_signed('>', places[1], places[3])
        most = builder.select(more, places[1], places[3])
        with each(builder, builder.sub(most, index(1))) as step:
            age = builder.add(builder.trunc(step, _INT), ir.Constant(_INT, 1))
            for number, clusters in enumerate(groups):
                pair = clusters.closest()
                at = builder.add(step, index(LANES * number))
                place = _place_at(context, builder, signature.args[6], pairs, at, _INT)
                builder.store(pair, place)
                older = builder.and_(pair, ir.Constant(_INT, LANES - 1))
                younger = builder.lshr(pair, ir.Constant(_INT, 3))
                clusters.join(older, younger, age)
        return context.get_dummy_value()

    return sig, codegen
