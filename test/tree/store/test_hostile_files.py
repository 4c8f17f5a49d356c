# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files and pickles that somebody has tampered with: refused with a ValueError, or the tree that
comes answers as brute force over its own boxes does, and lives on.

In a process of its own, so that a crash is seen. 10,000 states with BVH_ROS_LONG_TESTS=1.
"""

import io
import os
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tree.compiler.alone import run_alone
from tree.reference import LONG, exact_hits, overlapping_pairs, overlapping_rows, seen

from bvh_ros import DynamicBVH
from bvh_ros.tree.access import SLOT_MASK

Rng = np.random.Generator
State = dict[str, Any]

ARRAYS = ('nodes', 'heights', 'tight', 'handles', 'state')
NUMBERS = [0, 1, -1, -2, 2**31 - 1, -(2**31), 2**62, -(2**63), 7, SLOT_MASK + 1, 41]
FLOATS = [np.nan, np.inf, -np.inf, 1e308, -1e308, 0.0, -0.0, 5e-324]


def kept(rng: Rng) -> State:
    """The state of a tree that has lived."""
    ndim, margin = int(rng.integers(2, 4)), float(rng.choice([0.0, 0.2]))
    lo = rng.uniform(0, 20, (int(rng.integers(1, 30)), ndim))
    tree = DynamicBVH(ndim, margin=margin, capacity=int(rng.integers(1, 45)))
    handles = tree.insert_many(lo, lo + 1, rng.integers(0, 4, len(lo)))
    tree.remove_many(rng.choice(handles, len(lo) // 3, replace=False))
    state = tree.__getstate__()
    return {name: np.array(value) for name, value in state.items() if name != 'added'}


# ---- ways to tamper; each changes a state in place


def write_a_number(rng: Rng, state: State) -> None:
    array = state[rng.choice(ARRAYS)]
    if not array.size:
        return
    field = array if array.dtype.names is None else array[rng.choice(array.dtype.names)]
    place = tuple(int(rng.integers(length)) for length in field.shape)
    if field.dtype.kind == 'f':
        field[place] = rng.choice([*FLOATS, field[place] + rng.choice([-1, 1])])
    else:
        near = int(field[place]) + rng.choice([-2, -1, 1, 2, 64])
        number = int(rng.choice([*NUMBERS, near]))
        bits = 8 * field.dtype.itemsize
        unsigned = np.array(number % 2**bits, f'u{field.dtype.itemsize}')
        field[place] = unsigned.view(field.dtype)


def flip_a_bit(rng: Rng, state: State) -> None:
    array = state[rng.choice(ARRAYS)]
    if array.size:
        data = array.view(np.uint8).reshape(-1)
        data[rng.integers(len(data))] ^= np.uint8(1 << rng.integers(8))


def exchange_two(rng: Rng, state: State) -> None:
    array = state[rng.choice(ARRAYS)]
    if len(array) > 1:
        i, j = rng.choice(len(array), 2, replace=False)
        array[[i, j]] = array[[j, i]]


def name_free_slots(rng: Rng, state: State) -> None:
    handles = state['handles']
    free = np.flatnonzero(handles < 0)
    free = free[: int(rng.integers(len(free) + 1))]
    handles[free] = (SLOT_MASK + 1) | free


def exchange_free_lists(rng: Rng, state: State) -> None:
    state['state'][[2, 3]] = state['state'][[3, 2]]


def splice_free_lists(rng: Rng, state: State) -> None:
    """A link of one list leads into the other."""
    parents = state['nodes']['parent']
    node = int(state['state'][rng.choice([2, 3])])
    if node >= 0:
        parents[node] ^= 1


def forget_exact_boxes(rng: Rng, state: State) -> None:
    state['tight'] = state['tight'][: int(rng.integers(2))]
    state['margin'] = np.array(rng.choice([0.0, 1.0]))


def give_serials_again(rng: Rng, state: State) -> None:
    live = np.flatnonzero(state['handles'] >= 0)
    state['handles'][live] = int(rng.integers(3)) * (SLOT_MASK + 1) | live


def change_a_value(rng: Rng, state: State) -> None:
    name = rng.choice(['ndim', 'margin', 'serial', 'version', 'sibling_search', 'counters'])
    values = [0, 2, 3, -1, 2**62, 1.5, np.nan, 'greedy', 'best', [1, 2], [['inserted', '1']], 0.0]
    state[name] = np.array(values[rng.integers(len(values))])


def change_a_form(rng: Rng, state: State) -> None:
    name = rng.choice([*ARRAYS, 'counters', 'margin'])
    array = state[name]
    forms: list[Callable[[Any], Any]] = [
        lambda a: a[:-1] if a.ndim else a,
        lambda a: a[::-1] if a.ndim else a,
        lambda a: a[None],
        lambda a: np.concatenate([a, a]) if a.ndim else a,
        lambda a: a.astype(a.dtype.newbyteorder()),
        lambda a: a.tobytes(),
        lambda a: np.zeros(a.shape, np.float32),
        lambda a: np.repeat(a, 2, axis=0)[::2] if a.ndim else a,
        lambda a: a[:0] if a.ndim else a,
        lambda a: np.array(7),
    ]
    state[name] = np.asarray(forms[rng.integers(len(forms))](array))


def leave_out(rng: Rng, state: State) -> None:
    del state[rng.choice(list(state))]


def nothing(rng: Rng, state: State) -> None:
    """What is whole must be taken."""


TAMPERING = [write_a_number] * 6 + [flip_a_bit] * 6 + [exchange_two] * 3 + [name_free_slots]
TAMPERING += [exchange_free_lists, splice_free_lists, forget_exact_boxes, give_serials_again]
TAMPERING += [change_a_value, change_a_form, leave_out, nothing]


# ---- what comes of it


def through_a_file(rng: Rng, state: State) -> DynamicBVH:
    path = Path(f'tampered-{os.getpid()}.npz')
    file = io.BytesIO()
    (np.savez if rng.random() < 0.5 else np.savez_compressed)(file, **state)
    data = bytearray(file.getvalue())
    if rng.random() < 0.2:
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(len(data))] ^= 1 << rng.integers(8)
    if rng.random() < 0.05:
        del data[rng.integers(len(data)) :]
    path.write_bytes(data)
    try:
        return DynamicBVH.load(path)
    finally:
        path.unlink()


def through_a_pickle(rng: Rng, state: State) -> DynamicBVH:
    tree = DynamicBVH.__new__(DynamicBVH)
    tree.__setstate__(pickle.loads(pickle.dumps(state)))
    return tree


def check_answers(rng: Rng, tree: DynamicBVH) -> None:
    tree.validate()
    handles, ndim = tree.ids(), tree.ndim
    lo, hi = tree.boxes(handles)
    visible = tree.masks(handles) != 0
    starts, ways = rng.uniform(-5, 25, (6, ndim)), rng.normal(size=(6, ndim))
    hits = tree.raycast_many(np.repeat(starts, 12, axis=0), np.repeat(ways, 12, axis=0)).ids[::12]
    for got, of_ray in zip(hits, exact_hits(lo, hi, starts, ways), strict=True):
        wanted = [int(handles[hit.row]) for hit in seen(of_ray, handles, visible=visible)]
        assert int(got) == (wanted[0] if wanted else -1)
    low, high = np.full(ndim, 3.0), np.full(ndim, 9.0)
    rows = overlapping_rows(lo, hi, low, high)
    assert tree.overlap(low, high).tolist() == handles[rows[visible[rows]]].tolist()
    pairs = [p for p in overlapping_pairs(lo, hi) if visible[list(p)].all()]
    assert tree.overlap_pairs().tolist() == [[handles[i], handles[j]] for i, j in pairs]


def live_on(rng: Rng, tree: DynamicBVH) -> None:
    """Every kind of change, and growth."""
    check_answers(rng, tree)
    ndim = tree.ndim
    for _ in range(3):
        tree.insert(np.zeros(ndim), rng.uniform(0, 20, ndim))
    tree.remove_many(rng.choice(tree.ids(), len(tree) // 3, replace=False))
    lo = rng.uniform(0, 20, (len(tree), ndim))
    tree.move_many(tree.ids(), lo, lo + 1, rng.normal(size=lo.shape))
    check_answers(rng, tree)
    tree.insert_many(np.zeros((50, ndim)), rng.uniform(0, 9, (50, ndim)))
    tree.optimize()
    tree.rebuild()
    check_answers(rng, tree)
    tree.clear()
    assert len(tree.ids()) == len(tree) == 0


def tamper(first: int, stop: int) -> None:
    accepted = 0
    for seed in range(first, stop):
        rng = np.random.default_rng(seed)
        state = kept(rng)
        tampering = [TAMPERING[seed % len(TAMPERING)]]
        if rng.random() < 0.2:
            tampering.append(TAMPERING[rng.integers(len(TAMPERING))])
        try:
            for change in tampering:
                change(rng, state)
        except (IndexError, KeyError, TypeError, ValueError, AttributeError):
            pass  # nothing left that it could be done to
        print(seed, *(change.__name__ for change in tampering), flush=True)
        try:
            tree = (through_a_file if rng.random() < 0.5 else through_a_pickle)(rng, state)
        except ValueError:
            continue
        live_on(rng, tree)
        accepted += 1
    print(f'accepted {accepted}')


@pytest.mark.parametrize('part', range(2))
def test_tampered_states(part: int, tmp_path: Path) -> None:
    count = 5000 if LONG else 300  # also where indices are checked: these lead to wrong ones
    tampering = 'import sys; from tree.store.test_hostile_files import tamper; '
    tampering += 'tamper(*map(int, sys.argv[1:]))'
    ended = run_alone(tampering, str(part * count), str((part + 1) * count), cwd=tmp_path)
    accepted = ended.stdout.splitlines()[-1]
    assert int(accepted.split()[1]) > count // 50  # what is whole, and what has no meaning


# ---- files that claim to be large


def rewritten(path: Path, name: str, content: bytes) -> None:
    """One array of the file exchanged."""
    with zipfile.ZipFile(path) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    members[f'{name}.npy'] = content
    with zipfile.ZipFile(path, 'w', zipfile.ZIP_DEFLATED) as archive:
        for member, data in members.items():
            archive.writestr(member, data)


def header(shape: tuple[int, ...], descr: str = '<i8') -> bytes:
    file = io.BytesIO()
    fields = {'descr': descr, 'fortran_order': False, 'shape': shape}
    np.lib.format.write_array_header_1_0(file, fields)
    return file.getvalue()


@pytest.mark.parametrize('name', [*ARRAYS, 'version', 'margin', 'counters'])
@pytest.mark.parametrize('shape', [(2**40,), (2**62, 8), (-5,), (2**26 + 1,), ()])
def test_a_claimed_shape_takes_no_memory(
    name: str, shape: tuple[int, ...], tmp_path: Path
) -> None:
    path = tmp_path / 'tree.npz'
    DynamicBVH(2).save(path)
    for content in (header(shape), header(shape, '|V1000000000'), b'\x93NUMPY\x09\x00', b''):
        rewritten(path, name, content)
        with pytest.raises(ValueError, match=r'tree\.npz'):
            DynamicBVH.load(path)


def test_what_unpacks_to_nothing_but_zeros_is_not_unpacked(tmp_path: Path) -> None:
    """131,072 places, all zero, in a file of 20 kB: refused by the size alone."""
    path, places = tmp_path / 'tree.npz', 2**17
    tree = DynamicBVH(3, capacity=places)
    tree.save(path)
    DynamicBVH.load(path)  # an empty tree of that size is sound
    state = tree.__getstate__()
    state.pop('added', None)
    np.savez_compressed(path, **(state | {'nodes': np.zeros_like(state['nodes'])}))
    with pytest.raises(ValueError, match='compressed'):
        DynamicBVH.load(path)
