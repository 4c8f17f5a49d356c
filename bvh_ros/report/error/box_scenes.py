# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays at axis-aligned boxes: random, adversarial, and a real scan in a real building."""

import numpy as np

from ..page import Page
from ..scenes import Boxes, Rays, incoherent_rays, uniform_boxes
from . import recordings
from .truth import boxes_truth
from .ways import box_ways, compare, show

PLACES, PLACES_QUICK = 20, 2  # in the building, each with as many beams


def random_scene(page: Page, brief: bool) -> None:
    """Boxes everywhere, rays from anywhere to anywhere."""
    rng = np.random.default_rng(1)
    count, asked = (300, 200) if brief else (10_000, 20_000)
    boxes, rays = uniform_boxes(count, rng), incoherent_rays(asked, rng)
    page.add('### Random boxes')
    page.add(f'{count:,} boxes that fill 2 % of a cube of 100 m, {asked:,} rays.')
    _measure(page, brief, 'random', 'Random boxes, random rays', boxes, rays)


def adversarial_scene(page: Page, brief: bool) -> None:
    """Boxes on a lattice of tenths, rays through their corners, edges and face planes."""
    count, asked = (100, 200) if brief else (2_000, 20_000)
    boxes, rays = corner_rays(count, asked, np.random.default_rng(2))
    page.add('### Adversarial rays')
    page.add(
        f'{count:,} boxes, some flat, whose corners are multiples of 0.1 m, {asked:,} rays aimed '
        'at corners, edges and faces from other such points, many in the plane of a face. '
        'Where a ray only touches, rounding decides, unless the decision is exact.'
    )
    _measure(page, brief, 'adversarial', 'Corner, edge and face rays', boxes, rays)


def corner_rays(count: int, asked: int, rng: np.random.Generator) -> tuple[Boxes, Rays]:
    """Boxes and rays of lattice points; the directions are not normalised."""
    low = rng.integers(-40, 40, (count, 3))
    high = low + rng.integers(0, 4, (count, 3))
    lo, hi = low.astype(np.float64) * 0.1, high.astype(np.float64) * 0.1
    rows = rng.integers(0, count, asked)
    targets = np.where(rng.random((asked, 3)) < 0.5, low[rows], high[rows])
    steps = rng.integers(-3, 4, (asked, 3))
    steps[~steps.any(axis=1)] = (1, 2, 3)
    # Half of the rays from any lattice point, half along a simple direction.
    anywhere = np.where(rng.random((asked, 3)) < 0.15, targets, rng.integers(-80, 80, (asked, 3)))
    before = targets - steps * rng.integers(1, 30, (asked, 1))
    simple = rng.random((asked, 1)) < 0.5
    origins = np.where(simple, before, anywhere) * 0.1
    directions = np.where(simple, steps.astype(float), targets * 0.1 - origins)
    directions[~directions.any(axis=1)] = (0.1, 0.2, 0.3)
    return Boxes(lo, hi), Rays(origins, directions)


def building_scene(page: Page, brief: bool) -> None:
    """A real building, and the beams of a real scanner set up in its free places."""
    page.add('### Building 079, Freiburg')
    files = [
        page.data / 'octomap_fr079' / 'occupied_voxels.csv',
        page.data / 'octomap_fr079' / 'free_voxels_sample.csv',
        page.data / 'freiburg_scan3d' / 'scan.csv',
    ]
    if page.misses(files):
        return
    places = PLACES_QUICK if brief else PLACES
    beams = 50 if brief else 500
    boxes, free = recordings.cubes(files[0]), recordings.cubes(files[1])
    stand = np.random.default_rng(3).choice(len(free.lo), places, replace=False)
    directions = recordings.scan_directions(files[2])
    directions = directions[np.linspace(0, len(directions) - 1, beams).astype(int)]
    origins = np.repeat((free.lo[stand] + free.hi[stand]) / 2, beams, axis=0)
    page.add(
        f'{len(boxes.lo):,} cubes of an OctoMap of the building; {beams} beams of a laser scan '
        f'at each of {places} places in its free space (the scan was taken at a place of its own; '
        'its directions are what is real here).'
    )
    rays = Rays(origins, np.tile(directions, (places, 1)))
    _measure(page, brief, 'building', 'Freiburg 079, real scan', boxes, rays)


def _measure(page: Page, brief: bool, name: str, title: str, boxes: Boxes, rays: Rays) -> None:
    ways, truth = box_ways(boxes, rays), boxes_truth(boxes, rays)
    found = compare(ways, truth, brief)
    show(page, name, f'{title}: {len(boxes.lo):,} boxes, {len(rays.origins):,} rays', ways, found)
