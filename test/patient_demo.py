# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_demo` for a loaded machine: it waits for minutes where users want to hear after seconds."""

import sys
from functools import partial

from bvh_ros import demo, replay
from bvh_ros.ros import running

PATIENCE = 1000.0  # seconds

demo.BvhClient = partial(demo.BvhClient, timeout=PATIENCE)
replay.ARRIVES_WITHIN = running.START_TIMEOUT = running.END_TIMEOUT = PATIENCE

if __name__ == '__main__':
    sys.exit(demo.main())
