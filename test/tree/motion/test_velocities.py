# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Velocities stay with their boxes, whatever becomes of the tree."""

import copy
import pickle
import re
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bvh_ros import DynamicBVH
from bvh_ros.tree.access import OpenTree

OFF = """
import sys
from bvh_ros import DynamicBVH
tree = DynamicBVH.from_boxes([[0, 0], [3, 3]], [[1, 1], [4, 4]])
tree.raycast([-1, 0.5], [1, 0], at=3.0, pace=1.0), tree.raycast_many([[0, 0]], [[1, 0]])
tree.overlap([0, 0], [1, 1]), tree.nearest([0, 0]), tree.boxcast([0, 0], [1, 1], [1, 0])
assert tree.stats()['motion_bytes'] == 0
assert not [name for name in sys.modules if name.startswith('bvh_ros.tree.motion')]
tree.set_velocities(tree.ids(), [[1, 0], [0, 1]])
assert 'bvh_ros.tree.motion.entries' in sys.modules
"""


def moving_tree(count: int = 9) -> DynamicBVH:
    lo = np.column_stack((10.0 * np.arange(count), np.zeros(count)))
    tree = DynamicBVH.from_boxes(lo, lo + 1)
    tree.set_velocities(tree.ids(), np.column_stack((np.arange(count), np.zeros(count))), 2.0)
    return tree


def test_a_tree_without_velocities_imports_nothing_of_it():
    subprocess.run([sys.executable, '-c', OFF], check=True)


def test_what_is_refused_changes_nothing():
    tree = moving_tree()
    ids, one = tree.ids(), [[1.0, 2.0]]
    for handles, velocities, reference, error in (
        ([ids[0], 12345], [[0, 0]] * 2, 0.0, KeyError),
        ([ids[0], ids[0]], [[0, 0]] * 2, 0.0, ValueError),
        (ids[:1], [[np.nan, 0]], 0.0, ValueError),
        (ids[:1], [[1.0, 2.0, 3.0]], 0.0, ValueError),
        (ids[:1], one, np.inf, ValueError),
        (ids[:1], one, [1.0, 2.0], ValueError),
    ):
        with pytest.raises(error):
            tree.set_velocities(handles, velocities, reference)
    assert tree.velocities(ids)[0][:, 0].tolist() == list(range(9))
    for still in (tree, DynamicBVH(ndim=2)):
        for times in ({'at': np.nan}, {'pace': np.inf}, {'at': [1.0, 2.0]}, {'pace': 'x'}):
            with pytest.raises(ValueError, match=r'at|pace'):
                still.raycast([0, 0], [1, 0], **times)
            with pytest.raises(ValueError, match=r'at|pace'):
                still.raycast_many([[0, 0]] * 3, [[1, 0]] * 3, **times)


@pytest.mark.parametrize('count', [0, 1, 3, 100])
def test_times_of_boxes_and_points_are_refused_however_many_rows_there_are(count: int):
    """Kernels look at times, and see none where there is no row."""
    tree, lo = moving_tree(), np.zeros((count, 2))
    late = np.zeros(count)
    late[-1:] = np.nan
    cases: list[tuple[Any, str]] = [
        (np.nan, 'at must be finite, not nan'),
        (-np.inf, 'at must be finite, not -inf'),
        (np.zeros(count + 2), f'at must be a number or have shape ({count},), not ({count + 2},)'),
        ('x', 'at must be real numbers: they are of type <U1'),
    ]
    if count:
        row = f'row {count - 1} is nan'
        cases += [
            (late, f'at must be finite: {row}'),
            (late.tolist(), f'at must be finite: {row}'),
        ]
    for at, message in cases:
        with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
            tree.nearest_many(lo, at=at)
        with pytest.raises(ValueError, match=f'^{re.escape(message)}$'):
            tree.overlap_many(lo, lo + 1.0, at=at)
    if count:
        lo[-1, 0] = np.nan
        with pytest.raises(ValueError, match=f'^points must be finite: row {count - 1} is '):
            tree.nearest_many(lo, at=1.0)
        with pytest.raises(ValueError, match=f'^lo must be finite: row {count - 1} is '):
            tree.overlap_many(lo, lo, at=1.0)


