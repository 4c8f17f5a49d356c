# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Distance between boxes and cylinders against alternating projections and python-fcl."""

import fcl
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bvh_ros.scene.solid_gap import box_cylinder_gap

COUNT = 400


def pairs(seed):
    rng = np.random.default_rng(seed)
    half, radius, height = (
        rng.uniform(0.02, 1, (COUNT, 3)),
        rng.uniform(0.02, 1, COUNT),
        rng.uniform(0.02, 1, COUNT),
    )
    turn = Rotation.random(COUNT, random_state=seed).as_matrix()
    # A quarter of them with faces and caps parallel.
    turn[: COUNT // 4] = Rotation.from_euler('z', rng.uniform(-3, 3, (COUNT // 4, 1))).as_matrix()
    return half, turn, rng.normal(size=(COUNT, 3)) * 1.2, radius, height


def projected(half, turn, centre, radius, height):
    """To and fro between two convex sets (von Neumann): a bound that sinks to the distance."""
    point = centre.copy()
    for _ in range(4000):
        across = np.linalg.norm(point[:, :2], axis=1)
        on = point * np.minimum(1.0, radius / np.maximum(across, 1e-300))[:, None]
        on[:, 2] = np.clip(point[:, 2], -height, height)
        local = np.einsum('nij,ni->nj', turn, on - centre)
        point = np.einsum('nij,nj->ni', turn, np.clip(local, -half, half)) + centre
    return np.linalg.norm(point - on, axis=1)


def test_gap_equals_alternating_projections():
    given = pairs(4)
    bound = projected(*given)
    gaps = np.array([box_cylinder_gap(*row) for row in zip(*given, strict=True)])
    apart = gaps > 0
    assert 100 < np.count_nonzero(apart) < COUNT - 50
    assert gaps[apart] == pytest.approx(bound[apart], abs=1e-6)
    assert (gaps <= bound + 1e-12).all()
    assert bound[~apart].max() < 1e-3


def test_touching_as_python_fcl_says():
    for row in zip(*pairs(5), strict=True):
        half, turn, centre, radius, height = row
        cylinder = fcl.CollisionObject(fcl.Cylinder(radius, 2 * height))
        box = fcl.CollisionObject(fcl.Box(*(2 * half)), fcl.Transform(turn, centre))
        gap = box_cylinder_gap(*row)
        assert (gap == 0.0) == (fcl.collide(cylinder, box) > 0) or gap < 1e-5
        # fcl's iteration stops early, on the far side
        assert gap <= max(fcl.distance(cylinder, box), 0.0) + 1e-5


@pytest.mark.parametrize(
    ('half', 'centre', 'expected'),
    [
        ((1, 1, 1), (0, 0, 3), 0.0),  # on the cap
        ((1, 1, 1), (0, 0, 3.25), 0.25),
        ((5, 5, 1), (4, 4, 3.5), 0.5),  # a wide plate over the cap
        ((1, 1, 1), (2, 0, 0), 0.0),  # at the side
        ((1, 1, 1), (2.5, 0, 0), 0.5),
        ((1, 1, 1), (3, 3, 0), 2 * 2**0.5 - 1),  # edge to side
        ((1, 1, 1), (2 + 3, 0, 3 + 4), 5.0),  # edge to rim
        ((9, 9, 9), (0, 0, 0), 0.0),  # all inside
        ((9, 9, 0.01), (0, 0, 0), 0.0),  # through a plate, no edge near
        ((0.1, 0.1, 9), (0, 0, 0), 0.0),  # a rod through the cylinder
        ((0, 0, 0), (3, 0, 0), 2.0),  # a point
    ],
)
def test_exact_cases(half, centre, expected):
    """A cylinder of radius 1 and half height 2."""
    gap = box_cylinder_gap(np.array(half, float), np.eye(3), np.array(centre, float), 1.0, 2.0)
    assert gap == pytest.approx(expected, abs=1e-12)
