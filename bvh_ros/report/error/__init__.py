# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report error`: how wrong each way of answering is, against how long it takes."""

from ..page import Page
from ..progress import Progress
from . import box_scenes, decision, shape_scenes, traffic, ways

SECTIONS = (
    box_scenes.random_scene,
    box_scenes.adversarial_scene,
    box_scenes.building_scene,
    shape_scenes.random_shapes,
    shape_scenes.shelves,
    traffic.stale_traffic,
    decision.exact_decisions,
)


def steps(brief: bool) -> int:
    """How often the progress bar will move."""
    return (len(SECTIONS) - 1) * ways.repeats(brief) + decision.steps(brief)


def run(page: Page, progress: Progress, brief: bool) -> None:
    """Measure every scene."""
    page.add('## Error against run time')
    for section in SECTIONS:
        section(page, progress, brief)
