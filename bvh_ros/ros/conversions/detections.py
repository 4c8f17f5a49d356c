# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A vision_msgs/Detection3DArray as turned boxes with names."""

from __future__ import annotations

from collections.abc import Generator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.cdr.any_message import Columns
from bvh_ros.ros.conversions.placing import IntoNode, Placing
from bvh_ros.scene import ShapeKind, Shapes, unchecked_shapes

FIELDS = 'header', 'detections.header', 'detections.bbox', 'detections.id'


class Detections(NamedTuple):
    """n detections in the node's frame, one a row."""

    names: list[str]
    shapes: Shapes
    stamps: NDArray[np.int64]  # (n,) ns, 0 where there is none
    reasons: dict[int, str]  # why some rows have no place; it is NaN there


def read(
    columns: Columns, *, into_node: IntoNode, prefix: str, source: str
) -> Generator[None, None, Detections]:
    """Read detections; pause now and then.

    Parameters
    ----------
    into_node : callable
        As of `Placing`.
    prefix, source : str
        A detection is called `prefix` + its id, or, where that is empty or an earlier detection
        has it, `prefix` + `source` + '#' + its row.

    Raises
    ------
    ValueError
        If no row can be used because of its frame.
    """
    ids, own = columns.texts('detections.id'), columns.texts('detections.header.frame_id')
    taken: set[str] = {''}
    names = []
    for row, name in enumerate(ids):
        names.append(f'{prefix}{source}#{row}' if name in taken else f'{prefix}{name}')
        taken.add(name)
    (frame_id,) = columns.texts('header.frame_id')
    stamps = columns.stamps('detections.header.stamp')
    stamps = np.where(stamps == 0, columns.stamps('header.stamp'), stamps)
    numbers: dict[str, int] = {}
    frame = np.array([numbers.setdefault(each or frame_id, len(numbers)) for each in own], int)
    boxes = columns.numbers('detections.bbox')  # position, orientation, size
    shapes = unchecked_shapes(
        np.full(len(boxes), ShapeKind.BOX, np.uint8), boxes[:, :3], boxes[:, 3:7], boxes[:, 7:]
    )
    placing, rows = Placing(list(numbers), frame, stamps, into_node), np.arange(len(boxes))
    reasons = yield from placing.find(rows)
    if reasons and len(reasons) == len(boxes):
        raise ValueError(next(iter(reasons.values())))
    yield from placing.move(shapes, rows)
    shapes.position[list(reasons)] = np.nan
    return Detections(names, shapes, stamps, reasons)
