# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A bvh_node that seems to compile for long: what is not for the first answers waits for a file.

Usage: slow_node.py FOLDER, then as bvh_node. It writes the number of the process that compiles to
FOLDER/compiles, and goes on once FOLDER/go is there. Not a test: `test_readiness.py` runs it.
"""

import sys
from functools import partial

from bvh_ros.commands import bvh_node
from bvh_ros.ros.access import BvhServer

FOLDER = sys.argv.pop(1)
SLOW = f"""
import os, pathlib, time
folder = pathlib.Path({FOLDER!r})
(folder / 'compiles').write_text(str(os.getpid()))
while not (folder / 'go').exists():
    time.sleep(0.05)
"""


usual_jobs = BvhServer.jobs


def slow_jobs(server, **given):
    """The usual ones, and one that waits."""
    usual = usual_jobs(server, **given)
    return [*usual, type(usual[0])('what waits', FOLDER, 40.0, partial(exec, SLOW, {}))]


BvhServer.jobs = slow_jobs
sys.exit(bvh_node())
