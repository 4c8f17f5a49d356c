# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The same answers from processes, a Dask cluster, and one that loses a worker meanwhile."""

import multiprocessing
import os
import signal
import threading
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from bvh_ros import DynamicBVH
from bvh_ros.forest import Forest

TIMEOUT = 2000  # seconds: a worker that begins anew needs minutes on a loaded machine
KILLS = 3  # more would be more than a loaded machine can bear


@pytest.fixture(scope='module')
def world(tmp_path_factory):
    """A forest of 16 parts, the tree of all boxes, and rays."""
    rng = np.random.default_rng(8)
    lo = rng.uniform(0, 60, (8000, 3))
    forest = Forest.build(tmp_path_factory.mktemp('forest') / 'boxes', [(lo, lo + 1)], 600)
    tree = DynamicBVH.from_boxes(lo, lo + 1)
    return forest, tree, rng.uniform(0, 60, (5000, 3)), rng.normal(size=(5000, 3))


def check(world: Any, executor: Executor) -> None:
    forest, tree, origins, directions = world
    hits = forest.raycast_many(origins, directions, executor=executor)
    wanted = tree.raycast_many(origins, directions)
    ids = np.where(wanted.ids < 0, -1, np.searchsorted(tree.ids(), wanted.ids))
    np.testing.assert_array_equal(hits.ids, ids)
    np.testing.assert_array_equal(hits.t, wanted.t)
    np.testing.assert_array_equal(
        forest.occluded_many(origins, directions, 9.0, executor=executor),
        tree.occluded_many(origins, directions, 9.0),
    )
    offsets, ids = forest.overlap_many(origins, origins + 2, executor=executor)
    counts, handles = tree.overlap_many(origins, origins + 2)
    np.testing.assert_array_equal(offsets, counts)
    np.testing.assert_array_equal(ids, np.searchsorted(tree.ids(), handles))
    distances = forest.nearest_many(origins, 3, executor=executor)[1]
    np.testing.assert_array_equal(distances, tree.nearest_many(origins, 3)[1])


@pytest.mark.slow
def test_threads_and_processes(world):
    with ThreadPoolExecutor(4) as executor:
        check(world, executor)
    spawn = multiprocessing.get_context('spawn')
    with ProcessPoolExecutor(2, mp_context=spawn) as executor:
        check(world, executor)


class Failing(Executor):
    """Fails from the third task on."""

    def __init__(self) -> None:
        self.futures: list[Future[Any]] = []

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.futures.append(future)
        if len(self.futures) >= 3:
            future.set_exception(OSError('the disk is gone'))
        return future


def test_an_error_of_a_worker_is_raised_and_the_rest_is_called_off(world):
    forest, _, origins, directions = world
    executor = Failing()
    with pytest.raises(OSError, match='the disk is gone'):
        forest.raycast_many(origins, directions, executor=executor)
    with pytest.raises(ValueError, match='executor must have'):
        forest.raycast_many(origins, directions, executor=5)  # type: ignore[arg-type]
    assert all(future.done() for future in executor.futures)


class Losing(ThreadPoolExecutor):
    """Loses each answer once, as Dask may where a worker is killed."""

    def __init__(self) -> None:
        super().__init__(2)
        self.told: set[Any] = set()

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        task = tuple(repr(argument) for argument in args)
        if task in self.told:
            return super().submit(fn, *args, **kwargs)
        self.told.add(task)
        future: Future[Any] = Future()
        future.set_exception(ValueError('too many values to unpack (expected 3)'))
        return future


def test_what_an_executor_loses_is_asked_again(world):
    with Losing() as executor:
        check(world, executor)
        assert executor.told


