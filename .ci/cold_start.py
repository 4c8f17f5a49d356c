# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Compile what a node without configuration calls, and say how long that takes.

Fails if a kernel is compiled for two signatures, or if there are more of them than written here:
each makes the first start longer for everybody. With an empty cache folder.
"""

import os
import sys
from collections import Counter

from bvh_ros.report import workload

MOST = 36  # kernels that Python calls
TWICE = {
    'scene.distance.query.overlap_kernel'  # for boxes alone, and for all shapes
}


def main() -> int:
    found = workload.compile_apart()
    for entry in found:
        print(f'{entry.seconds:7.2f} s  (LLVM {entry.llvm:5.2f})  {entry.name}')
    total = sum(entry.seconds for entry in found)
    print(f'{len(found)} kernels: {total:.1f} s of compiling, {os.cpu_count()} processors here')
    counts = Counter(entry.name for entry in found)
    twice = [name for name, count in counts.items() if count > 1 + (name in TWICE)]
    if twice:
        print(f'compiled for more than one signature: {", ".join(twice)}')
    if len(found) > MOST:
        print(f'a node without configuration compiles {len(found)} kernels; at most {MOST}')
    if not total:
        print('the cache folder was not empty: nothing was compiled')
    return 1 if twice or len(found) > MOST or not total else 0


if __name__ == '__main__':
    sys.exit(main())
