# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The kernels that a process has compiled, and those of a node without configuration."""

import gc
import json
import os
import subprocess
import sys
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from ..tree.compiler.kernel_parts import Kernel

if TYPE_CHECKING:
    from ..ros.compile_jobs import Job


class Entry(NamedTuple):
    """A kernel, compiled for one signature."""

    name: str
    signature: str
    seconds: float  # all of it; 0 for what was in the cache
    llvm: float  # seconds of that in LLVM


def default_jobs() -> list['Job']:
    """Return what compiles all that a node without configuration calls."""
    from ..ros.cdr import marker_array
    from ..ros.compile_jobs import Job, Needs, jobs
    from ..ros.sources import SOURCE_TYPES

    decode = partial(marker_array.read, marker_array.EMPTY)
    kinds = SOURCE_TYPES['MarkerArray'].kinds
    return [
        *jobs(Needs(planar=False, margin=0.0, kinds=kinds, batch=True)),
        Job('decode markers', 'decode markers', 2.0, decode, early=True),
    ]


def measure(**environment: str) -> list[Entry]:
    """Compile in a new process; return its kernels, the slowest first."""
    ended = subprocess.run(
        [sys.executable, '-c', f'from {__name__} import main; main()'],
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    entries = [Entry(*json.loads(line)) for line in ended.stdout.splitlines()]
    return sorted(entries, key=lambda entry: -entry.seconds)


def compiled() -> list[Entry]:
    """The kernels that this process has called."""
    found = []
    for kernel in gc.get_objects():
        if isinstance(kernel, Kernel):
            name = f'{kernel.py_func.__module__.removeprefix("bvh_ros.")}.{kernel.__name__}'
            for signature, result in kernel.overloads.items():
                timers = (result.metadata or {}).get('timers', {})
                times = (timers.get(lock, 0.0) for lock in ('compiler_lock', 'llvm_lock'))
                found.append(Entry(name, str(signature), *times))
    return found


def main() -> None:
    """Compile, and print."""
    for job in default_jobs():
        job.run()
    for entry in compiled():
        print(json.dumps(entry))
