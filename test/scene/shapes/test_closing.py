# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What closes a mesh that is not convex: nothing that was given is lost by it."""

import warnings
from fractions import Fraction

import numpy as np
import pytest
from scene.meshes import CUBE, SOLIDS, SURFACES, TETRAHEDRON, segments, single
from scene.reference import scene_of

from bvh_ros.scene import Mesh, Shapes

HALF_NOISE = 2.0**-23  # of a mesh's size, or where it is float32, of how far it lies
SHEET = np.array([[(0, 0, 0), (1, 0, 0), (1, 1, 0)], [(0, 0, 0), (1, 1, 0), (0, 1, 0)]]) * 1.0
SPECK = np.eye(3)[None]
RING = SOLIDS['ring'] / 30.0


def parted(triangles, rng):
    """As exporters write them: each corner of each triangle rounded on its own, up or down."""
    near = np.float32(triangles)
    other = np.nextafter(near, np.where(near < triangles, np.inf, -np.inf).astype(np.float32))
    return np.where(rng.random(triangles.shape) < 0.5, near, other).astype(float)


def at(place, triangles):
    return triangles + np.array(place)


def farthest_away(triangles, mesh):
    """How far corners and middles of triangles are from a mesh, at most; 0 in it."""
    scene = scene_of(Shapes.of_meshes(mesh, [0, 0, 0]))
    places = np.concatenate((triangles.reshape(-1, 3), triangles.mean(axis=1)))
    return scene.nearest_many(places).distances.max()


def has_area(triangle):
    a, b, c = ([Fraction(x) for x in corner] for corner in triangle.tolist())
    p, q = ([x - y for x, y in zip(other, a, strict=True)] for other in (b, c))
    return any(p[i] * q[i - 1] != p[i - 1] * q[i] for i in range(3))


@pytest.mark.parametrize('seed', range(5))
def test_seams_that_rounding_parted_are_closed(seed):
    rng = np.random.default_rng(seed)
    triangles = parted(RING + rng.uniform(-1, 1, 3), rng)
    solid, shell = Mesh(triangles), Mesh(triangles, solid=False)
    assert (solid.convex, solid.closed, solid.dropped) == (False, True, 0)
    assert farthest_away(triangles, solid) <= 2.0 * HALF_NOISE * np.abs(triangles).max()
    assert not shell.closed
    assert np.array_equal(shell.vertices[shell.corners], triangles)


WITNESSES = {
    'a speck beside a solid': np.concatenate([TETRAHEDRON, at((2, 0, 0), 1e-8 * SPECK)]),
    'a speck beside parted seams': np.concatenate(
        [parted(RING, np.random.default_rng(1)), at((2, 0, 0), 1e-8 * SPECK)]
    ),
    'a fine open box far away': single(
        at((16000, 0, 0), np.concatenate([CUBE, at((2, 0, 0), 0.001 * CUBE[2:])]))
    ),
    'two sheets as near as rounding': np.concatenate([SHEET, at((0, 0, 1e-7), SHEET)]),
    'two sheets, other diagonals': np.concatenate(
        [SHEET, at((0, 0, 1e-7), SHEET[:, :, [1, 0, 2]])]
    ),
    'two sheets far away': np.concatenate([10 * SHEET + 5e6, 10 * SHEET + (5e6, 5e6, 5e6 + 0.5)]),
    'a sliver': np.array([[(0, 0, 0), (1, 0, 0), (1, 1e-9, 0)]]),
    'one triangle far away': np.array([[(9e6, 0, 0), (9e6 + 1, 0, 0), (9e6, 1, 0)]]),
}


@pytest.mark.parametrize('solid', [None, False])
@pytest.mark.parametrize('name', WITNESSES)
def test_nothing_as_fine_as_rounding_is_lost(name, solid):
    """Where a part would be gone, the surface stays open, and each corner where it is."""
    triangles = WITNESSES[name]
    mesh = Mesh(triangles, solid=solid)
    assert (mesh.solid, mesh.closed, mesh.dropped) == (False, False, 0)
    assert np.array_equal(mesh.vertices[mesh.corners], triangles)
    with pytest.raises(ValueError, match='must be closed'):
        Mesh(triangles, solid=True)


