# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`python -m bvh_ros`: the version, and what commands there are."""

from __future__ import annotations

import argparse
import sys

from bvh_ros import __version__, commands


def main() -> int:
    """Print the version and the commands; return 0."""
    parser = argparse.ArgumentParser(prog='python -m bvh_ros', description=__doc__)
    version = f'bvh_ros {__version__}'
    parser.add_argument('--version', action='version', version=version)
    parser.parse_args()
    print(f'{version}\n\nCommands, each with --help:\n')
    for name, command in vars(commands).items():
        if name.startswith('bvh_'):
            print(f'  {name:20}{command.__doc__}')
    print('\nFrom Python: from bvh_ros import DynamicBVH, Scene, Shapes')
    return 0


if __name__ == '__main__':
    sys.exit(main())
