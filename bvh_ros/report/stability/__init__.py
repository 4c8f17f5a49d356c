# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report stability`: extreme and stiff cases, each with its verdict."""

from collections.abc import Callable, Iterable
from functools import partial

from ..page import Page
from ..tables import Table
from . import boxes, motion, rays, scales
from .case import HEADER, Case

INTRODUCTION = """## Stability

What is expected is computed in whole numbers. A ray is asked one by one, in a batch and whether
it meets anything; a distance may be 2 ulp off. *float64 slab* is the usual test (numpy, 0 * inf
bounds nothing)."""


def judge(title: str, cases: Callable[[bool], Iterable[Case]], page: Page, brief: bool) -> int:
    """Add a table of cases; return how many failed."""
    found = list(cases(brief))
    failed = sum(not case.passed for case in found)
    page.add(f'### {title}')
    page.table(Table(f'stability_{title.lower()}', HEADER, [case.cells() for case in found]))
    page.add(f'**{len(found) - failed} of {len(found)} cases passed.**')
    return failed


SECTIONS = {
    'rays': partial(judge, 'Rays', lambda brief: rays.ray_cases()),
    'scales': partial(judge, 'Scales', scales.scale_cases),
    'boxes': partial(judge, 'Boxes', lambda brief: (*boxes.pair_cases(), *boxes.nearest_cases())),
    'order': partial(judge, 'Order', boxes.height_cases),
    'motion': partial(judge, 'Motion', motion.motion_cases),
}
