# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Programs in processes of their own: a new start to numba."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

Ended = subprocess.CompletedProcess[str]


def run_alone(code: str, *arguments: str, cwd: Path | None = None, **environment: str) -> Ended:
    return subprocess.run(
        [sys.executable, '-c', textwrap.dedent(code), *arguments],
        capture_output=True,
        text=True,
        timeout=3000,  # seconds: it may compile, on a loaded machine
        env={**os.environ, **environment},
        cwd=cwd,
        check=False,
    )
