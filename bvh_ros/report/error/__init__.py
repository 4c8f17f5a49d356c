# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report error`: how wrong each way of answering is, against how long it takes."""

from ..page import Page
from ..progress import Progress
from . import box_scenes, decision, inflation, pairs, shape_scenes, traffic, ways

RAY_SCENES = (
    box_scenes.random_scene,
    box_scenes.adversarial_scene,
    box_scenes.building_scene,
    shape_scenes.random_shapes,
    shape_scenes.shelves,
    traffic.stale_traffic,
)
SECTIONS = (*RAY_SCENES, inflation.inflated_boxes, pairs.against_fcl, decision.exact_decisions)


def steps(brief: bool) -> int:
    """How often the progress bar will move."""
    others = sum(part.steps(brief) for part in (inflation, pairs, decision))
    return len(RAY_SCENES) * ways.repeats(brief) + others


def run(page: Page, progress: Progress, brief: bool) -> None:
    """Measure every scene."""
    page.add('## Error against run time')
    page.add(
        'The truth is computed in whole numbers, by brute force behind a sound filter. *wrong '
        'first*: an object is met, but not the first; of objects entered at exactly the same '
        'distance any will do. *Plain float64 leaves*: the same kernels with the usual slab test '
        'in place of the exact decision. The ways take turns, each after an untimed run; medians. '
        'In the pictures the front joins what no cheaper way betters by more than a tenth.'
    )
    for section in SECTIONS:
        section(page, progress, brief)