@pytest.fixture(scope='module')
def cluster():
    distributed = pytest.importorskip('distributed', reason='extra [cluster] is not installed')
    import dask

    with (
        dask.config.set({'distributed.scheduler.allowed-failures': 10}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as local,
        distributed.Client(local) as client,
    ):
        yield client


@pytest.mark.slow
def test_a_dask_cluster(world, cluster):
    check(world, cluster.get_executor(pure=False))


@pytest.mark.slow
def test_a_worker_that_is_killed_in_the_middle_changes_no_answer(world, cluster):
    executor = cluster.get_executor(pure=False)
    stop, killed = threading.Event(), []
    nannies = [*cluster.cluster.workers.values()]

    def is_up(dask_worker) -> bool:
        return dask_worker.status.name == 'running'

    def kill() -> None:
        while len(killed) < KILLS and not stop.wait(0.4):
            if any(nanny.status.name in ('closed', 'failed') for nanny in nannies):
                return  # it has given up: the new worker did not come in time, on a loaded machine
            # It gives up, too, if that is killed before it is up.
            up = cluster.run(is_up, nanny=True, on_error='ignore').values()
            told = cluster.run(os.getpid, on_error='ignore').values()
            pids = [pid for pid in told if isinstance(pid, int)]
            if len(pids) == 2 == sum(known is True for known in up):
                os.kill(pids[0], signal.SIGKILL)
                killed.append(pids[0])

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        deadline = time.monotonic() + TIMEOUT
        while killer.is_alive():
            check(world, executor)
            assert time.monotonic() < deadline
    finally:
        stop.set()
        killer.join()
    check(world, executor)
    assert killed


@pytest.mark.slow
def test_dask_arrays_in_and_out(world, cluster):
    da = pytest.importorskip('dask.array', reason='extra [cluster] is not installed')
    forest, _, origins, directions = world
    rows = da.from_array(origins, chunks=(1700, 2)), da.from_array(directions, chunks=(900, 3))
    reach = da.from_array(np.linspace(0, 30, len(origins)), chunks=1000)
    hits = forest.raycast_many(*rows, reach, mask=3)
    wanted = forest.raycast_many(origins, directions, np.linspace(0, 30, len(origins)), mask=3)
    for lazy, known in zip(hits, wanted, strict=True):
        assert (lazy.shape, lazy.dtype) == (known.shape, known.dtype)
        np.testing.assert_array_equal(lazy.compute(), known)
    near = forest.nearest_many(rows[0], 2, max_distance=4.0)
    for lazy, known in zip(near, forest.nearest_many(origins, 2, 4.0), strict=True):
        np.testing.assert_array_equal(lazy.compute(), known)
    blocked = forest.occluded_many(rows[0], directions, 2.0)
    np.testing.assert_array_equal(
        blocked.compute(), forest.occluded_many(origins, directions, 2.0)
    )
    found = forest.overlap_many(rows[0], rows[0] + 1)
    for lazy, known in zip(found, forest.overlap_many(origins, origins + 1), strict=True):
        np.testing.assert_array_equal(lazy.compute(), known)


@pytest.mark.slow
def test_dask_arrays_that_do_not_fit_are_refused_at_once(world):
    da = pytest.importorskip('dask.array', reason='extra [cluster] is not installed')
    forest, _, origins, directions = world
    at, ways = da.from_array(origins, chunks=999), da.from_array(directions, chunks=999)
    refused: list[tuple[Any, str]] = [
        (lambda: forest.raycast_many(at, ways[:-1]), 'directions'),
        (lambda: forest.raycast_many(at[:, 0], ways), 'origins'),
        (lambda: forest.occluded_many(at[:, :2], ways), 'origins'),
        (lambda: forest.raycast_many(at, ways, at), 't_max'),
        (lambda: forest.nearest_many(at[at[:, 0] > 30]), 'unknown size'),
        (lambda: forest.nearest_many(at, 0), 'k must'),
        (lambda: forest.overlap_many(at, at, threads=0), 'threads'),
        (lambda: forest.raycast_many(at, ways, executor=ThreadPoolExecutor(1)), 'executor'),
    ]
    for ask, why in refused:
        with pytest.raises(ValueError, match=why):
            ask()
    with_none = da.concatenate([at[:0], at[:50], at[:0]])
    found = forest.overlap_many(with_none, with_none + 1, da.asarray(1))
    for lazy, known in zip(
        found, forest.overlap_many(origins[:50], origins[:50] + 1), strict=True
    ):
        np.testing.assert_array_equal(lazy.compute(scheduler='synchronous'), known)
