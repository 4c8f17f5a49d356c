# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files and pickles: the same tree comes back and goes on living; what is no tree is refused."""

import copy
import os
import pickle
import resource
import signal
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tree.reference import snapshot

from bvh_ros import DynamicBVH


def lived_in(ndim: int, margin: float, search: str) -> DynamicBVH:
    """A tree with removed, moved and masked boxes."""
    rng = np.random.default_rng(ndim)
    lo = rng.uniform(0, 50, (200, ndim))
    tree = DynamicBVH(ndim, margin=margin, sibling_search=search)
    handles = tree.insert_many(lo, lo + 1, rng.integers(0, 2**32, 200, dtype=np.uint32))
    tree.remove_many(handles[::5])
    for handle in handles[1::5]:
        tree.move(handle, np.zeros(ndim), np.ones(ndim), np.ones(ndim))
    return tree


def through_file(tree: DynamicBVH, folder: Path) -> DynamicBVH:
    tree.save(folder / 'tree.npz')
    return DynamicBVH.load(folder / 'tree.npz')


WAYS: dict[str, Callable[[DynamicBVH, Path], DynamicBVH]] = {
    'file': through_file,
    'file, name as text': lambda tree, folder: (
        tree.save(f'{folder}/t'),
        DynamicBVH.load(f'{folder}/t'),
    )[1],
    'pickle': lambda tree, folder: pickle.loads(pickle.dumps(tree)),
    'pickle, protocol 2': lambda tree, folder: pickle.loads(pickle.dumps(tree, 2)),
    'deep copy': lambda tree, folder: copy.deepcopy(tree),
    'copy': lambda tree, folder: copy.copy(tree),
    'twice': lambda tree, folder: through_file(through_file(tree, folder), folder),
}


@pytest.mark.parametrize('way', WAYS.values(), ids=WAYS.keys())
@pytest.mark.parametrize('ndim', [2, 3])
@pytest.mark.parametrize(('margin', 'search'), [(0.0, 'greedy'), (0.25, 'branch_and_bound')])
def test_the_same_tree_comes_back(
    way: Callable[[DynamicBVH, Path], DynamicBVH],
    ndim: int,
    margin: float,
    search: str,
    tmp_path: Path,
) -> None:
    tree = lived_in(ndim, margin, search)
    tree.raycast_many(np.zeros((200, ndim)), np.ones((200, ndim)))
    back = way(tree, tmp_path)
    back.validate()
    assert snapshot(back) == snapshot(tree)
    kept = (
        'boxes',
        'ndim',
        'height',
        'cost',
        'margin',
        'sibling_search',
        'inserted',
        'removed',
        'reinserted',
    )
    assert [back.stats()[name] for name in kept] == [tree.stats()[name] for name in kept]
    # Both live on alike, and apart.
    zero, one = np.zeros(ndim), np.ones(ndim)
    assert back.insert(zero, one) == tree.insert(zero, one)
    back.remove(back.ids()[3])
    tree.validate()
    assert len(tree) == len(back) + 1
    back.insert_many(np.zeros((500, ndim)), np.ones((500, ndim)))
    back.validate()
    tree.validate()


@pytest.mark.parametrize('ndim', [2, 3])
def test_an_empty_tree_comes_back(ndim: int, tmp_path: Path) -> None:
    for tree in (DynamicBVH(ndim), DynamicBVH(ndim, margin=1.0)):
        back = through_file(tree, tmp_path)
        assert (len(back), back.ndim, back.margin) == (0, ndim, tree.margin)
        assert back.insert(np.zeros(ndim), np.zeros(ndim)) == tree.insert(
            np.zeros(ndim), np.zeros(ndim)
        )


# ---- what is refused


def without(name: str) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda fields: {key: value for key, value in fields.items() if key != name}


def with_value(
    name: str, value: Callable[[Any], Any]
) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda fields: {**fields, name: value(fields[name])}


def broken(array: Any, place: Any, value: Any) -> Any:
    array = array.copy()
    array[place] = value
    return array


def far_links(nodes: Any) -> Any:
    nodes = nodes.copy()
    nodes['left'] = nodes['right'] = nodes['parent'] = 2**31 - 1
    return nodes


FIELDS = {
    'of a later version': with_value('version', lambda v: v + 1),
    'without a version': without('version'),
    'without nodes': without('nodes'),
    'without handles': without('handles'),
    'without a margin': without('margin'),
    'with fewer nodes': with_value('nodes', lambda a: a[:-10]),
    'with fewer heights': with_value('heights', lambda a: a[:-10]),
    'with fewer handles': with_value('handles', lambda a: a[:-10]),
    'with other handles': with_value('handles', lambda a: a[::-1]),
    'with a short state': with_value('state', lambda a: a[:2]),
    'with a negative root': with_value('state', lambda a: broken(a, 0, -9)),
    'with a root outside': with_value('state', lambda a: broken(a, 0, 10**9)),
    'with a root far below': with_value('state', lambda a: broken(a, 0, -(10**9))),
    'with a free place outside': with_value('state', lambda a: broken(a, 2, 10**9)),
    'with a link outside': with_value('nodes', lambda a: broken(a, slice(None), far_links(a))),
    'with nodes of plain numbers': with_value('nodes', lambda a: np.zeros((len(a), 8))),
    'with another ndim': with_value('ndim', lambda v: 2),
    'with ndim 7': with_value('ndim', lambda v: 7),
    'with a NaN margin': with_value('margin', lambda v: np.nan),
    'with an unknown search': with_value('sibling_search', lambda v: 'best'),
    'with a serial number that was given': with_value('serial', lambda v: 1),
}


