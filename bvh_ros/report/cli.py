# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The command line of the report."""

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from . import error, features, peers, planner, soak, speed, stability
from .page import Page, bar, say

DATA = Path(__file__).resolve().parents[3] / 'shared' / 'data'  # beside the checkout
# A part is a module with an INTRODUCTION and SECTIONS: by name, functions of the page and of
# whether the report is to be brief, which return how many cases failed, or None.
PARTS = {
    'error': error,
    'features': features,
    'peers': peers,
    'planner': planner,
    'speed': speed,
    'stability': stability,
}


class Section(NamedTuple):
    """One piece of a part."""

    name: str
    run: Callable[[Page, bool], int | None]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the chosen parts and write the page."""
    options = _options(arguments)
    if find_spec('matplotlib') is None:
        sys.exit("bvh_report draws with matplotlib: pip install 'bvh_ros[report]'")
    page = Page(options.out, say, options.data)
    sections = bar(_sections(options), lambda section: section.name)
    failed = sum(section.run(page, options.quick) or 0 for section in sections)
    print(f'written: {page.write()}')
    if failed:
        sys.exit(f'{failed} cases failed')


def _sections(options: argparse.Namespace) -> list[Section]:
    if options.part == 'soak':
        return [Section('soak', lambda page, _brief: soak.run(page, options.minutes))]
    chosen = PARTS
    names = list(PARTS) if options.part == 'all' else [options.part]
    found = []
    for name in names:
        found.append(Section(name, partial(_introduce, chosen[name].INTRODUCTION)))
        found += [Section(f'{name}: {what}', run) for what, run in chosen[name].SECTIONS.items()]
    return found


def _introduce(text: str, page: Page, _brief: bool) -> None:
    page.add(text)


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog='bvh_report', description=__doc__)
    parser.add_argument(
        'part',
        choices=[*PARTS, 'all', 'soak'],
        help='error: how wrong each way of answering is, against its time; '
        'features: what each part costs when it is on, and when it is off; '
        'peers: other libraries on the same work; '
        'planner: batches of swept balls, turned boxes, points and distances; '
        'speed: growth, calls, policies, searches, cold start; '
        'stability: extreme and stiff cases; exits with 1 if one fails; '
        'soak: a node under load over ROS 2, exits with 1 if an answer is wrong or memory grows',
    )
    parser.add_argument(
        '--out', type=Path, default=Path('report_out'), help='folder to write to (%(default)s)'
    )
    parser.add_argument(
        '--data', type=Path, default=DATA, help='folder of the recordings (%(default)s)'
    )
    parser.add_argument(
        '--quick',
        action='store_true',
        help='small scenes and few repeats: shows that it runs, no more',
    )
    parser.add_argument(
        '--minutes', type=float, default=30.0, help='length of the soak (%(default)s)'
    )
    options = parser.parse_args(arguments)
    if not 0.0 < options.minutes < math.inf:
        parser.error('--minutes must be more than 0')
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        parser.error(f'--out {options.out}: {error.strerror}')
    return options
