# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a batch of rays may be given as, and what it refuses, through the wide snapshot and without
it.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tree.adversary import Floats

from bvh_ros import DynamicBVH

RAYS = 200
BOXES = {'binary tree': 20_000, 'wide snapshot': 40}
NAN, INF = float('nan'), float('inf')


def scene(ndim: int, boxes: int) -> tuple[DynamicBVH, Floats, Floats]:
    """A tree, and rays in it whose numbers are exact in float32 too."""
    rng = np.random.default_rng(0)
    lo = rng.integers(-100, 100, (boxes, ndim)).astype(float)
    tree = DynamicBVH.from_boxes(lo, lo + rng.integers(1, 20, (boxes, ndim)))
    origins = rng.integers(-120, 120, (RAYS, ndim)).astype(float)
    return tree, origins, rng.integers(1, 9, (RAYS, ndim)).astype(float)


def read_only(rows: Floats) -> Floats:
    rows = rows.copy()
    rows.flags.writeable = False
    return rows


def unaligned(rows: Floats) -> Floats:
    room = np.empty(rows.nbytes + 1, np.uint8)[1:].view(np.float64).reshape(rows.shape)
    room[...] = rows
    return room


FORMS: dict[str, Callable[[Floats], Any]] = {
    'float64, C order': np.copy,
    'float32': lambda rows: rows.astype(np.float32),
    'integers': lambda rows: rows.astype(np.int16),
    'big-endian': lambda rows: rows.astype('>f8'),
    'Fortran order': np.asfortranarray,
    'every second row of more': lambda rows: np.repeat(rows, 2, axis=0)[::2],
    'columns of more': lambda rows: np.hstack([rows, rows])[:, : rows.shape[1]],
    'read-only': read_only,
    'unaligned': unaligned,
    'lists': lambda rows: rows.tolist(),
}


@pytest.mark.parametrize('form', FORMS.values(), ids=FORMS)
def test_all_forms_of_input_answer_alike_and_stay_as_they_are(form: Callable[..., Any]) -> None:
    tree, origins, directions = scene(3, BOXES['wide snapshot'])
    alone = [tree.raycast(*ray) for ray in zip(origins, directions, strict=True)]
    starts, ways = form(origins), form(directions)
    hits = tree.raycast_many(starts, ways)
    assert tree.stats()['wide_snapshot']
    assert hits.ids.tolist() == [hit.id if hit else -1 for hit in alone]
    assert hits.t.tolist() == [hit.t if hit else INF for hit in alone]
    assert hits.normals.tolist() == [hit.normal.tolist() if hit else [0] * 3 for hit in alone]
    assert (tree.occluded_many(starts, ways) == (hits.ids >= 0)).all()
    assert (np.array(starts) == origins).all()
    assert (np.array(ways) == directions).all()


@pytest.mark.parametrize('ndim', [2, 3])
@pytest.mark.parametrize('boxes', BOXES.values(), ids=BOXES)
@pytest.mark.parametrize('bad', [NAN, INF, -INF])
@pytest.mark.parametrize('argument', ['origins', 'directions'])
@pytest.mark.parametrize('threads', [1, 2])
def test_the_first_row_that_is_not_finite_is_named(
    ndim: int, boxes: int, bad: float, argument: str, threads: int
) -> None:
    tree, origins, directions = scene(ndim, boxes)
    tree.raycast_many(origins, directions)
    assert tree.stats()['wide_snapshot'] == (boxes < RAYS)
    before = tree.stats()
    given = {'origins': origins, 'directions': directions}
    for axis in range(ndim):
        spoilt = given[argument].copy()
        spoilt[[7, 150], [axis, 0]] = bad
        for ask in (tree.raycast_many, tree.occluded_many):
            with pytest.raises(ValueError, match=f'^{argument} must be finite: row 7 '):
                ask(**{**given, argument: spoilt}, threads=threads)
    assert tree.stats() == before


@pytest.mark.parametrize('boxes', BOXES.values(), ids=BOXES)
def test_one_for_all_is_the_same_for_each(boxes: int) -> None:
    tree, origins, directions = scene(3, boxes)
    tree.set_masks(tree.ids(), np.arange(boxes) % 4)
    for mask in (1, 2, np.uint32(2)):
        for t_max in (0, 5.0, np.float64(9.5)):
            one = tree.raycast_many(origins, directions, t_max, mask)
            each = tree.raycast_many(
                origins, directions, np.full(RAYS, t_max), np.full(RAYS, mask)
            )
            for a, b in zip(one, each, strict=True):
                assert (a == b).all()
            assert (tree.occluded_many(origins, directions, t_max, mask) == (one.ids >= 0)).all()
