# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How exactly rays meet turned shapes: against the surface computed with 60 digits."""

from decimal import Decimal, localcontext

import numpy as np
import pytest
from scene.distance import contacts
from scene.reference import random_turns, refilled

from bvh_ros.scene import ShapeKind, Shapes

UNIT = 2.0**-53
BOUND = 8  # roundings, see bvh_ros.scene.cast.shapes


def depth(kind: ShapeKind, local: list[Decimal], size: np.ndarray) -> Decimal:
    """How far inside the surface a point is, along the nearest face; negative outside."""
    half = [Decimal(float(edge)) / 2 for edge in size]
    if kind == ShapeKind.BOX:
        return min(h - abs(c) for h, c in zip(half, local, strict=True))
    if kind == ShapeKind.SPHERE:
        return half[0] - sum((c * c for c in local), Decimal(0)).sqrt()
    if kind == ShapeKind.CAPSULE:
        straight = half[2] - half[0]
        local[2] -= min(max(local[2], -straight), straight)
        return half[0] - sum((c * c for c in local), Decimal(0)).sqrt()
    return min(half[0] - (local[0] ** 2 + local[1] ** 2).sqrt(), half[2] - abs(local[2]))


@pytest.mark.parametrize('kind', [kind for kind in ShapeKind if kind != ShapeKind.MESH])
@pytest.mark.parametrize('scale', [1e-3, 1.0, 1e5])
@pytest.mark.parametrize('offset', [0.0, 1e3])
def test_a_hit_lies_on_the_surface(kind: ShapeKind, scale: float, offset: float) -> None:
    """Within BOUND roundings of the largest length in play, however the ray grazes."""
    rng = np.random.default_rng([int(kind), int(np.log10(scale)) + 9, int(offset)])
    hits, worst = 0, 0.0
    for _ in range(150):
        size = rng.uniform(0.2, 2.0, 3) * scale
        if kind != ShapeKind.BOX:
            size[1] = size[0]
        if kind == ShapeKind.SPHERE:
            size[2] = size[0]
        if kind == ShapeKind.CAPSULE:
            size[2] += size[0]
        position = (rng.uniform(-2, 2, 3) + offset) * scale
        (turn,) = random_turns(rng, 1)
        shapes = Shapes(np.array([kind], np.uint8), position[None], turn[None], size[None])
        scene = refilled(shapes)
        start = position + rng.normal(size=3) * 4 * scale
        goal = 2 * (position + rng.normal(size=3) * 0.3 * scale) - start
        hit = scene.raycast(start, goal)
        if hit is None or hit.t == 0.0:
            continue
        hits += 1
        with localcontext() as context:
            context.prec = 60
            way = goal - start
            there = contacts.decimals(start) + Decimal(hit.t) * contacts.decimals(way)
            local = (there - contacts.decimals(position)) @ contacts.matrix(turn)
            off = abs(float(depth(kind, local.tolist(), size)))
        largest = float(np.abs([start, goal, position, size]).max())
        worst = max(worst, off / (UNIT * largest))
    assert hits > 60
    assert worst <= BOUND
