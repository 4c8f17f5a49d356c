# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_view` in a process of its own, beside a program that brings the node."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from bvh_ros.ros.running import end, signals_waiting
from bvh_ros.view.main import GET_IT


@contextmanager
def running_view(name: str) -> Iterator[str]:
    """Show a node, which need not run yet; give the address of the page.

    Raises
    ------
    RuntimeError
        Without viser, or if the view does not start.
    """
    if importlib.util.find_spec('viser') is None:
        raise RuntimeError(GET_IT)
    command = [sys.executable, '-m', 'bvh_ros.view.main', name]
    process = None
    try:
        with signals_waiting():
            # A session of its own: Ctrl-C reaches us alone, and we end it.
            process = subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True)
        assert process.stdout is not None
        address = process.stdout.readline().decode().partition('http://')[2].strip()
        if not address:
            raise RuntimeError('the view did not start')
        yield f'http://{address}'
    finally:
        if process is not None:
            end(process)