def test_kept_in_files(tmp_path: Path):
    tree = moving_tree()
    gone, ids = tree.ids()[0], tree.ids()[1:]
    tree.remove(gone)
    tree.save(tmp_path / 'tree.npz')
    others = DynamicBVH.load(tmp_path / 'tree.npz'), pickle.loads(pickle.dumps(tree))
    for other in (*others, copy.deepcopy(tree)):
        assert [x.tolist() for x in other.velocities(ids)] == [
            x.tolist() for x in tree.velocities(ids)
        ]
        assert other.raycast([25, 0.5], [1, 0], at=4.0) is not None
    with pytest.raises(ValueError, match='velocities cannot be saved to be mapped'):
        tree.save(tmp_path / 'mapped', mapped=True)
    DynamicBVH(ndim=2).save(tmp_path / 'mapped', mapped=True)
    mapped = DynamicBVH.load(tmp_path / 'mapped', mmap=True)
    with pytest.raises(ValueError, match='read-only'):
        mapped.set_velocities([], np.empty((0, 2)))
    with np.load(tmp_path / 'tree.npz') as file:
        sound = dict(file)
    for damage in (
        {'moving': np.array([5] * 8)},
        {'moving': np.array([ids[0]] * 8)},
        {'moving': np.arange(5000)},
        {'velocities': np.full((8, 2), np.nan)},
        {'velocities': np.zeros((8, 3))},
        {'references': np.zeros(7)},
        {'version': np.array(3)},
    ):
        np.savez_compressed(tmp_path / 'damaged.npz', **(sound | damage))
        with pytest.raises(ValueError, match=r'no saved tree|not sound|velocities'):
            DynamicBVH.load(tmp_path / 'damaged.npz')


def test_whole_nanoseconds_and_how_long_boxes_go_on_are_kept(tmp_path: Path):
    tree = OpenTree(ndim=2)
    box = tree.insert([0, 0], [1, 1])
    tree.count_nanoseconds(0.3)
    tree.set_velocities([box], [[10, 0]], reference=0.1)
    tree.save(tmp_path / 'tree.npz')
    others = DynamicBVH.load(tmp_path / 'tree.npz'), pickle.loads(pickle.dumps(tree))
    for other in (tree, *others, copy.deepcopy(tree), copy.deepcopy(others[0])):
        for x, at, met in (
            (3, 0.3, True),
            (2, 0.3, True),
            (4, 0.4, True),
            (4, 99.0, True),
            (5, 99.0, False),
        ):
            assert other.occluded([x, 9], [0, -1], at=at) == met
    with np.load(tmp_path / 'tree.npz') as file:
        sound = dict(file)
    for left in (np.array(-1.0), np.array(np.nan), np.zeros(2), np.array('x'), np.zeros(5000)):
        np.savez_compressed(tmp_path / 'damaged.npz', **(sound | {'left': left}))
        with pytest.raises(ValueError, match=r'no saved tree|not sound'):
            DynamicBVH.load(tmp_path / 'damaged.npz')


def test_who_asks_while_velocities_change_is_right_or_refused():
    tree = moving_tree(500)
    ids, speeds = tree.ids(), np.zeros((500, 2))
    wrong, stop = [], threading.Event()

    def ask() -> None:
        while not stop.is_set():
            try:
                found = tree.overlap([-1, 0], [6000, 1], at=3.0)
            except RuntimeError:
                continue
            if found.tolist() != ids.tolist():
                wrong.append(found)

    threads = [threading.Thread(target=ask) for _ in range(3)]
    for thread in threads:
        thread.start()
    done = 0
    while done < 200:
        speeds[:, 0] = done % 7
        try:
            tree.set_velocities(ids, speeds, 3.0 - done % 3)
            done += 1
        except RuntimeError:
            pass
    stop.set()
    for thread in threads:
        thread.join()
    assert not wrong
