# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Input: every bad argument is named, with its first bad row, and changes nothing; every array a
robot's software makes is taken.
"""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from odd_values import masked
from tree.arguments import ARGUMENTS, HI, LO, ONE, ask, some_tree
from tree.reference import snapshot

from bvh_ros import DynamicBVH
from bvh_ros.tree.access import OpenTree

NAN, INF = float('nan'), float('inf')


def with_row(row: int, value: Any, array: Any = LO) -> Any:
    changed = np.array(array, float)
    changed[row] = value
    return changed


# Rows of coordinates that are refused, and why.
ROWS = [
    (with_row(3, [0, NAN, 0]), 'row 3'),
    (with_row(4, NAN, with_row(2, NAN)), 'row 2'),
    (with_row(1, [INF, 0, 0]), 'row 1'),
    (with_row(0, [0, 0, -INF]), 'row 0'),
    *((bad, 'shape') for bad in (LO[:, :2], np.zeros((5, 4)), ONE, 0.0, np.zeros((5, 3, 1)))),
    *((bad, 'numbers') for bad in ([['a', 'b', 'c']] * 5, [[0, 0, 0], [0, 0]], LO + 1j)),
    (None, 'shape|numbers|finite'),
]
POINTS = [[0, NAN, 0], [INF, 0, 0], [0, 0], [0, 0, 0, 0], 1.0, [[0, 0, 0]], ['a', 'b', 'c']]
POINTS += [[[0], [0, 1], 0], None]
NO_NUMBERS = [np.array(['NaT'] * 3, 'M8[s]'), masked((3,)), ['1'] * 3, [10**400] * 3, [None] * 3]
POINTS += NO_NUMBERS
ROWS += [(value if type(value) is not list else [value] * 5, '') for value in NO_NUMBERS]
COORDINATES = 'lo hi displacement origin origins direction directions translation point points'
MASKS, LIMITS = [-1, 2**32, 0.5, 1.0, True, 'all', NAN], [NAN, -1e-300, -INF, 'far', None]
COUNTS = [0, -1, 1.5]
MARGINS = [-0.1, NAN, INF, 'wide']
# Of other arguments: what is refused, and where a row is named, which one.
OTHERS: dict[str, list[Any]] = {
    'insert_many hi': [HI[:4]],
    'raycast_many directions': [HI[:4]],
    'raycast t_max': LIMITS,
    'raycast_all t_max': LIMITS,
    'occluded t_max': LIMITS,
    'raycast_many t_max': [[1, 2], NAN, ([1, 2, NAN, 4, NAN], 'row 2')],
    'occluded_many t_max': [([1, 2, 3, 4, -1], 'row 4')],
    'raycast_all_many t_max': [NAN],
    'nearest max_distance': [NAN, -1.0],
    'nearest_many max_distance': [-1.0, ([1, -1, 1, 1, 1], 'row 1')],
    **{f'{name} mask': MASKS for name in ('insert', 'raycast', 'overlap', 'nearest', 'occluded')},
    'overlap_pairs mask': [NAN],
    'insert_many mask': [[1, 2], ([1, 1, 1, -1, -2], 'row 3')],
    'set_masks mask': [[1, 2], ([1, 2**32, 1, 1, 1], 'row 1')],
    'raycast_many mask': [np.full(5, 0.5)],
    'overlap_many mask': [[[1]] * 5],
    'query_ball r': [INF, ([1, 1, 1, -1, 1], 'row 3')],
    'nearest k': COUNTS,
    'nearest_many k': COUNTS,
    'raycast_many threads': COUNTS,
    'overlap_many threads': COUNTS,
    'remove_many handles': [[0.5]],
    'boxes handles': [np.zeros((2, 2), int)],
    '__init__ ndim': [1, 4, '3', True, None],
    '__init__ margin': MARGINS,
    'from_boxes margin': MARGINS,
    'from_boxes mask': [[1]],
    '__init__ sibling_search': ['best', None],
    '__init__ capacity': [0, 1.5],
}


def bad_values() -> dict[str, list[tuple[Any, str]]]:
    """What each argument refuses, and what the error says beside its name."""
    found = {what: [v if type(v) is tuple else (v, '') for v in OTHERS[what]] for what in OTHERS}
    for what in ARGUMENTS:
        method, name = what.split(' ', 1)
        if name in COORDINATES.split():
            rows = method.endswith('_many') or method in ('from_boxes', 'exits', 'query_ball')
            values = ROWS if rows else [(point, '') for point in POINTS]
            if name == 'displacement':  # None is no displacement
                values = [(value, why) for value, why in values if value is not None]
            if name in ('origins', 'directions'):  # one row is the same for all rays
                values = [(value, why) for value, why in values if value is not ONE]
            found[what] = found.get(what, []) + values
    return found


@pytest.mark.parametrize(('what', 'values'), bad_values().items(), ids=bad_values())
def test_bad_arguments(what: str, values: list[tuple[Any, str]]) -> None:
    name = '(lo|hi)' if what == 'from_boxes lo' else what.split(' ')[1]
    for value, why in values:
        check_refused(lambda t, value=value: ask(t, what, value), rf'\b{name}\b.*({why})')


MISTAKES: list[tuple[Callable[[DynamicBVH], Any], str]] = [
    # boxes upside down
    (lambda t: t.insert([0, 0, 2], [1, 1, 1]), 'lo .* hi'),
    (lambda t: t.insert_many(with_row(2, 5), HI), 'lo .* hi.* row 2'),
    (lambda t: t.move(t.ids()[0], [0, 0, 2], [1, 1, 1]), 'lo .* hi'),
    (lambda t: t.move_many(t.ids()[:5], with_row(4, 5), HI), 'row 4'),
    (lambda t: t.overlap([0, 2, 0], [1, 1, 1]), 'lo .* hi'),
    (lambda t: t.contains([0, 2, 0], [1, 1, 1]), 'lo .* hi'),
    (lambda t: t.boxcast([0, 2, 0], [1, 1, 1], ONE), 'lo .* hi'),
    (lambda t: t.overlap_many(with_row(1, 5), HI), 'row 1'),
    (lambda t: DynamicBVH.from_boxes(with_row(1, 5), HI), 'row 1'),
    (lambda t: t.move_many(t.ids()[:5], LO[:4], HI[:4]), r'\blo\b'),
    # handles
    (lambda t: t.remove_many(t.ids()[[4, 1, 4]]), 'handles.*row 2'),
    (lambda t: t.move_many(t.ids()[[0, 0, 1, 2, 3]], LO, HI), 'row 1'),
    (lambda t: t.set_masks(t.ids()[[0, 3, 3]], 1), 'handles.*row 2'),
]
UNKNOWN: list[tuple[Callable[[DynamicBVH], Any], str]] = [
    (lambda t: t.remove_many([*t.ids()[:3], 7]), '7'),
    (lambda t: t.move_many([*t.ids()[:4], -1], LO, HI), '-1'),
    (lambda t: t.set_masks([5], 1), '5'),
    (lambda t: t.boxes([*t.ids(), 123456789]), '123456789'),
    (lambda t: t.masks([0]), '0'),
    (lambda t: OpenTree.from_boxes(LO, HI).slots([[7]]), '7'),
]


@pytest.mark.parametrize(('call', 'says'), MISTAKES)
def test_mistakes(call: Callable[[DynamicBVH], Any], says: str) -> None:
    check_refused(call, says)


@pytest.mark.parametrize(('call', 'says'), UNKNOWN)
def test_unknown_handles(call: Callable[[DynamicBVH], Any], says: str) -> None:
    check_refused(call, says, KeyError)


def check_refused(
    call: Callable[[DynamicBVH], Any], says: str, error: type[Exception] = ValueError
) -> None:
    """One plain sentence, and the tree as it was."""
    tree = some_tree(40, 0.1)
    before = snapshot(tree)
    with pytest.raises(error) as caught:
        call(tree)
    message = str(caught.value.args[0])
    assert re.search(says, message, re.DOTALL), message
    assert len(message) < 400
    tree.validate()
    assert snapshot(tree) == before
    # Nothing is used up either: the next handle is the one it would have been.
    assert tree.insert(ONE, ONE) == some_tree(40, 0.1).insert(ONE, ONE)


NO_HANDLES = [0, 5, -1, -(2**63), 2**63 - 1, 2**70, 'crate', '0', None, 1.5, NAN, (1, 2), True]


@pytest.mark.parametrize('handle', NO_HANDLES, ids=repr)
def test_what_never_was_a_handle(handle: Any) -> None:
    for tree in (some_tree(40, 0.1), DynamicBVH(3)):
        assert handle not in tree
        for call in (tree.remove, lambda h, tree=tree: tree.move(h, ONE, ONE)):
            with pytest.raises(KeyError, match=re.escape(repr(handle))):
                call(handle)


def test_a_handle_is_any_integer_of_its_value() -> None:
    tree = some_tree(40, 0.1)
    a, b, c = tree.ids()[:3]
    assert all(kind(a) in tree for kind in (int, np.int64, np.uint64))
    tree.remove(int(a))
    tree.remove(np.int64(b))
    tree.remove_many(np.array([c], np.uint64))
    assert len(tree) == 37


# ---- what is taken

FORMS: dict[str, Callable[[Any], Any]] = {
    'lists': lambda a: a.tolist(),
    'tuples': lambda a: tuple(map(tuple, a.tolist())) if a.ndim == 2 else tuple(a.tolist()),
    'float32': lambda a: a.astype(np.float32),
    'float16': lambda a: a.astype(np.float16),
    'integers': lambda a: a.astype(np.int16),
    'big-endian': lambda a: a.astype('>f8'),
    'Fortran order': np.asfortranarray,
    'every second': lambda a: np.repeat(a, 2, axis=0)[::2],
    'a column range': lambda a: np.pad(a, [(0, 0)] * (a.ndim - 1) + [(1, 2)])[..., 1:-2],
    'reversed twice': lambda a: a[::-1].copy()[::-1],
    'read-only': lambda a: read_only(a),
    'unaligned': lambda a: (
        np.frombuffer(b'x' + a.tobytes(), np.uint8)[1:].view(np.float64).reshape(a.shape)
    ),
    'objects': lambda a: a.astype(object),
}


def read_only(array: Any) -> Any:
    array = array.copy()
    array.setflags(write=False)
    return array


@pytest.mark.parametrize('form', FORMS.values(), ids=FORMS.keys())
@pytest.mark.parametrize('ndim', [2, 3])
def test_any_array_is_taken_and_left_as_it_was(form: Callable[[Any], Any], ndim: int) -> None:
    """Whole numbers, which all types hold; the same answers as from plain float64."""
    rng = np.random.default_rng(3)
    lo = rng.integers(0, 40, (100, ndim)).astype(float)
    hi = lo + rng.integers(0, 5, lo.shape)
    origins, ways = (
        rng.integers(-9, 50, (80, ndim)).astype(float),
        rng.integers(-3, 4, (80, ndim)).astype(float),
    )
    given = [form(array) for array in (lo, hi, origins, ways)]
    before = [repr(array) for array in given]
    # Each row of scalar calls in the same form.
    rows = [form(array[0]) for array in (lo, hi, origins, ways)]
    with np.printoptions(threshold=10**9):
        assert answers(*given, *rows) == answers(
            lo, hi, origins, ways, lo[0], hi[0], origins[0], ways[0]
        )
    assert [repr(array) for array in given] == before


def answers(
    lo: Any, hi: Any, origins: Any, ways: Any, low: Any, high: Any, origin: Any, way: Any
) -> Any:
    tree = DynamicBVH.from_boxes(lo, hi)
    handles = tree.ids()
    tree.insert(low, high)
    tree.insert_many(lo, hi)
    tree.move(handles[5], low, high, way)
    tree.move_many(handles, hi, hi)
    tree.validate()
    found = [
        *tree.boxes(tree.ids()),
        *tree.raycast_many(origins, ways),
        *tree.raycast_all_many(origins, ways),
        tree.occluded_many(origins, ways),
        *tree.overlap_many(lo, hi),
        *tree.nearest_many(origins, 3),
        tree.overlap(low, high),
        *tree.nearest(origin, 3),
    ]
    hits = tree.raycast_all(origin, way)
    return [array.tolist() for array in found], [
        (hit.id, hit.t, hit.point.tolist()) for hit in hits
    ]


def test_what_goes_in_and_comes_out_is_not_shared() -> None:
    """Writing into the caller's arrays or into an answer changes no tree."""
    lo, hi, masks = np.zeros((6, 2)), np.ones((6, 2)), np.ones(6, np.uint32)
    for margin in (0.0, 0.1):
        tree = DynamicBVH(2, margin=margin)
        handles = tree.insert_many(lo, hi, masks)
        tree.move_many(handles, lo, hi)
        tree.raycast_many(lo, hi)
        before = snapshot(tree)
        for array in (lo, hi, masks, handles, tree.ids(), *tree.boxes(tree.ids()), *tree.bounds):
            array[:] = 7
        hit = tree.raycast([-1, 0.5], [1, 0])
        hit.point[:] = hit.normal[:] = 7
        inside = tree.raycast([0.5, 0.5], [1, 0])
        inside.point[:] = 7
        assert snapshot(tree) == before
        tree.validate()
        lo[:], hi[:], masks[:] = 0, 1, 1
