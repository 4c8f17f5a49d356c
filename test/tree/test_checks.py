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
from tree.arguments import ARGUMENTS, HI, LO
from tree.reference import snapshot

from bvh_ros import DynamicBVH

NAN, INF = float('nan'), float('inf')


def some_tree() -> DynamicBVH:
    lo = np.random.default_rng(1).uniform(0, 20, (40, 3))
    return DynamicBVH.from_boxes(lo, lo + 1, margin=0.1)


ONE = [0.0, 0.0, 0.0]


def taking(names: set[str], *, rows: bool) -> dict[str, tuple[str, Any]]:
    """Calls with these arguments, and the name that a refusal tells."""
    found = {}
    for what, call in ARGUMENTS.items():
        method, name = what.split(' ', 1)
        if name in names and (method.endswith('_many') or method == 'from_boxes') == rows:
            found[what] = '(lo|hi)' if what == 'from_boxes lo' else name, call
    return found


def with_row(array: Any, row: int, value: Any) -> Any:
    changed = np.array(array, float)
    changed[row] = value
    return changed


# ---- arrays of coordinates

BAD_ROWS = {
    # what comes as rows of n, and the part of the sentence that says why
    'NaN in row 3': (with_row(LO, 3, [0, NAN, 0]), 'row 3'),
    'NaN in rows 2 and 4': (with_row(with_row(LO, 4, NAN), 2, NAN), 'row 2'),
    'infinite': (with_row(LO, 1, [INF, 0, 0]), 'row 1'),
    'minus infinite': (with_row(LO, 0, [0, 0, -INF]), 'row 0'),
    'too few columns': (LO[:, :2], 'shape'),
    'too many columns': (np.zeros((5, 4)), 'shape'),
    'one row': (ONE, 'shape'),
    'one number': (0.0, 'shape'),
    'three axes': (np.zeros((5, 3, 1)), 'shape'),
    'words': ([['a', 'b', 'c']] * 5, 'numbers'),
    'None': (None, 'shape|numbers|finite'),
    'ragged': ([[0, 0, 0], [0, 0]], 'numbers'),
    'complex': (LO + 1j, 'numbers'),
}

TAKES_ROWS = taking({'lo', 'hi', 'displacement', 'origins', 'directions', 'points'}, rows=True)


@pytest.mark.parametrize(('name', 'call'), TAKES_ROWS.values(), ids=TAKES_ROWS.keys())
def test_bad_rows(name: str, call: Callable[..., Any]) -> None:
    for value, why in BAD_ROWS.values():
        if value is not None or name != 'displacement':  # None is no displacement
            check_refused(call, value, ValueError, rf'\b{name}\b.*({why})')


BAD_POINTS = {
    'NaN': [0, NAN, 0],
    'infinite': [INF, 0, 0],
    'too short': [0, 0],
    'too long': [0, 0, 0, 0],
    'a number': 1.0,
    'rows': [[0, 0, 0]],
    'words': ['a', 'b', 'c'],
    'ragged': [[0], [0, 1], 0],
    'None': None,
}

TAKES_A_POINT = taking(
    {'lo', 'hi', 'displacement', 'origin', 'direction', 'translation', 'point'}, rows=False
)


@pytest.mark.parametrize(('name', 'call'), TAKES_A_POINT.values(), ids=TAKES_A_POINT.keys())
def test_bad_points(name: str, call: Callable[..., Any]) -> None:
    for value in BAD_POINTS.values():
        if value is not None or name != 'displacement':  # None is no displacement
            check_refused(call, value, ValueError, rf'\b{name}\b')


# ---- everything else

