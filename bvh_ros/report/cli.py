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
from .page import Page, bar

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
    if not all(map(find_spec, ('matplotlib', 'tqdm'))):
        sys.exit("bvh_report needs matplotlib and tqdm: pip install 'bvh_ros[report]'")
    page, failed = Page(options.out, options.data), 0
    for section in bar(_sections(options), lambda section: section.name):
        failed += section.run(page, options.quick) or 0
    print(f'written: {page.write()}')
    if failed:
        sys.exit(f'{failed} cases failed')


def _sections(options: argparse.Namespace) -> list[Section]:
    found = []
    for name in PARTS if 'all' in options.part else dict.fromkeys(options.part):
        if name == 'soak':
            found.append(Section(name, lambda page, _brief: soak.run(page, options.minutes)))
            continue
        found.append(Section(name, partial(_begin, PARTS[name].INTRODUCTION)))
        found += [Section(f'{name}: {what}', run) for what, run in PARTS[name].SECTIONS.items()]
    return found


def _begin(introduction: str, page: Page, _brief: bool) -> None:
    page.begin(introduction)


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog='bvh_report', description=__doc__)
    parser.add_argument(
        'part',
        nargs='+',
        choices=[*PARTS, 'all', 'soak'],
        help='error: how wrong each method of answering is, against its time; '
        'features: what each part costs when it is on, and when it is off; '
        'peers: other libraries on the same work; '
        'planner: batches of swept balls, turned boxes, points and distances; '
        'speed: growth, calls, policies, searches, cold start; '
        'stability: extreme and stiff cases; exits with 1 if one fails; '
        'soak: a node under load over ROS 2, exits with 1 if an answer is wrong or memory grows',
    )
    parser.add_argument(
        '--out',
        type=Path,
        default=Path('report_out'),
        help='folder to write to; parts of earlier runs stay on its page (%(default)s)',
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