@pytest.mark.parametrize('change', FIELDS.values(), ids=FIELDS.keys())
@pytest.mark.parametrize('margin', [0.0, 0.5])
def test_a_file_that_makes_no_tree(
    change: Callable[[dict[str, Any]], dict[str, Any]], margin: float, tmp_path: Path
) -> None:
    path = tmp_path / 'tree.npz'
    lived_in(3, margin, 'greedy').save(path)
    with np.load(path) as file:
        fields = {name: file[name] for name in file.files}
    np.savez(path, **change(fields))
    with pytest.raises(ValueError):
        DynamicBVH.load(path)


NOT_FILES: dict[str, Callable[[bytes], bytes]] = {
    'empty': lambda data: b'',
    'text': lambda data: b'this is no tree\n' * 10,
    'a pickle': lambda data: pickle.dumps({'version': 1}),
    'cut short': lambda data: data[: len(data) // 2],
    'cut by one byte': lambda data: data[:-1],
    'without its beginning': lambda data: data[100:],
    'twice its middle': lambda data: data[: len(data) // 2] + data[len(data) // 3 :],
}


@pytest.mark.parametrize('change', NOT_FILES.values(), ids=NOT_FILES.keys())
def test_no_such_file(change: Callable[[bytes], bytes], tmp_path: Path) -> None:
    path = tmp_path / 'tree.npz'
    lived_in(3, 0.0, 'greedy').save(path)
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(ValueError, match=r'tree\.npz'):
        DynamicBVH.load(path)


def test_other_arrays_and_no_file_at_all(tmp_path: Path) -> None:
    np.savez(tmp_path / 'other.npz', a=np.zeros(3))
    with pytest.raises(ValueError, match='no saved tree'):
        DynamicBVH.load(tmp_path / 'other.npz')
    np.save(tmp_path / 'array.npy', np.zeros(3))
    with pytest.raises(ValueError, match=r'array\.npy'):
        DynamicBVH.load(tmp_path / 'array.npy')
    np.savez(tmp_path / 'objects.npz', version=np.array([{}], object))
    with pytest.raises(ValueError, match=r'objects\.npz'):
        DynamicBVH.load(tmp_path / 'objects.npz')
    with pytest.raises(FileNotFoundError):
        DynamicBVH.load(tmp_path / 'none.npz')
    with pytest.raises(OSError, match='none'):
        DynamicBVH(2).save(tmp_path / 'none' / 'tree.npz')


def grid(side: int) -> DynamicBVH:
    places = np.stack(np.meshgrid(*[np.arange(side)] * 3), -1).reshape(-1, 3) * 1.37
    return DynamicBVH.from_boxes(places, places + 1)


@pytest.mark.parametrize('mapped', [False, True])
def test_several_who_save_at_once_leave_one_of_their_trees(tmp_path: Path, mapped: bool) -> None:
    trees, path, sizes = [grid(3), grid(12)], tmp_path / 'tree', (27, 1728)
    trees[0].save(path, mapped)
    ended = threading.Event()

    def look() -> int:
        looks = 0
        while not ended.is_set() or not looks:
            assert len(DynamicBVH.load(path)) in sizes
            looks += 1
        return looks

    def save(tree: DynamicBVH) -> None:
        for _ in range(12):
            tree.save(path, mapped)

    with ThreadPoolExecutor() as pool:
        reader = pool.submit(look)
        writers = [pool.submit(save, tree) for tree in trees * 2]
        try:
            for writer in writers:
                writer.result()
        finally:
            ended.set()
        assert reader.result()
    assert [file.name for file in tmp_path.iterdir()] == ['tree']


@pytest.mark.parametrize('mapped', [False, True])
def test_who_cannot_save_leaves_the_older_file(tmp_path: Path, mapped: bool) -> None:
    path = tmp_path / 'tree'
    grid(3).save(path, mapped)
    limits, at_limit = resource.getrlimit(resource.RLIMIT_FSIZE), signal.SIGXFSZ
    before = signal.signal(at_limit, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
        with pytest.raises(OSError, match='File too large'):
            grid(12).save(path, mapped)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(at_limit, before)
    assert len(DynamicBVH.load(path)) == 27
    assert [file.name for file in tmp_path.iterdir()] == ['tree']


def test_links_are_followed_and_pipes_written_to(tmp_path: Path) -> None:
    (tmp_path / 'link').symlink_to(tmp_path / 'tree')
    grid(3).save(tmp_path / 'link')
    assert (tmp_path / 'link').is_symlink()
    assert len(DynamicBVH.load(tmp_path / 'tree')) == 27
    os.mkfifo(tmp_path / 'pipe')
    with ThreadPoolExecutor() as pool:
        data = pool.submit((tmp_path / 'pipe').read_bytes)
        grid(3).save(tmp_path / 'pipe')
    (tmp_path / 'copy').write_bytes(data.result())
    assert len(DynamicBVH.load(tmp_path / 'copy')) == 27
    with pytest.raises(IsADirectoryError):
        grid(3).save(tmp_path)
