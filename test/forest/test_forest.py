# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every answer of a forest is, bit for bit, that of one tree of all boxes."""

import ast
import json
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from odd_files import WITH_TESTS

from bvh_ros import DynamicBVH
from bvh_ros.forest import Forest, building, queries
from bvh_ros.tree.access import OpenTree

COUNT, ASKED = 3000, 1500


def lattice(rng: np.random.Generator, ndim: int) -> tuple[Any, Any]:
    """Boxes that touch, lie in each other and are met at the same distance."""
    lo = rng.integers(0, 30, (COUNT, ndim)).astype(float)
    return lo, lo + rng.integers(0, 3, (COUNT, ndim))


def far(rng: np.random.Generator, ndim: int) -> tuple[Any, Any]:
    lo, hi = lattice(rng, ndim)
    lo[7], hi[7] = 1e20, 1e20
    return lo, hi


def decades(rng: np.random.Generator, ndim: int) -> tuple[Any, Any]:
    lo, hi = lattice(rng, ndim)
    scale = 10.0 ** rng.integers(-300, 300, (60, 1))
    lo[::50] *= scale
    hi[::50] *= scale
    return lo, hi


def one_place(rng: np.random.Generator, ndim: int) -> tuple[Any, Any]:
    lo, hi = lattice(rng, ndim)
    lo[: COUNT - 100], hi[: COUNT - 100] = 3.0, 4.0
    return lo, hi


def anywhere(rng: np.random.Generator, ndim: int) -> tuple[Any, Any]:
    lo = rng.uniform(0, 30, (COUNT, ndim))
    return lo, lo + rng.uniform(0, 2, (COUNT, ndim))


@pytest.fixture
def whole(tmp_path):
    """The folder of a forest of a lattice."""
    folder = tmp_path / 'forest'
    Forest.build(folder, [lattice(np.random.default_rng(0), 3)], 500)
    return folder


EVERYTHING = [[-1e9] * 3], [[1e9] * 3]


def copied(folder, name):
    """A copy of a forest beside it."""
    shutil.rmtree(folder.parent / name, ignore_errors=True)
    return Path(shutil.copytree(folder, folder.parent / name))


def planted(folder: Path, lo: Any, hi: Any, mask: Any, max_boxes: int) -> Forest:
    chunks = (
        (lo[i : i + 700], hi[i : i + 700], mask[i : i + 700]) for i in range(0, len(lo), 700)
    )
    return Forest.build(folder, chunks, max_boxes)


def ids_of(tree: DynamicBVH, handles: Any) -> Any:
    return np.where(handles < 0, -1, np.searchsorted(tree.ids(), handles))


def answers(world: Any, rng: np.random.Generator, at: Any, **how: Any) -> list[Any]:
    """Of a forest, or of a tree with ids for handles."""
    ndim = at.shape[1]
    named = (lambda x: ids_of(world, x)) if isinstance(world, DynamicBVH) else (lambda x: x)
    directions = rng.integers(-2, 3, at.shape).astype(float)
    directions[::2] = rng.normal(size=at[::2].shape)
    masks = rng.integers(0, 4, len(at)).astype(np.uint32)
    reach = rng.choice([0.0, 1.0, 7.0, np.inf], len(at))
    out = []
    for skip in (False, True):
        hits = world.raycast_many(at, directions, reach, masks, skip, **how)
        out += [named(hits.ids), hits.t, hits.normals]
        out.append(world.occluded_many(at, directions, reach, 3, skip, **how))
    offsets, ids = world.overlap_many(at, at + rng.integers(0, 4, ndim), masks, **how)
    out += [offsets, named(ids)]
    for k in (1, 6):
        ids, distances = world.nearest_many(at[:300], k, reach[:300], masks[:300], **how)
        out += [named(ids), distances]
    return out


