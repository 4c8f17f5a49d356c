# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Programs in processes of their own: a new start to numba."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

Ended = subprocess.CompletedProcess[str]
TESTS = str(Path(__file__).parents[2])


def run_alone(
    code: str, *arguments: str, cwd: Path | None = None, ends: int | None = 0, **environment: str
) -> Ended:
    """Run a program, with the tests on its path, and require how it ends; None: anyhow."""
    paths = filter(None, (TESTS, os.environ.get('PYTHONPATH')))
    ended = subprocess.run(
        [sys.executable, '-c', textwrap.dedent(code), *arguments],
        capture_output=True,
        text=True,
        timeout=3000,  # seconds: it may compile, on a loaded machine
        env={**os.environ, 'PYTHONPATH': os.pathsep.join(paths), **environment},
        cwd=cwd,
        check=False,
    )
    assert ends in (None, ended.returncode), (ended.stdout[-500:], ended.stderr[-2000:])
    return ended
