# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measure speed and errors, beside other libraries, and write a page of them."""

import argparse
import inspect
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from . import error, features, peers, planner, speed, stability
from .page import Page

# A part is a module with SECTIONS: by heading, functions of the page and of whether the report is
# to be brief, which return how many cases failed, or None. Docstrings are the text on the page.
MODULES = error, features, peers, planner, speed, stability
PARTS = {module.__name__.rpartition('.')[2]: module for module in MODULES}
QUICK = '\n\n*Quick form: scenes are smaller, and repeats fewer, than the texts say.*'


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the chosen parts and write the page."""
    options = _options(arguments)
    if not all(map(find_spec, ('matplotlib', 'tqdm'))):
        sys.exit("bvh_report needs matplotlib and tqdm: pip install 'bvh_ros[report]'")
    from tqdm import tqdm

    page, begun, failed = Page(options.out, options.data), '', 0
    sections = [
        (name, heading, run)
        for name in (PARTS if 'all' in options.part else dict.fromkeys(options.part))
        for heading, run in PARTS[name].SECTIONS.items()
    ]
    with tqdm(sections, disable=None, dynamic_ncols=True, leave=False) as bar:
        for name, heading, run in bar:  # a log gets no bar
            bar.set_description(f'{name}: {heading}')
            if name != begun:
                begun, text = name, inspect.getdoc(PARTS[name]) or ''
                page.begin(name.title(), text + QUICK * options.quick)
            page.add(f'### {heading}')
            if inspect.isfunction(run):
                page.add(inspect.getdoc(run) or '')
            failed += run(page, options.quick) or 0
    print(f'written: {page.write()}')
    if failed:
        sys.exit(f'{failed} cases failed')


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog='bvh_report', description=__doc__)
    lines = [f'{name}: {(part.__doc__ or "").splitlines()[0]}' for name, part in PARTS.items()]
    parser.add_argument(
        'part',
        nargs='+',
        choices=[*PARTS, 'all'],
        help=' '.join(lines) + ' Ends with 1 if a case of stability fails.',
    )
    parser.add_argument(
        '--out',
        type=Path,
        default=Path('report_out'),
        help='folder to write to; parts of earlier runs stay on its page (%(default)s)',
    )
    parser.add_argument(
        '--data',
        type=Path,
        help='folder of recordings; tables that need some are left out without it',
    )
    parser.add_argument(
        '--quick',
        action='store_true',
        help='small scenes and few repeats: shows that it runs, no more',
    )
    options = parser.parse_args(arguments)
    if options.data is not None and not options.data.is_dir():
        parser.error(f'--data {options.data}: there is no such folder')
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        parser.error(f'--out {options.out}: {error.strerror}')
    return options
