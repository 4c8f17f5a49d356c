# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report speed`: growth, calls, policies, searches, and what the first answer costs."""

from ..page import Page
from ..progress import Progress
from . import calls, cold_start, growth, policies, searches

SECTIONS = (growth, calls, policies, searches, cold_start)


def steps(brief: bool) -> int:
    """How often the progress bar will move."""
    return sum(section.steps(brief) for section in SECTIONS)


def run(page: Page, progress: Progress, brief: bool) -> None:
    """Measure every section."""
    page.add('## Speed')
    for section in SECTIONS:
        section.run(page, progress, brief)
