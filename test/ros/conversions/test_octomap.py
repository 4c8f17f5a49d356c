# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Octrees are read as OctoMap writes them: checked with a writer that recurses, as OctoMap's does,
and nothing is read beyond the data.
"""

import itertools
import math
import random
import struct

import numpy as np
import pytest

from bvh_ros.ros.conversions.octomap import Octree, boxes, exercise, walk

FREE, OCCUPIED = 'free', 'occupied'
CUBES = [*itertools.product((0, 1), repeat=3)]
ODDS = {FREE: -2.0, OCCUPIED: 3.5}


def random_tree(rng, depth, most=16):
    """A leaf, or the children of an inner node by number."""
    if depth == most or (depth and rng.random() < 0.4):
        return rng.choice((FREE, OCCUPIED))
    share = 0.5 if depth < 2 else 0.7  # else there is no end
    some = [k for k in range(8) if rng.random() > share] or [rng.randrange(8)]
    return {k: random_tree(rng, depth + 1, most) for k in some}


def binary(node):
    """As OccupancyOcTreeBase::writeBinaryNode."""
    bits = 0
    for number, child in node.items():
        bits |= {FREE: 1, OCCUPIED: 2}.get(
            child if isinstance(child, str) else '', 3
        ) << 2 * number
    inner = [child for _, child in sorted(node.items()) if not isinstance(child, str)]
    return struct.pack('<H', bits) + b''.join(map(binary, inner))


def full(node, colour=b''):
    """As OcTreeBaseImpl::writeNodesRecurs."""
    leaf = isinstance(node, str)
    mask = 0 if leaf else sum(1 << number for number in node)
    record = struct.pack('<f', ODDS[node] if leaf else math.nan) + colour + bytes([mask])
    children = [] if leaf else [child for _, child in sorted(node.items())]
    return record + b''.join(full(child, colour) for child in children)


def cubes_of(node, corner=(-32768,) * 3, edge=65536):
    """Lowest corner and edge of each occupied leaf, in smallest cubes."""
    if isinstance(node, str):
        return {(*corner, edge)} if node == OCCUPIED else set()
    half, found = edge // 2, set()
    for number, child in node.items():
        z, y, x = CUBES[number]  # the number is 4 z + 2 y + x
        place = tuple(c + half * bit for c, bit in zip(corner, (x, y, z), strict=True))
        found |= cubes_of(child, place, half)
    return found


def read(data, *, kind='OcTree', resolution=0.25, occupied_at=0.5, most=10**6, **given):
    tree = Octree(kind, given.get('binary', False), resolution, np.frombuffer(data, np.uint8))
    reading = boxes(tree, occupied_at=occupied_at, most=most)
    while True:
        try:
            next(reading)
        except StopIteration as end:
            return end.value


def found_in(shapes, resolution=0.25):
    """The same as `cubes_of`."""
    edge = shapes.size[:, 0] / resolution
    assert (shapes.size == shapes.size[:, :1]).all()
    corner = shapes.position / resolution - 0.5 * edge[:, None]
    rows = np.column_stack((corner, edge))
    assert (rows == np.round(rows)).all()
    found = {tuple(row) for row in rows.astype(int).tolist()}
    assert len(found) == len(rows)
    return found


@pytest.mark.parametrize('seed', range(40))
def test_what_octomap_writes_is_read(seed):
    rng = random.Random(seed)
    tree = random_tree(rng, 0)
    expected = cubes_of(tree)
    assert found_in(read(binary(tree), binary=True)) == expected
    assert found_in(read(full(tree))) == expected
    assert found_in(read(full(tree), kind='OcTreeStamped')) == expected
    assert found_in(read(full(tree, b'rgb'), kind='ColorOcTree')) == expected


def test_the_smallest_and_the_largest_leaf():
    deepest = OCCUPIED
    for _ in range(16):
        deepest = {7: deepest}
    for data, given in ((full(deepest), False), (binary(deepest), True)):
        assert found_in(read(data, binary=given)) == {(32767, 32767, 32767, 1)}
    assert found_in(read(full(OCCUPIED))) == {(-32768, -32768, -32768, 65536)}
    assert found_in(read(full(FREE))) == found_in(read(b'')) == set()
    assert found_in(read(b'', binary=True)) == found_in(read(b'\0\0', binary=True)) == set()


def test_many_leaves_are_read_in_the_helper_thread():
    tree = {k: {j: {i: {7: OCCUPIED} for i in range(8)} for j in range(8)} for k in range(8)}
    tree = {k: dict.fromkeys(range(8), tree) for k in range(8)}
    assert found_in(read(binary(tree), binary=True)) == cubes_of(tree)
    assert len(binary(tree)) > 50_000


def test_how_likely_an_occupied_leaf_is():
    likely = struct.pack('<fB', math.log(0.7 / 0.3), 0)
    assert len(read(likely, occupied_at=0.69).kind) == 1
    assert len(read(likely, occupied_at=0.71).kind) == 0
    assert len(read(struct.pack('<fB', 0.0, 0)).kind) == 1  # as OctoMap has it: at least
    assert len(read(full(FREE), occupied_at=0.0).kind) == 1
    assert len(read(full(OCCUPIED), occupied_at=1.0).kind) == 0


DEEP = {0: OCCUPIED}
for _ in range(16):
    DEEP = {0: DEEP}
NAN = struct.pack('<fB', math.nan, 0)
TREE = {0: OCCUPIED, 5: {2: OCCUPIED, 3: FREE}, 7: {1: OCCUPIED}}


@pytest.mark.parametrize(
    ('data', 'given', 'reason'),
    [
        (binary(TREE)[:-2], {'binary': True}, 'beyond the end'),
        (binary(TREE)[:-1], {'binary': True}, 'no records of 2'),
        (binary(TREE) + b'\0\0', {'binary': True}, 'ends after 3 of 4 nodes'),
        (binary(DEEP), {'binary': True}, 'more than 16 levels'),
        (full(DEEP), {}, 'more than 16 levels'),
        (full(TREE)[:-5], {}, 'beyond the end'),
        (full(TREE)[:-1], {}, 'no records of 5'),
        (full(TREE) * 2, {}, 'ends after'),
        (full(TREE), {'kind': 'ColorOcTree'}, 'no records of 8|ends after|beyond'),
        (full(TREE), {'kind': 'SemanticOcTree'}, "not 'SemanticOcTree'"),
        (NAN, {}, 'NaN'),
        (full(TREE), {'most': 2}, 'has 3 occupied leaves, more than 2'),
        (full(TREE), {'resolution': 0.0}, 'resolution 0.0'),
        (full(TREE), {'resolution': math.inf}, 'resolution inf'),
        (full(TREE), {'resolution': math.nan}, 'resolution nan'),
    ],
)
def test_what_is_no_octree_is_refused_with_the_reason(data, given, reason):
    with pytest.raises(ValueError, match=reason):
        read(data, **given)


def test_whatever_the_data_are_nothing_is_read_beyond_them():
    """Where an index is beyond an array, the process ends, or NUMBA_BOUNDSCHECK says so."""
    rng, refused = random.Random(7), 0
    for _ in range(3000):
        tree = random_tree(rng, 0, 5)
        is_binary = rng.random() < 0.5
        data = bytearray(binary(tree) if is_binary else full(tree))
        for _ in range(rng.randrange(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        try:
            shapes = read(bytes(data[: rng.randrange(len(data) + 1)]), binary=is_binary)
        except ValueError:
            refused += 1
        else:
            assert (np.abs(shapes.position) + 0.5 * shapes.size <= 32768 * 0.25).all()
    assert refused > 100


def test_the_kernel_is_compiled_once():
    """What a node compiles at its start is what every map needs."""
    exercise()
    for data, is_binary in ((full(TREE), False), (binary(TREE), True)):
        assert len(read(data, binary=is_binary).kind) == 3
    assert len(walk.signatures) == 1
