# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report stability`: extreme and stiff cases, each with its verdict."""

from collections.abc import Callable, Iterable

from ..page import Page
from ..progress import Progress
from ..tables import Table
from . import boxes, motion, rays, scales
from .case import HEADER, Case

GROUPS: dict[str, Callable[[bool], Iterable[Case]]] = {
    'Rays': lambda brief: rays.ray_cases(),
    'Scales': scales.scale_cases,
    'Boxes': lambda brief: (*boxes.pair_cases(), *boxes.nearest_cases()),
    'Order': boxes.height_cases,
    'Motion': motion.motion_cases,
}


def steps(brief: bool) -> int:
    """How often the progress bar will move."""
    return len(GROUPS)


def run(page: Page, progress: Progress, brief: bool) -> int:
    """Judge every case; returns how many failed."""
    page.add('## Stability')
    page.add(
        'What is expected is computed in whole numbers. A ray is asked one by one, in a batch and '
        'whether it meets anything; a distance may be 2 ulp off. *float64 slab* is the usual test '
        '(numpy, 0 * inf bounds nothing), *python-fcl* answers overlaps and distances only.'
    )
    failed = total = 0
    for title, cases in GROUPS.items():
        progress.say(f'stability: {title.lower()}')
        found = list(cases(brief))
        page.add(f'### {title}')
        name = f'stability_{title.lower()}'
        page.table(Table(name, HEADER, [case.cells() for case in found]))
        failed += sum(not case.passed for case in found)
        total += len(found)
        progress.step()
    page.add(f'**{total - failed} of {total} cases passed.**')
    return failed