OTHERS: dict[str, tuple[Callable[[DynamicBVH], Any], type[Exception], str]] = {
    # boxes upside down
    'insert': (lambda t: t.insert([0, 0, 2], [1, 1, 1]), ValueError, 'lo .* hi'),
    'insert_many': (
        lambda t: t.insert_many(with_row(LO, 2, 5), HI),
        ValueError,
        'lo .* hi.* row 2',
    ),
    'move': (lambda t: t.move(t.ids()[0], [0, 0, 2], [1, 1, 1]), ValueError, 'lo .* hi'),
    'move_many': (lambda t: t.move_many(t.ids()[:5], with_row(LO, 4, 5), HI), ValueError, 'row 4'),
    'overlap': (lambda t: t.overlap([0, 2, 0], [1, 1, 1]), ValueError, 'lo .* hi'),
    'boxcast': (lambda t: t.boxcast([0, 2, 0], [1, 1, 1], ONE), ValueError, 'lo .* hi'),
    'overlap_many': (lambda t: t.overlap_many(with_row(LO, 1, 5), HI), ValueError, 'row 1'),
    'from_boxes': (lambda t: DynamicBVH.from_boxes(with_row(LO, 1, 5), HI), ValueError, 'row 1'),
    # lengths that do not agree
    'hi shorter': (lambda t: t.insert_many(LO, HI[:4]), ValueError, r'\bhi\b.*shape'),
    'lo shorter than handles': (
        lambda t: t.move_many(t.ids()[:5], LO[:4], HI[:4]),
        ValueError,
        r'\blo\b',
    ),
    'directions shorter': (lambda t: t.raycast_many(LO, HI[:4]), ValueError, 'directions.*shape'),
    't_max of another length': (
        lambda t: t.raycast_many(LO, HI, [1, 2]),
        ValueError,
        't_max.*shape',
    ),
    'masks of another length': (
        lambda t: t.insert_many(LO, HI, [1, 2]),
        ValueError,
        'mask.*shape',
    ),
    'masks for handles': (lambda t: t.set_masks(t.ids(), [1, 2]), ValueError, 'mask.*shape'),
    # t_max and max_distance
    't_max NaN': (lambda t: t.raycast(ONE, ONE, NAN), ValueError, 't_max'),
    't_max negative': (lambda t: t.raycast_all(ONE, ONE, -1e-300), ValueError, 't_max'),
    't_max minus infinite': (lambda t: t.occluded(ONE, ONE, -INF), ValueError, 't_max'),
    't_max a word': (lambda t: t.raycast(ONE, ONE, 'far'), ValueError, 't_max'),
    't_max None': (lambda t: t.raycast(ONE, ONE, None), ValueError, 't_max'),
    't_max NaN in a row': (
        lambda t: t.raycast_many(LO, HI, [1, 2, NAN, 4, NAN]),
        ValueError,
        't_max.*row 2',
    ),
    't_max negative in a row': (
        lambda t: t.occluded_many(LO, HI, [1, 2, 3, 4, -1]),
        ValueError,
        'row 4',
    ),
    't_max NaN for all': (lambda t: t.raycast_all_many(LO, HI, NAN), ValueError, 't_max'),
    'max_distance NaN': (lambda t: t.nearest(ONE, 1, NAN), ValueError, 'max_distance'),
    'max_distance negative': (lambda t: t.nearest_many(LO, 1, -1.0), ValueError, 'max_distance'),
    'max_distance in a row': (
        lambda t: t.nearest_many(LO, 1, [1, -1, 1, 1, 1]),
        ValueError,
        'row 1',
    ),
    # masks
    'mask -1': (lambda t: t.insert(ONE, ONE, -1), ValueError, 'mask'),
    'mask of 33 bits': (lambda t: t.raycast(ONE, ONE, mask=2**32), ValueError, 'mask'),
    'mask of a half': (lambda t: t.overlap(ONE, ONE, 0.5), ValueError, 'mask'),
    'mask a word': (lambda t: t.nearest(ONE, mask='all'), ValueError, 'mask'),
    'mask NaN': (lambda t: t.overlap_pairs(NAN), ValueError, 'mask'),
    'mask None in a query': (lambda t: t.occluded(ONE, ONE, mask=None), ValueError, 'mask'),
    'masks -1': (lambda t: t.insert_many(LO, HI, [1, 1, 1, -1, -2]), ValueError, 'mask.*row 3'),
    'masks of 33 bits': (
        lambda t: t.set_masks(t.ids()[:2], [1, 2**32]),
        ValueError,
        'mask.*row 1',
    ),
    'masks of floats': (
        lambda t: t.raycast_many(LO, HI, mask=np.full(5, 0.5)),
        ValueError,
        'mask',
    ),
    'masks in rows': (lambda t: t.overlap_many(LO, HI, [[1]] * 5), ValueError, 'mask'),
    # counts
    'k 0': (lambda t: t.nearest(ONE, 0), ValueError, r'\bk\b'),
    'k -1': (lambda t: t.nearest_many(LO, -1), ValueError, r'\bk\b'),
    'k of a half': (lambda t: t.nearest(ONE, 1.5), ValueError, r'\bk\b'),
    'threads 0': (lambda t: t.raycast_many(LO, HI, threads=0), ValueError, 'threads'),
    'threads -2': (lambda t: t.overlap_many(LO, HI, threads=-2), ValueError, 'threads'),
    'threads of a half': (lambda t: t.occluded_many(LO, HI, threads=1.5), ValueError, 'threads'),
    # handles
    'twice in remove_many': (
        lambda t: t.remove_many(t.ids()[[4, 1, 4]]),
        ValueError,
        'handles.*row 2',
    ),
    'twice in move_many': (
        lambda t: t.move_many(t.ids()[[0, 0, 1, 2, 3]], LO, HI),
        ValueError,
        'row 1',
    ),
    'twice in set_masks': (
        lambda t: t.set_masks(t.ids()[[0, 3, 3]], 1),
        ValueError,
        'handles.*row 2',
    ),
    'handles of floats': (lambda t: t.remove_many([0.5]), ValueError, 'handles'),
    'handles in rows': (lambda t: t.boxes(t.ids()[:4].reshape(2, 2)), ValueError, 'handles'),
    'unknown among known': (lambda t: t.remove_many([*t.ids()[:3], 7]), KeyError, '7'),
    'unknown in move_many': (lambda t: t.move_many([*t.ids()[:4], -1], LO, HI), KeyError, '-1'),
    'unknown in set_masks': (lambda t: t.set_masks([5], 1), KeyError, '5'),
    'unknown in boxes': (lambda t: t.boxes([*t.ids(), 123456789]), KeyError, '123456789'),
    'unknown in masks': (lambda t: t.masks([0]), KeyError, '0'),
    # the tree itself
    'ndim 1': (lambda t: DynamicBVH(1), ValueError, 'ndim'),
    'ndim 4': (lambda t: DynamicBVH(4), ValueError, 'ndim'),
    'ndim a word': (lambda t: DynamicBVH('3'), ValueError, 'ndim'),
    'ndim True': (lambda t: DynamicBVH(True), ValueError, 'ndim'),
    'ndim None': (lambda t: DynamicBVH(None), ValueError, 'ndim'),
    'margin negative': (lambda t: DynamicBVH(margin=-0.1), ValueError, 'margin'),
    'margin NaN': (lambda t: DynamicBVH(margin=NAN), ValueError, 'margin'),
    'margin infinite': (lambda t: DynamicBVH(margin=INF), ValueError, 'margin'),
    'margin a word': (lambda t: DynamicBVH(margin='wide'), ValueError, 'margin'),
    'from_boxes margin': (
        lambda t: DynamicBVH.from_boxes(LO, HI, margin=-1),
        ValueError,
        'margin',
    ),
    'from_boxes mask': (lambda t: DynamicBVH.from_boxes(LO, HI, mask=[1]), ValueError, 'mask'),
    'search': (lambda t: DynamicBVH(sibling_search='best'), ValueError, 'sibling_search'),
    'search None': (lambda t: DynamicBVH(sibling_search=None), ValueError, 'sibling_search'),
    'capacity 0': (lambda t: DynamicBVH(capacity=0), ValueError, 'capacity'),
    'capacity of a half': (lambda t: DynamicBVH(capacity=1.5), ValueError, 'capacity'),
}


