# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The class: checks input, finds out which parts a query meets, and merges what they say."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable
from concurrent.futures import Executor
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree import ALL, RayHits
from ..tree.access import Floats, Ids, OpenTree, checks, mapped
from . import building, dask_rows, queries


class Forest:
    """Boxes on disk, parted into trees of bounded size. Read-only.

    Every query has the meaning of the method of `DynamicBVH` of the same name, and its answer is,
    bit for bit, that of one tree into which the boxes were inserted in order: ids are rows of what
    was built, counted over all chunks, and ties go to the smaller one.

    Each query takes an `executor`: anything with the ``submit`` of `concurrent.futures.Executor`,
    such as a process pool, ``dask.distributed.Client.get_executor()`` or
    ``mpi4py.futures.MPIPoolExecutor``. Its workers open the parts that they query, so they
    must see the folder under the same path. None asks all parts in this process. An error of a
    worker is raised; no part is left out.

    Rows may be dask arrays, shape (n, ndim); the answers are then dask arrays, computed block by
    block where the blocks are.

    Examples
    --------
    >>> import numpy as np
    >>> import tempfile
    >>> from bvh_ros.forest import Forest
    >>> folder = tempfile.mkdtemp() + '/world'
    >>> lo = np.arange(3000.0).reshape(1000, 3)
    >>> forest = Forest.build(folder, [(lo[:500], lo[:500] + 1), (lo[500:], lo[500:] + 1)], 300)
    >>> len(forest), forest.parts
    (1000, 4)
    >>> forest.raycast_many([[1500.5, -9.0, 1502.5]], [[0.0, 1.0, 0.0]]).ids.tolist()
    [500]
    """

    def __init__(self, folder: Path, verify: bool = False) -> None:
        self._folder = folder.resolve()
        text = (self._folder / building.HEADER).read_bytes()
        self._mark = zlib.crc32(text)
        top = self._folder / building.TOP
        try:
            header = json.loads(text)
            if header['version'] != building.VERSION:
                raise ValueError(
                    f'it has version {header["version"]}; this is for {building.VERSION}'
                )
            parts = header['parts']
            counts = [checks.whole('boxes of a part', count, 1) for count, _, _ in parts]
            self._checksums = [checks.whole('checksum', crc, 0) for _, crc, _ in parts]
            self._count, self._ndim = sum(counts), header['ndim']
            self._top = OpenTree.load(top, mmap=True, verify=True)
            known = self._ndim, len(counts), header['top']
            if (self._top.ndim, len(self._top), mapped.checksum(top)) != known:
                raise ValueError('its top tree is of another forest')
            if verify:
                self._verify(counts, [of_ids for _, _, of_ids in parts])
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f'{folder} is no forest: {error}') from None

    def _verify(self, counts: list[int], of_ids: list[int]) -> None:
        """ValueError unless every part is sound, and each id is given to one box."""
        given, parts = np.zeros(self._count, np.bool_), zip(counts, self._checksums, strict=True)
        for number, (count, checksum) in enumerate(parts):
            file = building.part_file(self._folder, number)
            tree = OpenTree.load(file, mmap=True, verify=True)
            if (len(tree), mapped.checksum(file)) != (count, checksum):
                raise ValueError(f'{file} is of another forest or part')
            ids_path = building.ids_file(self._folder, number)
            ids = mapped.map_array(ids_path, count + 1)
            inside = 0 <= ids[:-1].min() <= ids[:-1].max() < self._count
            if ids[-1] != checksum or not inside or zlib.crc32(ids.tobytes()) != of_ids[number]:
                raise ValueError(f'{ids_path} is of another forest or part')
            given[ids[:-1]] = True
        if not given.all():
            raise ValueError(f'no box has the id {np.argmin(given)}')

    @classmethod
    def build(
        cls,
        folder: str | PathLike[str],
        chunks: Iterable[tuple[ArrayLike, ...]],
        max_boxes: int = 4_000_000,
    ) -> Forest:
        """Part boxes and write them to a new folder.

        Parameters
        ----------
        chunks : iterable of (lo, hi) or (lo, hi, mask)
            Each as for `DynamicBVH.insert_many`. One chunk at a time is in memory.
        max_boxes : int
            How many boxes a part may have. Building takes about 350 bytes of memory for each, and
            twice the boxes' own 60 bytes on disk beside what is written.

        Raises
        ------
        ValueError
            If a chunk is bad; the message names it. Nothing is left behind.
        FileExistsError
            If the folder exists.
        """
        path = Path(checks.path('folder', folder))
        building.build(
            path, checks.iterator('chunks', chunks), checks.capacity('max_boxes', max_boxes)
        )
        return cls(path)

    @classmethod
    def open(cls, folder: str | PathLike[str], verify: bool = False) -> Forest:
        """Open what `build` wrote. ValueError if it is no forest, or of another version.

        The first time that a process opens a part, it checks the links between its nodes, see
        `DynamicBVH.load`. `verify` reads and checks all parts now (0.4 s a million boxes).
        """
        return cls(Path(checks.path('folder', folder)), checks.flag('verify', verify))

    def __reduce__(self) -> Any:
        return _open_again, (self._folder, self._mark)

    def __repr__(self) -> str:
        return (
            f'Forest({str(self._folder)!r}, {self.ndim}D, {len(self):,} boxes in '
            f'{self.parts:,} part{"s" * (self.parts != 1)})'
        )

    def __len__(self) -> int:
        """How many boxes there are."""
        return self._count

    @property
    def ndim(self) -> int:
        """2 or 3."""
        return self._ndim

    @property
    def parts(self) -> int:
        """How many trees there are."""
        return len(self._top)

    @property
    def bounds(self) -> tuple[Floats, Floats] | None:
        """The box around all boxes; None if there are none."""
        return self._top.bounds

    def _parts_for(self, executor: Executor | None) -> queries.Parts:
        if executor is not None and not callable(getattr(executor, 'submit', None)):
            raise ValueError('executor must have the submit of concurrent.futures.Executor')
        return queries.Parts(self._top, str(self._folder), self._checksums, executor)

    def raycast_many(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike = ALL,
        skip_inside: bool = False,
        threads: int = 1,
        executor: Executor | None = None,
    ) -> RayHits:
        """First hits of n rays, see `DynamicBVH.raycast_many`. `threads`: of each worker."""
        given = self._ndim, origins, directions, t_max, mask, skip_inside, threads
        if dask_rows.are_given(executor, origins, directions, t_max, mask):
            kinds = ((), np.int64), ((), np.float64), ((self._ndim,), np.float64)
            return RayHits(*dask_rows.rays(self.raycast_many, kinds, *given))
        return queries.first_hits(self._parts_for(executor), queries.check_rays(*given))

    def occluded_many(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike = ALL,
        skip_inside: bool = False,
        threads: int = 1,
        executor: Executor | None = None,
    ) -> NDArray[np.bool_]:
        """Whether n rays hit anything, see `DynamicBVH.occluded_many`."""
        given = self._ndim, origins, directions, t_max, mask, skip_inside, threads
        if dask_rows.are_given(executor, origins, directions, t_max, mask):
            (blocked,) = dask_rows.rays(self.occluded_many, (((), np.bool_),), *given)
            return blocked
        return queries.any_hits(self._parts_for(executor), queries.check_rays(*given))

    def overlap_many(
        self,
        lo: ArrayLike,
        hi: ArrayLike,
        mask: ArrayLike = ALL,
        threads: int = 1,
        executor: Executor | None = None,
    ) -> tuple[Ids, Ids]:
        """Overlaps of n query boxes, see `DynamicBVH.overlap_many`: (offsets, ids)."""
        threads = checks.whole('threads', threads, 1)
        if dask_rows.are_given(executor, lo, hi, mask):
            columns = {'lo': lo, 'hi': hi, 'mask': mask}
            return dask_rows.overlap(self.overlap_many, self._ndim, threads, **columns)
        low, high = checks.boxes(lo, hi, self._ndim)
        masks = checks.masks(mask, len(low))
        return queries.overlaps(self._parts_for(executor), low, high, masks, threads)

    def nearest_many(
        self,
        points: ArrayLike,
        k: int = 1,
        max_distance: ArrayLike = np.inf,
        mask: ArrayLike = ALL,
        executor: Executor | None = None,
    ) -> tuple[Ids, Floats]:
        """The k boxes nearest to n points, see `DynamicBVH.nearest_many`: (ids, distances)."""
        k = checks.capacity('k', k)
        if dask_rows.are_given(executor, points, max_distance, mask):
            given = points, max_distance, mask
            return dask_rows.nearest(self.nearest_many, self._ndim, k, *given)
        where = checks.points('points', points, self._ndim)
        reach = checks.limits('max_distance', max_distance, len(where))
        points = queries.Points(where, reach, checks.masks(mask, len(where)))
        return queries.nearest(self._parts_for(executor), points, k)


def _open_again(folder: Path, mark: int) -> Forest:
    """What a pickle stands for; ValueError if another forest is in the folder now."""
    forest = Forest(folder)
    if forest._mark != mark:
        raise ValueError(f'{folder} holds another forest than the one that was pickled')
    return forest