@pytest.mark.parametrize('seed', range(60))
def test_every_given_triangle_is_there(seed):
    """Parted seams beside parts of any size, near and far: what is kept lies where it was."""
    rng = np.random.default_rng(seed)
    parts = []
    for _ in range(rng.integers(1, 4)):
        form = (CUBE, RING, TETRAHEDRON, SHEET)[rng.integers(4)]
        form = form[rng.random(len(form)) < rng.choice([0.8, 1.0])]
        size = 10.0 ** rng.uniform(-9, 1, (1, 3) if rng.random() < 0.5 else 1)
        parts.append(form * size + rng.uniform(-2, 2, 3))
    triangles = np.concatenate(parts) + rng.choice([0.0, 1e3, 1e6]) * rng.normal(size=3)
    rounding = rng.integers(3)
    triangles = (triangles, single(triangles), parted(triangles, rng))[rounding]
    real = triangles[[has_area(triangle) for triangle in triangles]]
    if not len(real):  # float32 has left nothing of it
        return
    mesh, shell = Mesh(triangles), Mesh(triangles, solid=False)
    farthest = np.abs(triangles).max()
    lengths = farthest if rounding else np.ptp(triangles, axis=(0, 1)).max()
    allowed = 2.0 * HALF_NOISE * lengths * (2.0 if mesh.convex else 1.0)
    assert farthest_away(real, mesh) <= 1e-15 * farthest + (allowed if mesh.closed else 0.0)
    assert farthest_away(real, shell) <= 1e-15 * farthest
    assert len(shell.corners) + shell.dropped == len(triangles)


