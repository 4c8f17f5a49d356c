# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The command line of the report."""

import argparse
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from . import error, features, intake, peers, speed, stability
from .page import Page
from .progress import Progress
from .soak import Soak

DATA = Path(__file__).resolve().parents[3] / 'shared' / 'data'  # beside the checkout
PARTS = {
    'error': error,
    'features': features,
    'peers': peers,
    'speed': speed,
    'stability': stability,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the chosen parts and write the page."""
    options = _options(arguments)
    if find_spec('matplotlib') is None:
        sys.exit("bvh_report draws with matplotlib: pip install 'bvh_ros[report]'")
    parts = _parts(options)
    with Progress(sum(part.steps(options.quick) for part in parts)) as progress:
        page = Page(options.out, progress.write, options.data)
        failed = sum(part.run(page, progress, options.quick) or 0 for part in parts)
    print(f'written: {page.write()}')
    if failed:
        sys.exit(f'{failed} cases failed')


def _parts(options: argparse.Namespace) -> Sequence[Any]:
    if options.part == 'soak':
        return [Soak(options.minutes)]
    if options.part == 'intake':
        return [intake]
    return list(PARTS.values()) if options.part == 'all' else [PARTS[options.part]]


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog='bvh_report', description=__doc__)
    parser.add_argument(
        'part',
        choices=[*PARTS, 'all', 'intake', 'soak'],
        help='error: how wrong each way of answering is, against its time; '
        'features: what each part costs when it is on, and when it is off; '
        'peers: other libraries on the same work; '
        'speed: growth, calls, policies, searches, cold start; '
        'stability: extreme and stiff cases; exits with 1 if one fails; '
        'intake: from a published message to the first answer, over ROS 2; '
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
    return parser.parse_args(arguments)