@pytest.mark.parametrize('ndim', [pytest.param(2, marks=pytest.mark.slow), 3])
@pytest.mark.parametrize('scene', [lattice, far, decades, one_place, anywhere])
def test_a_forest_answers_as_one_tree(tmp_path, monkeypatch, ndim, scene):
    monkeypatch.setattr(queries, 'ROWS_AT_ONCE', 1000)
    monkeypatch.setattr(queries, 'ROWS_A_TASK', 90)
    monkeypatch.setattr(building, 'ROWS_AT_ONCE', 500)
    rng = np.random.default_rng(ndim)
    lo, hi = scene(rng, ndim)
    mask = rng.integers(0, 4, COUNT).astype(np.uint32)
    forest = planted(tmp_path / 'forest', lo, hi, mask, 200)
    tree = DynamicBVH.from_boxes(lo, hi, mask=mask)
    at = rng.integers(-2, 33, (ASKED, ndim)).astype(float)
    at[::3] += rng.uniform(0, 1, at[::3].shape)
    for one, its in zip(
        answers(forest, np.random.default_rng(1), at),
        answers(tree, np.random.default_rng(1), at),
        strict=True,
    ):
        np.testing.assert_array_equal(one, its)
    assert len(forest) == COUNT
    assert 15 <= forest.parts < 70
    assert all((one == its).all() for one, its in zip(forest.bounds, tree.bounds, strict=True))


def test_parts_hold_each_box_once_and_no_more_than_asked(tmp_path):
    rng = np.random.default_rng(3)
    lo, hi = anywhere(rng, 3)
    forest = planted(tmp_path / 'forest', lo, hi, np.ones(COUNT, np.uint32), 170)
    ids, volumes = [], []
    for number in range(forest.parts):
        tree = OpenTree.load(building.part_file(tmp_path / 'forest', number))
        tree.validate()
        its = np.load(building.ids_file(tmp_path / 'forest', number))[tree.slots(tree.ids())]
        assert len(tree) == len(its) <= 170
        assert (np.diff(its) > 0).all()
        np.testing.assert_array_equal(tree.boxes(tree.ids())[0], lo[its])
        ids.append(its)
        volumes.append(np.prod(tree.bounds[1] - tree.bounds[0]))
    assert sorted(np.concatenate(ids)) == list(range(COUNT))
    assert sum(volumes) < 4 * 32.0**3  # near boxes share a part
    assert {file.suffix for file in (tmp_path / 'forest').iterdir()} == {'.tree', '.npy', '.json'}


@pytest.mark.parametrize('ndim', [2, 3])
def test_the_curve_goes_from_neighbour_to_neighbour(ndim):
    side = 1 << building.CELL_BITS
    cells = np.stack(np.meshgrid(*(np.arange(side),) * ndim), -1).reshape(-1, ndim)
    numbers = building.cells(cells + 0.5, np.zeros(ndim), np.full(ndim, side))
    assert sorted(numbers) == list(range(side**ndim))
    steps = np.abs(np.diff(cells[np.argsort(numbers)], axis=0)).sum(axis=1)
    assert (steps == 1).all()


def test_small_forests(tmp_path):
    none = Forest.build(tmp_path / 'none', [(np.empty((0, 3)), np.empty((0, 3)))])
    one = Forest.build(tmp_path / 'one', [([[1, 1]], [[2, 2]])])
    assert (len(none), none.parts, none.bounds, len(one), one.ndim) == (0, 0, None, 1, 2)
    hits = none.raycast_many(np.zeros((2, 3)), np.ones((2, 3)))
    assert hits.ids.tolist() == [-1, -1]
    assert none.overlap_many(np.zeros((2, 3)), np.ones((2, 3)))[0].tolist() == [0, 0, 0]
    assert none.nearest_many(np.zeros((1, 3)))[0].tolist() == [[-1]]
    ids, distances = one.nearest_many([[1, 0]], 2)
    assert ids.tolist() == [[0, -1]]
    assert distances.tolist() == [[1.0, np.inf]]
    for empty in (one.raycast_many([], []), one.nearest_many(np.empty((0, 2)))):
        assert len(empty[0]) == 0
    assert one.overlap_many(np.empty((0, 2)), np.empty((0, 2)))[0].tolist() == [0]
    assert len(pickle.loads(pickle.dumps(one))) == 1


