# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the examples read their command lines, and how they end where something is missing."""

import argparse
import sys
from pathlib import Path
from typing import NoReturn

ROS = "ROS 2 is missing: pip install 'bvh_ros[ros]', or . /opt/ros/jazzy/setup.bash"


def command_line(text: str | None) -> argparse.ArgumentParser:
    """A parser that answers --help with the docstring of an example, line by line."""
    return argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def end_with(text: str) -> NoReturn:
    """Say what is missing, and end with exit code 2."""
    print(text, file=sys.stderr)
    sys.exit(2)


def require_picture(file: str) -> None:
    """End if a picture cannot be drawn, or not written to this file; '' is no picture."""
    if not file:
        return
    folder = Path(file).resolve().parent
    if not folder.is_dir():
        end_with(f'{file} cannot be written: there is no folder {folder}')
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        end_with("a picture needs matplotlib: pip install 'bvh_ros[report]'")
