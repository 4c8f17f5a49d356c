# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trees mapped from files: the same answers, no changes; a file that is not whole is refused."""

import ast
import copy
import json
import pickle
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tree.compiler.alone import run_alone
from tree.reference import LONG, snapshot

from bvh_ros import DynamicBVH
from bvh_ros.tree.access import mapped

DAMAGES = 3000 if LONG else 300


def lived_in(ndim: int, margin: float, count: int = 300) -> DynamicBVH:
    rng = np.random.default_rng(ndim)
    lo = rng.uniform(0, 20, (count, ndim))
    tree = DynamicBVH(ndim, margin=margin)
    handles = tree.insert_many(lo, lo + 1, rng.integers(1, 2**32, count, dtype=np.uint32))
    tree.remove_many(handles[::5])
    return tree


def answers(tree: DynamicBVH) -> list[Any]:
    rng = np.random.default_rng(5)
    origins, directions = rng.uniform(-5, 25, (2, 2000, tree.ndim))
    hits = tree.raycast_many(origins, directions)
    near = tree.nearest_many(origins[:50], 3)
    parts = tree.overlap_many(origins[:50], origins[:50] + 2)
    return [*hits, *near, *parts, tree.overlap_pairs(), tree.ids(), tree.stats()['cost']]


@pytest.mark.parametrize(('ndim', 'margin'), [(2, 0.0), (3, 0.0), (3, 0.2)])
def test_a_mapped_tree_answers_as_the_saved_one(tmp_path, ndim, margin):
    tree = lived_in(ndim, margin)
    tree.save(tmp_path / 'tree', mapped=True)
    shared = DynamicBVH.load(tmp_path / 'tree', mmap=True)
    shared.validate()
    read = DynamicBVH.load(tmp_path / 'tree')
    for other in (shared, read, copy.copy(shared), pickle.loads(pickle.dumps(shared))):
        assert snapshot(other) == snapshot(tree)
        for one, its in zip(answers(tree), answers(other), strict=True):
            np.testing.assert_array_equal(one, its)
        if other is not shared:  # it is in memory of its own
            new = other.insert(np.zeros(ndim), np.ones(ndim))
            assert new == copy.copy(tree).insert(np.zeros(ndim), np.ones(ndim))
            other.validate()


@pytest.mark.parametrize('count', [0, 1])
def test_small_trees(tmp_path, count):
    tree = lived_in(3, 0.0, 2 * count)
    tree.save(tmp_path / 'tree', mapped=True)
    shared = DynamicBVH.load(tmp_path / 'tree', mmap=True)
    assert len(shared) == count
    assert (shared.raycast([-5, 0, 0], [1, 0, 0]) is None) or count


CHANGES: list[Callable[[DynamicBVH, int], Any]] = [
    lambda tree, one: tree.insert([0, 0, 0], [1, 1, 1]),
    lambda tree, one: tree.insert_many(np.zeros((999, 3)), np.ones((999, 3))),
    lambda tree, one: tree.move(one, [0, 0, 0], [1, 1, 1]),
    lambda tree, one: tree.move(one, [0, 0, 0], [1, 1, 1], [1, 0, 0]),
    lambda tree, one: tree.move_many([one], [[0, 0, 0]], [[1, 1, 1]]),
    lambda tree, one: tree.move_many([one], [[0, 0, 0]], [[1, 1, 1]], [[1, 0, 0]]),
    lambda tree, one: tree.set_masks([one], 7),
    lambda tree, one: tree.remove(one),
    lambda tree, one: tree.remove_many([one]),
    lambda tree, one: tree.clear(),
    lambda tree, one: tree.rebuild(),
    lambda tree, one: tree.optimize(),
]


def test_a_mapped_tree_refuses_every_change(tmp_path):
    tree = lived_in(3, 0.0)
    tree.save(tmp_path / 'tree', mapped=True)
    content = (tmp_path / 'tree').read_bytes()
    shared = DynamicBVH.load(tmp_path / 'tree', mmap=True)
    for change in CHANGES:
        with pytest.raises(ValueError, match='read-only'):
            change(shared, int(shared.ids()[0]))
        assert snapshot(shared) == snapshot(tree)
    shared.validate()
    assert (tmp_path / 'tree').read_bytes() == content


ASK = """
import sys
from bvh_ros import DynamicBVH
print(DynamicBVH.load(sys.argv[1], mmap=True).overlap([0, 0, 0], [9, 9, 9]).tolist())
"""


def test_processes_share_a_file_and_keep_the_one_they_opened(tmp_path):
    tree = lived_in(3, 0.0)
    wanted = tree.overlap([0, 0, 0], [9, 9, 9]).tolist()
    tree.save(tmp_path / 'tree', mapped=True)
    shared = DynamicBVH.load(tmp_path / 'tree', mmap=True)
    said = run_alone(ASK, str(tmp_path / 'tree')).stdout
    assert json.loads(said) == wanted
    DynamicBVH().save(tmp_path / 'tree', mapped=True)  # puts a new file in its place
    assert shared.overlap([0, 0, 0], [9, 9, 9]).tolist() == wanted
    assert len(DynamicBVH.load(tmp_path / 'tree', mmap=True)) == 0
    assert [file.name for file in tmp_path.iterdir()] == ['tree']