BAD_CHUNKS = [
    ([], 'chunks are none'),
    ([(np.zeros((2, 3)), np.ones((2, 2)))], 'chunk 0: hi'),
    ([([[0, 0]], [[1, 1]]), ([[0, 0, 0]], [[1, 1, 1]])], 'chunk 1: lo'),
    ([([[0, 0]], [[1, 1]]), ([[0, np.nan]], [[1, 1]])], 'chunk 1: lo'),
    ([([[0, 0]], [[1, 1]]), ([[2, 0]], [[1, 1]])], 'chunk 1: '),
    ([([[0, 0]], [[1, 1]], [1, 2])], 'chunk 0: mask'),
    ([np.zeros(4)], 'chunk 0: must be'),
    ([(0, 1)], 'chunk 0: lo'),
]


@pytest.mark.parametrize(('chunks', 'why'), BAD_CHUNKS)
def test_bad_chunks_leave_nothing_behind(tmp_path, chunks, why):
    with pytest.raises(ValueError, match=why):
        Forest.build(tmp_path / 'forest', chunks)
    assert not list(tmp_path.iterdir())


def test_bad_arguments(tmp_path, whole):
    lo, hi = lattice(np.random.default_rng(0), 3)
    for many in (0, -1, 1.5, 'x', 2**40):
        with pytest.raises(ValueError, match='max_boxes'):
            Forest.build(tmp_path / 'none', [(lo, hi)], many)
    forest = Forest.open(whole)
    with pytest.raises(FileExistsError):
        Forest.build(whole, [(lo, hi)])
    with pytest.raises(ValueError, match='row 1'):
        forest.raycast_many([[0, 0, 0], [0, np.nan, 0]], np.ones((2, 3)))
    with pytest.raises(ValueError, match='threads'):
        forest.overlap_many(lo, hi, threads=0)
    with pytest.raises(ValueError, match='k '):
        forest.nearest_many(lo, 0)
    with pytest.raises(ValueError, match='t_max'):
        forest.occluded_many(lo, lo, t_max=-1)


def test_a_folder_that_is_no_forest_is_refused(tmp_path, whole):
    with pytest.raises(FileNotFoundError):
        Forest.open(tmp_path / 'nowhere')
    header = json.loads((whole / building.HEADER).read_text())
    wrong = [header | {key: 'y'} for key in ('version', 'parts', 'top')]
    texts = ['', '[]', 'x', '{}', *map(json.dumps, wrong)]
    for text in texts:
        other = copied(whole, 'other')
        (other / building.HEADER).write_text(text)
        with pytest.raises(ValueError, match='no forest'):
            Forest.open(other)
    torn, short = copied(whole, 'torn'), copied(whole, 'short')
    building.ids_file(torn, 0).write_bytes(building.ids_file(whole, 0).read_bytes()[:-8])
    with pytest.raises(ValueError):  # whatever is asked: never an answer without that part
        Forest.open(torn).overlap_many(*EVERYTHING)
    building.part_file(short, 1).unlink()
    with pytest.raises(FileNotFoundError):
        Forest.open(short).overlap_many(*EVERYTHING)


