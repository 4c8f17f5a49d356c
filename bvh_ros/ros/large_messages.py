# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shared memory that is large enough for clouds and thousands of markers."""

from __future__ import annotations

import os
from pathlib import Path

PROFILE = Path('config', 'fastdds_large_messages.xml')
VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')


def profile() -> Path:
    """Return our Fast DDS profile, where it is installed or in the checkout.

    Raises
    ------
    FileNotFoundError
        If it is in neither.
    """
    for folder in Path(__file__).resolve().parents:
        for place in (folder / 'share' / 'bvh_ros', folder):
            if (place / PROFILE).is_file():
                return place / PROFILE
    raise FileNotFoundError(f'{PROFILE} is not installed')


def enable() -> None:
    """Use the profile in this process and those that it starts, unless the user has another.

    To be called before `rclpy.init`.
    """
    if not any(os.environ.get(variable) for variable in VARIABLES):
        os.environ[VARIABLES[0]] = str(profile())
