# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report features`: what each part costs when it is on, and when it is off."""

from ..page import Page
from ..progress import Progress
from . import node, off, on, robots

SECTIONS = (on, off, robots, node)


def steps(brief: bool) -> int:
    """How often the progress bar will move."""
    return sum(section.steps(brief) for section in SECTIONS)


def run(page: Page, progress: Progress, brief: bool) -> None:
    """Measure every section."""
    page.add('## Features')
    for section in SECTIONS:
        section.run(page, progress, brief)