def test_files_of_two_forests_do_not_go_together(tmp_path, whole):
    """Nor those of two parts: whoever copies half of a folder gets no wrong answer."""
    lo, hi = lattice(np.random.default_rng(0), 3)
    Forest.build(tmp_path / 'other', [(lo + 1, hi + 1)], 500)
    files = [building.part_file(whole, 0), building.ids_file(whole, 0), whole / building.TOP]
    others = [
        *(tmp_path / 'other' / file.name for file in files),
        building.part_file(whole, 1),
        building.ids_file(whole, 1),
    ]
    for other in others:
        mixed = copied(whole, 'mixed')
        shutil.copy(other, mixed / other.name.replace('000001', '000000'))
        with pytest.raises(ValueError, match='of another'):
            Forest.open(mixed).overlap_many(*EVERYTHING)
    before = Forest.open(copied(whole, 'mixed'))
    pickled = pickle.dumps(before)
    shutil.rmtree(mixed)
    os.rename(tmp_path / 'other', mixed)
    for ask in (lambda: before.overlap_many(*EVERYTHING), lambda: pickle.loads(pickled)):
        with pytest.raises(ValueError, match='another forest'):
            ask()


def test_who_builds_where_another_builds_loses_and_leaves_nothing(tmp_path):
    lo, hi = lattice(np.random.default_rng(0), 3)

    def chunks():
        yield lo, hi
        Forest.build(tmp_path / 'forest', [(lo[:7], hi[:7])])

    with pytest.raises(FileExistsError):
        Forest.build(tmp_path / 'forest', chunks())
    assert len(Forest.open(tmp_path / 'forest')) == 7
    (tmp_path / 'link').symlink_to(tmp_path / 'nowhere')
    with pytest.raises(FileExistsError):  # now, not when all is built
        Forest.build(tmp_path / 'link', iter(()))
    assert {file.name for file in tmp_path.iterdir()} == {'forest', 'link'}


def test_a_full_disk_says_so_and_leaves_nothing(tmp_path):
    program = f"""
import resource, signal, numpy as np
from bvh_ros.forest import Forest
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
lo = np.zeros((9000, 3))
Forest.build({str(tmp_path / 'forest')!r}, [(lo, lo)], 500)
"""
    ended = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True)
    assert ended.stderr.splitlines()[-1].startswith('OSError: [Errno 27] File too large')
    assert not list(tmp_path.iterdir())


DAMAGE = """
import collections, sys
import numpy as np
from pathlib import Path
from odd_files import damaged, outcome
from bvh_ros.forest import Forest

rng, counts = np.random.default_rng(0), collections.Counter()
folder = Path(sys.argv[1])
rays = rng.uniform(-9, 40, (2, 500, 3))


def answers(**how):
    forest = Forest.open(folder, **how)
    near = forest.nearest_many(rays[0][:50], 2)
    return [*forest.raycast_many(*rays), *forest.overlap_many(rays[0], rays[0] + 9), *near]


wanted = answers()
for file in sorted(folder.iterdir()):
    whole = file.read_bytes()
    for content in damaged(rng, whole, int(sys.argv[2])):
        file.unlink()
        file.write_bytes(content)
        for verify in (False, True):
            counts[f'{verify} {outcome(lambda: answers(verify=verify), wanted)}'] += 1
    file.unlink()
    file.write_bytes(whole)
print(dict(counts))
"""


def test_no_damaged_file_ends_the_process(tmp_path):
    """Refused, or some answer; refused, or the right answer, where all is verified."""
    lo, hi = anywhere(np.random.default_rng(0), 3)
    Forest.build(tmp_path / 'forest', [(lo[:200], hi[:200])], 120)
    how = [sys.executable, '-c', DAMAGE, str(tmp_path / 'forest'), '60']
    run = subprocess.run(how, capture_output=True, text=True, timeout=3000, env=WITH_TESTS)
    assert run.returncode == 0, run.stderr
    counts = ast.literal_eval(run.stdout)
    wrong = {*counts} - {'True same', 'True refused'}
    assert wrong <= {'False same', 'False refused', 'False other'}, counts


def test_ids_in_another_order_are_found(whole):
    """Each is given once, but to another box."""
    file = next(whole.glob('part-*.ids.npy'))
    ids = np.load(file)
    ids[[3, 7]] = ids[[7, 3]]
    np.save(file, ids)
    with pytest.raises(ValueError, match='is of another forest or part'):
        Forest.open(whole, verify=True)