@pytest.mark.parametrize('name', [name for name in (*SOLIDS, *SURFACES) if name != 'wall'])
def test_a_triangle_that_is_repeated_counts_once(name):
    """Else one that an exporter wrote twice would open a solid, or a part be empty by parity; and
    a sheet that is wound on both sides would be closed.
    """
    rng, triangles = np.random.default_rng(3), (SOLIDS | SURFACES)[name]
    again = rng.integers(0, len(triangles), rng.integers(1, 9))
    for other in (
        np.concatenate((triangles, triangles[again][:, [1, 0, 2]])),
        np.concatenate((triangles, triangles[: len(triangles) // 2])),
        np.concatenate((triangles, triangles[:, ::-1])),
    ):
        one, more = Mesh(triangles), Mesh(other)
        assert not more.convex
        assert (more.closed, more.solid, more.key) == (one.closed, one.solid, one.key)
        assert more.dropped == len(other) - len(triangles)
        starts, goals = segments(triangles, 300, rng)
        hits = [
            scene_of(Shapes.of_meshes(mesh, [0, 0, 0])).raycast_many(starts, goals - starts, 1.0)
            for mesh in (one, more)
        ]
        assert np.array_equal(hits[0].t, hits[1].t)
        assert np.array_equal(hits[0].triangles, hits[1].triangles)
        if not one.closed:
            with pytest.raises(ValueError, match='a solid mesh must be closed'):
                Mesh(other, solid=True)


NEXT = at((1, 0, 0), CUBE)  # it shares a wall with the cube: two triangles that both have
FIN = np.array([[(0.5, -0.5, -0.5), (0.5, 0.5, -0.5), (2, 0, -0.5)]])
FAR = at((9, 0, 0), CUBE)
REPEATED = {  # the parts of a mesh, in some order, and how many triangles count
    'two that share a wall': ([CUBE, NEXT], 24),
    'beside a part on both sides': ([CUBE, NEXT, FAR, FAR], 36),
    'one twice, its neighbour once': ([CUBE, CUBE, NEXT], 24),
    'one three times, its neighbour twice': ([CUBE, NEXT] * 2 + [CUBE], 24),
    'all on both sides': ([CUBE, NEXT] * 2, 24),
    'all three times': ([CUBE, NEXT] * 3, 24),
    'two that share an edge, twice and three times': (
        [CUBE, NEXT, FAR, FAR] + [at((9, 1, 1), CUBE)] * 3,
        48,
    ),
    'a fin on both sides': ([CUBE, FIN, FIN, FAR, FAR], 26),
    'a fin on both sides, and all again': ([CUBE, FIN, FIN, FAR] * 2, 26),
}


@pytest.mark.parametrize('name', REPEATED)
def test_a_part_that_is_repeated_is_not_hollow(name):
    """However often others are given: the middle of each cube is occupied."""
    parts, count = REPEATED[name]
    rng = np.random.default_rng(4)
    triangles = rng.permutation(np.concatenate(parts))
    triangles = np.array([rng.permutation(triangle) for triangle in triangles])
    mesh = Mesh(triangles)
    assert (mesh.solid, len(mesh.corners)) == (True, count)
    assert mesh.dropped == len(triangles) - count
    scene = scene_of(Shapes.of_meshes(mesh, [0, 0, 0]))
    middles = [part.mean(axis=(0, 1)) for part in parts if len(part) > 1]
    assert not scene.nearest_many(middles).distances.any()
    assert scene.nearest((4.0, 0.0, 0.0))[0].t > 0.0


A, B, C = CUBE[0]
STRAYS = {
    'apart': [(5, 5, 5), (6, 5, 5), (7, 5, 5)],
    'on an edge': [A, B, (A + B) / 2],
    'beyond an edge': [A, B, 2 * B - A],
    'two corners': [A, A, C],
    'a mote': [A + 3, A + 3, A + 3],
}


@pytest.mark.parametrize('stray', STRAYS)
def test_a_triangle_without_area_opens_nothing(stray):
    """Where it closes the seam between others, it does that, whatever else has no area."""
    middle = (A + B) / 2
    filled = [*CUBE[1:], (A, middle, C), (middle, B, C), (A, B, middle)]
    walls = np.concatenate([SOLIDS['wall'] / 3.0, CUBE + 9.0])
    for triangles, convex in ((RING, False), (walls, False), (CUBE, True), (filled, True)):
        mesh = Mesh(np.concatenate([triangles, [STRAYS[stray]]]))
        assert (mesh.convex, mesh.solid) == (convex, True)
        assert mesh.dropped == len(triangles) + 1 - len(mesh.corners)
        assert mesh.rows.max() < len(triangles)


def test_an_open_edge_is_that_of_a_triangle_with_an_area():
    stray, apart = [A, B, (A + B) / 2], CUBE[:1] + 9.0
    with pytest.raises(ValueError, match=r'triangle 13$'):
        Mesh(np.concatenate([CUBE, [stray], apart]), solid=True)


def test_many_triangles_without_area_are_left_out():
    """Found exactly, in whole numbers: one that is off by one part in 2^50 is kept."""
    rng = np.random.default_rng(5)
    ends = rng.integers(-(2**20), 2**20, (2, 20_000, 3))
    thin = np.stack([*ends, ends.sum(axis=0) / 2], axis=1) * 2.0 ** rng.integers(
        -60, 60, (20_000, 1, 1)
    )
    bent = np.array([[(0, 0, 0), (1, 1, 1), (2, 2, 2 + 2.0**-50)]])
    mesh = Mesh(np.concatenate([RING, thin, bent]))
    assert mesh.dropped == len(thin)
    assert mesh.rows[-1] == len(RING) + len(thin)


SPECKS = np.concatenate([CUBE * 1e-9, 1e-9 * RING + 1.0])
HOLLOW = np.concatenate([CUBE, CUBE * (1.0 - 1e-7)])


@pytest.mark.parametrize('triangles', [SPECKS, HOLLOW], ids=['two specks', 'a thin hollow'])
def test_two_parts_are_not_one_convex_solid(triangles):
    """However small: what lies between them, or within both, is free."""
    mesh = Mesh(triangles)
    assert (mesh.convex, mesh.solid, mesh.dropped) == (False, True, 0)
    scene = scene_of(Shapes.of_meshes(mesh, [0, 0, 0]))
    assert scene.nearest_many([[0.1, 0.2, 0.3]]).distances[0, 0] > 0.1


@pytest.mark.parametrize('size', [1e-17, 1e-20, 1e-100])
def test_what_vanishes_beside_the_rest_is_no_reason_to_warn(size):
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        mesh = Mesh(np.concatenate([CUBE + 1.0, RING * size]))
    assert (mesh.convex, mesh.solid) == (False, True)
