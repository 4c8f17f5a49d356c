# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_warm_up`: compile before the first start, say while an image is built.

Starts find the folder in $BVH_ROS_KERNELS, or by themselves if it is the one inside the installed
package.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bvh_ros.ros.compile_jobs import Job

LEVELS = 'x86-64-v2', 'x86-64-v3', 'x86-64-v4'
AGAIN = 0.5  # seconds of what other jobs have compiled nearly all of


def main(args: Sequence[str] | None = None) -> int:
    """Compile into a folder; return 0 if starts can use it."""
    options = _arguments(args)
    # numba reads these when it is imported. Nothing is to come from what was shipped before.
    os.environ |= {'NUMBA_CACHE_DIR': str(options.folder or ''), 'BVH_ROS_KERNELS': ''}
    if options.cpu != 'native':
        os.environ |= {'NUMBA_CPU_NAME': options.cpu, 'NUMBA_CPU_FEATURES': ''}
    from bvh_ros.tree.compiler import kernel_cache, shipped

    if options.folder is None:
        os.environ['NUMBA_CACHE_DIR'] = str(shipped.IN_PACKAGE)
    missing = shipped.missing_features(shipped.LEVELS.get(options.cpu, ()))
    if missing:
        print(
            f'bvh_warm_up: kernels for {options.cpu} have to run here, too, and this processor'
            f' has no {", ".join(missing)}',
            file=sys.stderr,
        )
        return 1
    try:
        if kernel_cache.cache_folder() is None:
            raise OSError('there is no folder to write kernels to')
        _compile(options.params_file)
        folder = kernel_cache.ship()
    except KeyboardInterrupt:
        return 130
    except (OSError, RuntimeError) as error:
        print(f'bvh_warm_up: {error}', file=sys.stderr)
        return 1
    files = [*folder.glob('*.nbc')]
    size = sum(file.stat().st_size for file in files) / 1e6
    print(f'{len(files)} kernels for {options.cpu}, {size:.1f} MB, in {folder}')
    return 0


def _compile(parameters: Path | None) -> None:
    from bvh_ros.ros.compilation import Compilation, Progress

    compilation = Compilation([*_everything()] if parameters is None else _jobs_of(parameters))
    progress = Progress(partial(print, flush=True))
    progress.begin(compilation)
    try:
        while not compilation.is_done:
            compilation.go_on(0.2)
            progress.show(compilation)
    finally:
        compilation.end()
    progress.end(compilation)


def _everything() -> Iterator[Job]:
    """What any node may need, and a tree alone."""
    from bvh_ros.ros.cdr import any_message, marker_array
    from bvh_ros.ros.compile_jobs import Job, Needs, jobs, later_jobs, path_jobs, use_tree
    from bvh_ros.ros.conversions import octomap
    from bvh_ros.scene import ShapeKind

    every = ShapeKind.BOX, ShapeKind.SPHERE, ShapeKind.CYLINDER, ShapeKind.MESH
    first: dict[tuple[bool, str], Job] = {}
    again = []  # of other configurations, whose kernels are compiled by then
    for planar in (False, True):
        for moving, margin, kinds in product((False, True), (0.0, 0.1), (every, every[:1])):
            needs = Needs(planar, margin, kinds, batch=True, threads=2, moving=moving)
            for job in (*jobs(needs), *later_jobs(needs), *path_jobs(needs)):
                if first.setdefault((planar, job.name), job) is not job:
                    again.append(job._replace(seconds=AGAIN))
        tree = Job('tree', f'tree {planar}', 10.0, partial(use_tree, 2 if planar else 3))
        first[planar, tree.name] = tree
    yield from first.values()
    decoders: dict[str, Callable[[], object]] = {
        'decode markers': partial(marker_array.read, marker_array.EMPTY),
        'decode messages': any_message.exercise,
        'decode octrees': octomap.exercise,
    }
    for name, decode in decoders.items():
        yield Job(name, name, 2.0, decode)
    yield from again


def _jobs_of(parameters: Path) -> list[Job]:
    """What a node with these parameters needs."""
    import rclpy
    from rclpy.node import Node

    from bvh_ros.ros.access import BvhServer, ConfigurationError

    rclpy.init(args=['--ros-args', '--params-file', str(parameters)])
    try:
        node = Node('bvh')
        return BvhServer(node).jobs(wholly=True)
    except ConfigurationError as error:
        raise RuntimeError(str(error)) from error
    finally:
        rclpy.try_shutdown()


def _arguments(args: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog='bvh_warm_up', description=(__doc__ or '').partition(': ')[2].replace('\n', ' ')
    )
    parser.add_argument(
        'folder', nargs='?', type=Path, help='by default the one inside the installed package'
    )
    parser.add_argument(
        '--params-file', type=Path, help="a node's parameters: only what these need"
    )
    parser.add_argument(
        '--cpu',
        choices=[*LEVELS, 'native'],
        default='native',
        help='the least processor that is to run it (%(default)s: one with all that this has)',
    )
    options = parser.parse_args(args)
    if options.params_file is not None and not options.params_file.is_file():
        parser.error(f'there is no file {options.params_file}')
    return options


if __name__ == '__main__':
    sys.exit(main())
