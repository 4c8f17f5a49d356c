# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays at axis-aligned boxes: random, adversarial, and a real scan in a real building."""

import numpy as np

from ..page import Page
from ..progress import Progress
from ..scenes import Boxes, Floats, Rays, incoherent_rays, uniform_boxes
from .truth import boxes_truth
from .ways import box_ways, compare, show

REPEATS, REPEATS_QUICK = 9, 2


def random_scene(page: Page, progress: Progress, brief: bool) -> None:
    """Boxes everywhere, rays from anywhere to anywhere."""
    rng = np.random.default_rng(1)
    count, asked = (300, 200) if brief else (10_000, 20_000)
    boxes, rays = uniform_boxes(count, rng), incoherent_rays(asked, rng)
    page.add('### Random boxes')
    page.add(f'{count:,} boxes that fill 2 % of a cube of 100 m, {asked:,} rays.')
    _measure(page, progress, brief, 'random', 'Random boxes and rays', boxes, rays)


def _measure(
    page: Page, progress: Progress, brief: bool, name: str, title: str, boxes: Boxes, rays: Rays
) -> None:
    progress.say(f'error: {name}')
    ways, truth = box_ways(boxes, rays), boxes_truth(boxes, rays)
    found = compare(ways, truth, REPEATS_QUICK if brief else REPEATS, progress)
    show(page, name, f'{title}: {len(boxes.lo):,} boxes', ways, found)
