# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A world larger than memory: parts on disk, several worker processes, and the cost of a ray.

pip install 'bvh_ros[cluster]'
python examples/many_machines.py --boxes 1e7 --rays 1e7 --workers 2

With `--scheduler tcp://HOST:8786` a Dask cluster that runs already; its workers must see the
folder.
"""

import resource
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from needs import command_line, end_with

from bvh_ros.forest import Forest

try:
    from distributed import Client, LocalCluster
except ImportError:
    end_with("Dask is missing: pip install 'bvh_ros[cluster]'")

CHUNK = 1_000_000  # boxes that are in memory at once

parser = command_line(__doc__)
parser.add_argument('--boxes', type=float, default=1e5)
parser.add_argument('--rays', type=float, default=1e5)
parser.add_argument('--part', type=float, default=4e6, help='boxes a part')
parser.add_argument('--workers', type=int, default=2, help='0: no workers')
parser.add_argument('--folder', type=Path, help='keep the world here, and use it again')
parser.add_argument('--scheduler')


def chunks(count: int, side: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Boxes of up to 1 m, eight cubic metres each in the mean."""
    for number, start in enumerate(range(0, count, CHUNK)):
        rng = np.random.default_rng(number)
        lo = rng.uniform(0.0, side, (min(CHUNK, count - start), 3))
        yield lo, lo + rng.uniform(0.0, 1.0, lo.shape)


def peak() -> int:
    """Peak memory of this process, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


def cast(forest: Forest, count: int, side: float, client: Client | None) -> int:
    """Cast rays of random directions from random places; how many hit."""
    executor = client.get_executor(pure=False) if client else None
    hits = 0
    for start in range(0, count, CHUNK):
        rng = np.random.default_rng([1, start])  # not what the boxes were made of
        origins = rng.uniform(0.0, side, (min(CHUNK, count - start), 3))
        found = forest.raycast_many(origins, rng.normal(size=origins.shape), executor=executor)
        hits += np.count_nonzero(found.ids >= 0)
        print(f'  {min(start + CHUNK, count):,} rays', end='\r', flush=True)
    return hits


def main() -> None:
    options = parser.parse_args()
    boxes, rays = int(options.boxes), int(options.rays)
    side = (8.0 * boxes) ** (1 / 3)
    print(f'{rays:,} rays through {boxes:,} boxes that lie on disk, asked by worker processes.')
    folder = options.folder or Path(tempfile.mkdtemp()) / 'world'
    if not folder.exists():
        began = time.perf_counter()
        Forest.build(folder, chunks(boxes, side), int(options.part))
        print(f'built in {time.perf_counter() - began:.1f} s, at most {peak()} MB of memory')
    forest = Forest.open(folder)
    size = sum(file.stat().st_size for file in folder.iterdir())
    print(f'{len(forest):,} boxes in {forest.parts} parts, {size / len(forest):.0f} bytes a box')
    client = None
    if options.scheduler:
        client = Client(options.scheduler)
    elif options.workers:
        cluster = LocalCluster(
            n_workers=options.workers, threads_per_worker=1, dashboard_address=None
        )
        client = Client(cluster)
    for turn in ('first', 'again'):
        began = time.perf_counter()
        hits = cast(forest, rays, side, client)
        taken = time.perf_counter() - began
        print(f'{turn}: {hits:,} of {rays:,} rays hit, {taken / rays * 1e6:.2f} us a ray')
    if client:
        most = max(client.run(peak).values())
        print(f'No worker took more than {most} MB of memory, mapped files among it.')
        client.shutdown()
    else:
        print(f'This process took {peak()} MB of memory at most, mapped files among it.')


if __name__ == '__main__':
    main()
