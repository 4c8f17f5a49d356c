# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Anything for any argument of any method: it is taken, or refused with a ValueError that names
the argument (a KeyError where a handle is meant), and then the tree is as it was.
"""

import copy
import pickle
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tree.arguments import ARGUMENTS, HI, LO, LOW, ONE
from tree.reference import snapshot

from bvh_ros import DynamicBVH


def a_list_in_itself() -> list[Any]:
    loop: list[Any] = []
    loop.append(loop)
    return loop


def masked(shape: tuple[int, ...]) -> Any:
    values = np.ma.ones(shape)
    values[(1,) * len(shape)] = np.ma.masked
    return values


class Raises:
    """What raises whatever it is asked for (as a tensor that will not be an array does)."""

    def __init__(self, error: type[Exception]) -> None:
        self.error = error

    def fail(self, *_: Any, **__: Any) -> Any:
        raise self.error('not for you')

    __array__ = __float__ = __index__ = __repr__ = __str__ = fail


NUMBERS = [0, -1, 0.5, 2**26 + 1, 2**63, 2**64, 2**70, 10**400, -(10**400), 1e308, 1j, True]
NUMBERS += [float('inf'), -float('inf'), float('nan'), Fraction(10**400, 3), Decimal('NaN')]
NUMBERS += [Decimal('Infinity'), Decimal('sNaN'), Decimal('1e999999'), np.bool_(True)]
NUMBERS += [np.longdouble('1e4000'), np.uint64(2**64 - 1), np.int8(-1), np.float32('nan')]
THINGS = [None, '', '1', 'nan', b'1', 'x\0y', object(), object, {}, {1: 2}, {1, 2}, slice(3), ...]
THINGS += [len, (x for x in ONE), range(3), memoryview(b'abc'), NotImplemented, Path('/none/a')]
TIMES = [np.datetime64('NaT'), np.datetime64('2026-01-01'), np.timedelta64(1, 's')]
TIMES += [np.timedelta64('NaT'), np.array(['NaT'] * 3, 'M8[s]'), np.full((5, 3), 'NaT', 'm8[ns]')]
ARRAYS = [[], [[]], [[[]]], [[1], [1, 2]], [1, [2]], [None] * 3, ['1'] * 3, [b'1'] * 3, [1j] * 3]
ARRAYS += [
    np.array(5),
    np.array(5.0),
    np.array('x'),
    np.array(None),
    np.array([5.0]),
    [10**400] * 3,
]
ARRAYS += [np.zeros((0, 3)), np.zeros((3, 0)), np.zeros((5, 3, 1)), np.array([{}] * 3, object)]
ARRAYS += [np.full((5, 3), '1', object), np.full((5, 3), 10**400, object), np.zeros(3, 'V4')]
ARRAYS += [np.zeros(3, [('x', float)]), masked((3,)), masked((5, 3)), list(masked((5, 3)))]
ARRAYS += [np.ma.masked, [np.ma.masked, 1, 1], [[np.ma.masked, 1, 1]] * 5, a_list_in_itself()]
ARRAYS += [np.full((5, 3), np.nan), [ONE, ONE, [1, 1, np.inf], ONE, ONE], np.zeros(5), [1, 2]]
ARRAYS += [
    np.broadcast_to(0.0, (2**40, 3)),
    np.broadcast_to(0.0, (3, 2**40)),
]  # views of one number
ERRORS = (
    RuntimeError,
    KeyError,
    IndexError,
    AttributeError,
    OverflowError,
    BufferError,
    UserWarning,
)
ARRAYS += [Raises(error) for error in ERRORS] + [[Raises(RuntimeError)] * 3]
VALUES = NUMBERS + THINGS + TIMES + ARRAYS


def some_tree() -> DynamicBVH:
    lo = np.random.default_rng(1).uniform(0, 20, (8, 3))
    return DynamicBVH.from_boxes(lo, lo + 1)


def too_many_to_ask(what: str, value: Any) -> bool:
    """So many queries, moves or handles may be asked for: what lacks is memory."""
    many = isinstance(value, np.ndarray) and len(np.shape(value)) > 1 and len(value) == 2**40
    return many and what in (
        'raycast_many origins',
        'occluded_many origins',
        'nearest_many points',
        'raycast_all_many origins',
        'overlap_many lo',
        'exits origins',
    )


@pytest.mark.filterwarnings('ignore')
def test_anything_for_any_argument(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    failures = []
    for what, call in ARGUMENTS.items():
        name = what.split()[1].rstrip(',')
        tree = some_tree()
        before = snapshot(tree)
        refused = (ValueError, *([KeyError] if name in ('handle', 'id') else []))
        if name == 'path':
            refused = (*refused, OSError)
        for position, value in enumerate(VALUES):
            if too_many_to_ask(what, value):
                continue
            shown = f'value {position}, a {type(value).__name__}'
            try:
                call(tree, value)
                tree = some_tree()
            except refused as error:
                # Where there are no rows, it is the other arguments that have too many.
                named = name in str(error) or 'shape (0, 3)' in str(error)
                named = named and '\n' not in str(error)
                if not isinstance(error, OSError) and not named:
                    failures.append(f'{what}: {shown}: {error}')
                if snapshot(tree) != before:
                    failures.append(f'{what}: {shown} has changed the tree')
                    tree = some_tree()
            except Exception as error:
                failures.append(f'{what}: {shown}: {type(error).__name__}: {error}')
    assert not failures, '\n'.join(failures)


NEVER = [np.array(['NaT'] * 3, 'M8[s]'), masked((3,)), ['1'] * 3, [10**400] * 3, [None] * 3]


@pytest.mark.parametrize('value', NEVER, ids=map(str, range(len(NEVER))))
def test_no_numbers_are_not_taken_for_some(value: Any) -> None:
    tree = some_tree()
    for call in (tree.nearest, lambda x: tree.insert(LOW, x), lambda x: tree.raycast(x, ONE)):
        with pytest.raises(ValueError, match=r'point|hi|origin'):
            call(value)
    rows = [value] * 5 if isinstance(value, list) else np.ma.stack([value] * 5)
    for call in (tree.nearest_many, lambda x: tree.insert_many(LO - 1, x)):
        with pytest.raises(ValueError, match=r'points|hi'):
            call(rows)
    if isinstance(value, np.ma.MaskedArray):
        for taken in (value.filled(7), np.ma.array(value.filled(7))):  # none is masked
            tree.nearest(taken)


@pytest.mark.parametrize('name', ['ndim', 'margin', 'sibling_search'])
def test_what_a_tree_is_made_with_stays(name: str) -> None:
    with pytest.raises(AttributeError):
        setattr(some_tree(), name, 2)


# ---- subclasses


class Named(DynamicBVH):
    """With other arguments than the class itself."""

    def __init__(self, name: str, tags: list[str]) -> None:
        super().__init__(2, margin=0.5)
        self.name, self.tags = name, tags


class Counted(DynamicBVH):
    """With the same, and more."""

    def __init__(self, *args: Any, owner: str = 'nobody', **options: Any) -> None:
        super().__init__(*args, **options)
        self.owner = owner


COPIES: dict[str, Callable[[Any], Any]] = {
    'copy': copy.copy,
    'deepcopy': copy.deepcopy,
    'pickle': lambda tree: pickle.loads(pickle.dumps(tree)),
}


@pytest.mark.parametrize('way', COPIES.values(), ids=COPIES.keys())
def test_a_subclass_is_copied_with_what_it_adds(way: Callable[[Any], Any]) -> None:
    tree = Named('north', ['a'])
    handle = tree.insert([0, 0], [1, 1])
    twin = way(tree)
    assert type(twin) is Named
    assert (twin.name, twin.tags, twin.margin, twin.ids().tolist()) == (
        'north',
        ['a'],
        0.5,
        [handle],
    )
    assert (twin.tags is tree.tags) == (way is copy.copy)
    twin.remove(handle)
    assert handle in tree


def test_a_subclass_is_loaded_and_built(tmp_path: Path) -> None:
    tree = Named('north', [])
    tree.insert([0, 0], [1, 1])
    tree.save(tmp_path / 'tree')
    for made in (Named.load(tmp_path / 'tree'), Named.from_boxes([[0, 0]], [[1, 1]])):
        assert type(made) is Named
        made.insert([0, 0], [2, 2])
        made.validate()
        assert len(made) == 2
    built = Counted.from_boxes(LO, HI, margin=0.25)
    assert (built.owner, built.margin, len(built)) == ('nobody', 0.25, 5)


def test_no_handle_is_looked_for_under_a_mask() -> None:
    tree = some_tree()
    ids = np.ma.masked_array(tree.ids(), [True] + [False] * 7)
    rays = np.zeros((8, 3)), np.ones((8, 3))
    for call in (tree.slots, tree.boxes, tree.remove_many, lambda x: tree.exits(*rays, x)):
        with pytest.raises(ValueError, match=r'masked'):
            call(ids)
    assert len(tree) == 8


def test_a_memoryview_has_a_number_a_row() -> None:
    tree = some_tree()
    tree.set_masks(tree.ids(), np.arange(1, 9))
    limits, masks = np.arange(5) * 9.0, np.arange(1, 6)
    told = tree.raycast_many(LO, HI, limits, masks)
    again = tree.raycast_many(LO, HI, memoryview(limits), memoryview(masks))
    assert all(np.array_equal(one, other) for one, other in zip(told, again, strict=True))
    with pytest.raises(ValueError, match='mask must'):
        tree.raycast_many(LO, HI, limits, memoryview(masks[:1]))
