# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The box of a node, lower and upper bounds as vectors of four float64, into float32 items of a
build, see `build.binning`.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ..compiler.intrinsics import index, operation, record_at, splat
from .float32x8 import boxes_from, ints, place_at

SIDES = 4  # places of a vector
UNITS = SIDES + 1  # a centre, and what a unit of length is multiplied by

_DOUBLE = ir.DoubleType()
_ROW, _FLOATS = ir.VectorType(_DOUBLE, SIDES), ir.VectorType(ir.FloatType(), SIDES)


def _box_of(context: Any, builder: Any, kind: Any, nodes: Any, node: Any) -> list[Any]:
    """Lower and upper bounds of a node, zeros behind them. They are its first fields: no lane is
    read of what is no float64.
    """
    ndim = kind.dtype.typeof('lo').shape[0]
    first = builder.bitcast(record_at(context, builder, kind, nodes, node), _DOUBLE.as_pointer())
    zeros, rows = ir.Constant(_ROW, [0.0] * SIDES), []
    for start, lane in ((0, 0), (2 * ndim - SIDES, SIDES - ndim)):
        place = builder.bitcast(builder.gep(first, [index(start)]), _ROW.as_pointer())
        row = builder.load(place, align=8)
        order = [*range(lane, lane + ndim), *[SIDES] * (SIDES - ndim)]
        rows.append(builder.shuffle_vector(row, zeros, ints(order)))
    return rows


@intrinsic
def enclose(typingctx, nodes, node, lo, hi):
    """Widen bounds, four float64 each, to those of a node."""
    sig = types.void(nodes, types.int64, lo, hi)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        rows = _box_of(context, builder, signature.args[0], *args[:2])
        for row, name, argument in zip(rows, ('minnum', 'maxnum'), (2, 3), strict=True):
            kind = signature.args[argument]
            place = place_at(context, builder, kind, args[argument], index(0), _ROW)
            wider = operation(builder, f'llvm.{name}.v4f64', _ROW, [_ROW] * 2)
            bounds = builder.call(wider, [row, builder.load(place, align=8)], fastmath=('nnan',))
            builder.store(bounds, place, align=8)
        return context.get_dummy_value()

    return sig, codegen


@intrinsic
def write_item(typingctx, items, item, nodes, node, units):
    """Write the item of a node: its box less units[:4], times units[4]."""
    sig = types.void(items, types.int64, nodes, types.int64, units)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        items, item, nodes, node, units = args
        rows = _box_of(context, builder, signature.args[2], nodes, node)
        kind = signature.args[4]
        center = builder.load(place_at(context, builder, kind, units, index(0), _ROW), align=8)
        scale = builder.load(place_at(context, builder, kind, units, index(SIDES), _DOUBLE))
        narrow = []
        for row, factor in zip(rows, (builder.fneg(scale), scale), strict=True):
            scaled = builder.fmul(builder.fsub(row, center), splat(builder, factor, SIDES))
            narrow.append(builder.fptrunc(scaled, _FLOATS))
        number = builder.bitcast(builder.trunc(node, ir.IntType(32)), ir.FloatType())
        narrow[0] = builder.insert_element(narrow[0], number, ir.Constant(ir.IntType(32), 3))
        place = boxes_from(context, builder, signature.args[0], items, item, index(1))
        builder.store(builder.shuffle_vector(*narrow, ints(range(2 * SIDES))), place, align=4)
        return context.get_dummy_value()

    return sig, codegen