def is_refused_both_ways(path: Path) -> bool:
    """Whether a file is refused, mapped and read."""
    refusals = 0
    for mmap in (True, False):
        try:
            DynamicBVH.load(path, mmap=mmap)
        except ValueError:
            refusals += 1
    return refusals == 2


def test_a_file_that_is_not_whole_is_refused(tmp_path):
    lived_in(2, 0.0, 20).save(tmp_path / 'tree', mapped=True)
    whole, path = (tmp_path / 'tree').read_bytes(), tmp_path / 'damaged'
    head = mapped.HEAD.size + mapped.HEAD.unpack(whole[: mapped.HEAD.size])[1]
    for place in range(head):  # every byte of the header
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 64]) + whole[place + 1 :])
        assert is_refused_both_ways(path)
    for length in [*range(0, head, 7), mapped.PAGE, len(whole) - 1]:
        path.write_bytes(whole[:length])
        assert is_refused_both_ways(path)
    path.write_bytes(whole + b'more')
    with pytest.raises(ValueError, match='bytes long'):
        DynamicBVH.load(path, mmap=True)
    first = mapped.PAGE
    for place in range(first, first + 2000, 37):  # of the nodes
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(ValueError, match='CRC-32'):
            DynamicBVH.load(path)


def test_a_header_that_lies_is_refused(tmp_path):
    lived_in(3, 0.0, 20).save(tmp_path / 'tree', mapped=True)
    whole = (tmp_path / 'tree').read_bytes()
    start = mapped.HEAD.size
    stop = start + mapped.HEAD.unpack(whole[:start])[1]
    header = json.loads(whole[start:stop])
    lies = [{name: wrong} for name in header for wrong in (None, 'x', -1, 2**70, [], [[1, 2]], {})]
    lies += [
        {'capacity': 2**40},
        {'ndim': 4},
        {'counters': [3]},
        {'counters': [[1], [2, 3]]},
        {'fat': 1},
        {'margin': float('nan')},
    ]
    lies += [{'state': [2**31, *header['state'][1:]]}, {'state': [-5] * len(header['state'])}]
    for lie in lies:
        text = json.dumps(header | lie).encode()
        head = mapped.HEAD.pack(mapped.MAGIC, len(text), zlib.crc32(text)) + text
        (tmp_path / 'lie').write_bytes(head.ljust(mapped.PAGE, b'\0') + whole[mapped.PAGE :])
        if lie in ({'crc': -1}, {'crc': 2**70}):  # is looked at by who reads all
            with pytest.raises(ValueError, match='CRC-32'):
                DynamicBVH.load(tmp_path / 'lie')
            continue
        assert is_refused_both_ways(tmp_path / 'lie'), lie


def test_an_npz_is_not_mapped(tmp_path):
    lived_in(3, 0.0).save(tmp_path / 'tree.npz')
    with pytest.raises(ValueError, match='mapped=True'):
        DynamicBVH.load(tmp_path / 'tree.npz', mmap=True)
    with pytest.raises(ValueError, match='mmap'):
        DynamicBVH.load(tmp_path / 'tree.npz', mmap=2)


def test_a_pickle_hands_its_arrays_over_out_of_band():
    tree = lived_in(3, 0.2)
    buffers: list[pickle.PickleBuffer] = []
    small = pickle.dumps(tree, protocol=5, buffer_callback=buffers.append)
    assert len(small) < 4096 < sum(len(buffer.raw()) for buffer in buffers)
    assert snapshot(pickle.loads(small, buffers=buffers)) == snapshot(tree)


DAMAGE = """
import collections, sys
import numpy as np
from pathlib import Path
from odd_files import damaged, outcome
from bvh_ros import DynamicBVH
from tree.store.test_mapped import answers

rng, counts = np.random.default_rng(int(sys.argv[2])), collections.Counter()
path, mmap = Path(sys.argv[1]), sys.argv[4] == 'mapped'
wanted = answers(DynamicBVH.load(path, mmap=mmap))
for content in damaged(rng, path.read_bytes(), int(sys.argv[3])):
    bad = path.with_name('bad')
    bad.unlink(missing_ok=True)
    bad.write_bytes(content)
    for verify in (False, True):
        ask = lambda: answers(DynamicBVH.load(bad, mmap=mmap, verify=verify))
        counts[f'{verify} {outcome(ask, wanted)}'] += 1
print(dict(counts))
"""


@pytest.mark.parametrize(
    ('ndim', 'margin', 'kind'), [(2, 0.0, 'mapped'), (3, 0.2, 'mapped'), (2, 0.0, 'npz')]
)
def test_no_damaged_file_ends_the_process(tmp_path, ndim, margin, kind):
    """Refused, or some answer; refused, or the right answer, where all is verified, or read."""
    lived_in(ndim, margin, 40).save(tmp_path / 'tree', mapped=kind == 'mapped')
    ended = run_alone(DAMAGE, str(tmp_path / 'tree'), str(ndim), str(DAMAGES), kind)
    counts = ast.literal_eval(ended.stdout)
    unverified = {'False other'} if kind == 'mapped' else set()
    assert {*counts} - unverified == {
        f'{verify} {how}' for verify in (True, False) for how in ('refused', 'same')
    }, counts
