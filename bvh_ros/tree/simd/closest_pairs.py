# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""At most eight boxes joined pair by pair, all pairs side by side in vectors (the agglomerative
build of Walter et al. 2008, "Fast Agglomerative Clustering for Rendering").
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ..compiler.intrinsics import LANES, each, index, on_stack, operation, splat, variable
from .float32x8 import BOUNDS, areas, boxes_from, ints, joined_by_halves, larger, place_at

_NAME = 511  # the bits of an area that give way to which two boxes it is of

_INT, _LONG = ir.IntType(32), ir.IntType(64)
_KEYS = ir.VectorType(_INT, LANES)
_LANE, _NO_PAIR = ints(range(LANES)), ints([-1] * LANES)


def _all_lanes(builder: Any, box: Any, place: int) -> Any:
    """One number of a box in all lanes."""
    return builder.shuffle_vector(box, box, ints([place] * LANES))


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """Eight vectors of eight: all first lanes, all second ones and so on."""

    def both(a: Any, b: Any, order: list[int]) -> Any:
        return builder.shuffle_vector(a, b, ints(order))

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
        self.columns = [variable(builder, lines[i]) for i in BOUNDS]
        self.table = on_stack(builder, ir.ArrayType(_KEYS, LANES))
        self.table.align = 32
        builder.store(_NO_PAIR, self.row_at(index(0)))
        for i in range(1, LANES):
            names = ints([8 * i + k if k < i else -1 for k in range(LANES)])
            keys = builder.or_(self.areas_with(rows[i])[1], names)
            there = builder.icmp_signed('<', ir.Constant(_INT, i), count)
            builder.store(builder.select(there, keys, _NO_PAIR), self.row_at(index(i)))
        self.done = variable(builder, self._ones('>=', count))
        self.stale = variable(builder, ints([0] * LANES))

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
        sides = [_all_lanes(builder, box, i) for i in BOUNDS]
        joined = [
            larger(builder, side, builder.load(column))
            for side, column in zip(sides, self.columns, strict=True)
        ]
        edges = [builder.fadd(joined[i], joined[i + 1]) for i in (0, 2, 4)]
        bits = builder.bitcast(areas(builder, edges, self.planar), _KEYS)
        return sides, builder.and_(bits, ints([~_NAME] * LANES))

    def closest(self) -> Any:
        """The end of the least key, after those of what was joined last are made none."""
        builder, found = self.builder, []
        least = operation(builder, f'llvm.umin.v{LANES}i32', _KEYS, [_KEYS] * 2)
        lowest = operation(builder, f'llvm.vector.reduce.umin.v{LANES}i32', _INT, [_KEYS])
        stale = builder.load(self.stale)
        for i in range(LANES):
            found.append(builder.or_(builder.load(self.row_at(index(i))), stale))
            builder.store(found[-1], self.row_at(index(i)))
        all_least = joined_by_halves(builder, lambda a, b: builder.call(least, [a, b]), found)
        return builder.and_(builder.call(lowest, [all_least]), ir.Constant(_INT, 63))

    def join(self, older: Any, younger: Any, age: Any) -> None:
        """Make the older one the union of both, as young as `age`."""
        builder = self.builder
        first, second = (builder.zext(one, _LONG) for one in (older, younger))
        boxes = [builder.load(self.box_at(one)) for one in (first, second)]
        union = larger(builder, *boxes)
        builder.store(union, self.box_at(first))
        sides, keys = self.areas_with(union)
        here, there = self._ones('==', older), self._ones('==', younger)
        chosen = builder.icmp_signed('!=', here, ints([0] * LANES))
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
            boxes = boxes_from(context, builder, signature.args[0], items, start, index(LANES))
            groups.append(_Clusters(builder, boxes, builder.trunc(count, _INT), planar))
        more = builder.icmp_signed('>', places[1], places[3])
        most = builder.select(more, places[1], places[3])
        with each(builder, builder.sub(most, index(1))) as step:
            age = builder.add(builder.trunc(step, _INT), ir.Constant(_INT, 1))
            for number, clusters in enumerate(groups):
                pair = clusters.closest()
                at = builder.add(step, index(LANES * number))
                place = place_at(context, builder, signature.args[6], pairs, at, _INT)
                builder.store(pair, place)
                older = builder.and_(pair, ir.Constant(_INT, LANES - 1))
                younger = builder.lshr(pair, ir.Constant(_INT, 3))
                clusters.join(older, younger, age)
        return context.get_dummy_value()

    return sig, codegen
