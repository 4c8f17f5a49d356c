# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The random scenes of the report."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

EDGE = 100.0  # m, of the cube that the boxes fill
FILLED = 0.02  # of its volume


class Boxes(NamedTuple):
    """n boxes, shape (n, 3) each, m."""

    lo: Floats
    hi: Floats

    @property
    def edges(self) -> Floats:
        """Lengths of the edges, (n, 3)."""
        return self.hi - self.lo

    @property
    def centers(self) -> Floats:
        """Centres, (n, 3)."""
        middle: Floats = (self.lo + self.hi) / 2
        return middle

    def moved(self, shift: Floats | float) -> 'Boxes':
        """The boxes, each shifted by its row, or all alike."""
        return Boxes(self.lo + shift, self.hi + shift)


class Rays(NamedTuple):
    """n rays, shape (n, 3) each; the directions are unit vectors."""

    origins: Floats
    directions: Floats


def uniform_boxes(count: int, rng: np.random.Generator) -> Boxes:
    """Boxes of random proportions, spread evenly, that fill about 2 % of the cube."""
    size = (FILLED * EDGE**3 / count) ** (1 / 3)
    centers = spread(count, rng)
    half = rng.uniform(0.16, 0.8, (count, 3)) * size
    return Boxes(centers - half, centers + half)


def spread(count: int, rng: np.random.Generator) -> Floats:
    """Points spread evenly over the cube."""
    return rng.uniform(-EDGE / 2, EDGE / 2, (count, 3))


def units(vectors: Floats) -> Floats:
    """The vectors (n, 3) at length 1."""
    unit: Floats = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    return unit


def incoherent_rays(count: int, rng: np.random.Generator) -> Rays:
    """Rays from anywhere to anywhere, in float32 numbers: every library gets the same rays."""
    directions = units(rng.normal(size=(count, 3)))
    return Rays(
        spread(count, rng).astype(np.float32).astype(np.float64),
        directions.astype(np.float32).astype(np.float64),
    )


def query_edge(boxes: Boxes, hits: float) -> float:
    """Edge of the cube that overlaps so many of the boxes on average, at a random place."""
    low, high = 0.0, EDGE
    for _ in range(60):
        edge = (low + high) / 2
        overlaps = float(np.prod(boxes.edges + edge, axis=1).sum()) / EDGE**3
        low, high = (edge, high) if overlaps < hits else (low, edge)
    return low


def wavy_ring(around: int, across: int) -> tuple[Floats, NDArray[np.int32]]:
    """Vertices, m, and faces of a solid ring with waves, two triangles a field of the grid."""
    u = np.arange(around)[:, None] * (2 * np.pi / around)
    v = np.arange(across)[None] * (2 * np.pi / across)
    thick = 0.4 + 0.06 * np.sin(7 * u) * np.cos(3 * v)
    wide = 1.0 + thick * np.cos(v)
    parts = wide * np.cos(u), wide * np.sin(u), thick * np.sin(v)
    row = np.arange(around * across).reshape(around, across)
    beside, above = np.roll(row, -1, axis=0), np.roll(row, -1, axis=1)
    corner = np.roll(beside, -1, axis=1)
    faces = np.stack([row, beside, corner, row, corner, above], axis=2)
    return np.stack(parts, axis=2).reshape(-1, 3), faces.reshape(-1, 3).astype(np.int32)