@pytest.mark.parametrize(('call', 'error', 'says'), OTHERS.values(), ids=OTHERS.keys())
def test_bad_arguments(
    call: Callable[[DynamicBVH], Any], error: type[Exception], says: str
) -> None:
    check_refused(lambda tree, _: call(tree), None, error, says)


def check_refused(
    call: Callable[[DynamicBVH, Any], Any], value: Any, error: type[Exception], says: str
) -> None:
    """One plain sentence, and the tree as it was."""
    tree = some_tree()
    before = snapshot(tree)
    with pytest.raises(error) as caught:
        call(tree, value)
    message = str(caught.value.args[0])
    assert re.search(says, message, re.DOTALL), message
    assert len(message) < 400
    tree.validate()
    assert snapshot(tree) == before
    # Nothing is used up either: the next handle is the one it would have been.
    twin = some_tree()
    assert tree.insert(ONE, ONE) == twin.insert(ONE, ONE)


UNKNOWN_HANDLES = [
    0,
    5,
    -1,
    -(2**63),
    2**63 - 1,
    2**70,
    'crate',
    '0',
    None,
    1.5,
    NAN,
    (1, 2),
    True,
    np.int64(3),
]


@pytest.mark.parametrize('handle', UNKNOWN_HANDLES, ids=repr)
def test_what_never_was_a_handle(handle: Any) -> None:
    for tree in (some_tree(), DynamicBVH(3)):
        assert handle not in tree
        for call in (tree.remove, lambda h, tree=tree: tree.move(h, ONE, ONE)):
            with pytest.raises(KeyError, match=re.escape(repr(handle))):
                call(handle)


@pytest.mark.parametrize('handle', [0, 5, -1, -(2**63), 2**63 - 1])
@pytest.mark.parametrize('dtype', [np.int64, object])
def test_what_never_was_a_handle_in_a_batch(handle: int, dtype: Any) -> None:
    tree = some_tree()
    with pytest.raises((KeyError, ValueError) if dtype is object else KeyError):
        tree.remove_many(np.array([handle], dtype))
    with pytest.raises(KeyError):
        tree.remove_many(np.array([2**64 - 1], np.uint64))
    assert len(tree) == 40


def test_a_handle_is_any_integer_of_its_value() -> None:
    tree = some_tree()
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
