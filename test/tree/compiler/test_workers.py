# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Calls are run in processes of their own, all of them, and nothing is left behind."""

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from bvh_ros.tree.compiler import workers
from bvh_ros.tree.compiler.kernel_files import EntryLock
from bvh_ros.tree.compiler.workers import MOST, Workers, fork_ahead, processors, run_beside

PATIENCE = 1000.0  # seconds: on a loaded machine a worker needs minutes to begin


def results(workers, count):
    found, deadline = {}, time.monotonic() + PATIENCE
    while len(found) < count:
        found.update(workers.ended(1.0))
        assert time.monotonic() < deadline
    return found


def is_running(pid):
    """Whether a process is there, and is no mere name of one that has ended."""
    with contextlib.suppress(OSError):
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    return False


def until(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.parametrize(('count', 'ahead'), [(1, False), (2, False), (0, True)])
@pytest.mark.filterwarnings('ignore:.*fork')
def test_every_call_is_run_or_told_why_not(tmp_path, count, ahead):
    if ahead:
        fork_ahead()
    paths = [tmp_path / str(number) for number in range(5)]
    calls = [partial(os.mkdir, path) for path in paths]
    calls += [partial(os.mkdir, tmp_path), lambda: None, partial(os._exit, 3)]
    found = results(Workers(calls, count), len(calls))
    assert sorted(found) == [*range(8)]
    assert [found[number] for number in range(5)] == [''] * 5
    assert all(path.is_dir() for path in paths)
    assert found[5].startswith('FileExistsError')
    assert 'lambda' in found[6]
    assert found[7] == 'its worker ended'


def test_where_every_worker_ends_the_rest_is_told():
    found = results(Workers([partial(os._exit, 1), partial(os.getpid)], 1), 2)
    assert found == {0: 'its worker ended', 1: 'no worker is left'}


@pytest.mark.filterwarnings('ignore:.*fork')
def test_what_was_imported_here_is_there_in_processes_that_were_forked_ahead(monkeypatch):
    monkeypatch.setattr(workers, 'mark', 'made here', raising=False)
    look = partial(exec, 'from bvh_ros.tree.compiler import workers; workers.mark', {})
    fork_ahead()
    calls = [look] * min(processors(), MOST)
    assert {*results(Workers(calls), len(calls)).values()} == {''}
    [text] = results(Workers([look]), 1).values()  # none is left
    assert text.startswith('AttributeError')


WHO = 'import os, pathlib; pathlib.Path({!r}).write_text(str(os.getpid()))'


@pytest.mark.skipif(processors() == 1, reason='there is nothing to gain')
def test_a_call_beside_has_a_process_that_ends_with_it_and_a_worker_starts_none(tmp_path):
    one, none = (partial(exec, WHO.format(str(tmp_path / name)), {}) for name in 'ab')
    run_beside(one)
    results(Workers([partial(run_beside, none)], 1), 1)
    until(lambda: pids_in(tmp_path))
    [pid] = pids_in(tmp_path)
    assert pid != os.getpid()
    until(lambda: not is_running(pid))
    assert [path.name for path in tmp_path.iterdir()] == ['a']


BUSY = """
import os, pathlib
pathlib.Path({!r}).write_text(str(os.getpid()))
while True:
    pass
"""


def busy(folder, number):
    """A call that never ends, and first writes down who runs it."""
    return partial(exec, BUSY.format(str(folder / str(number))), {})


def pids_in(folder):
    return [int(text) for path in folder.iterdir() if (text := path.read_text())]


@pytest.mark.parametrize('ahead', [False, True])
@pytest.mark.filterwarnings('ignore:.*fork')
def test_ending_ends_all_at_once(tmp_path, ahead):
    if ahead:
        fork_ahead()
    workers = Workers([busy(tmp_path, number) for number in range(3)], 2)
    until(lambda: len(pids_in(tmp_path)) == 2)
    workers.end()
    assert not workers.running
    assert not any(map(is_running, pids_in(tmp_path)))


PARENT = """
import pickle, sys, time
from bvh_ros.tree.compiler.workers import Workers, fork_ahead

if len(sys.argv) > 1:
    fork_ahead()
workers = Workers(pickle.load(sys.stdin.buffer), 2)
time.sleep(3600)
"""


@pytest.mark.parametrize('ahead', [[], ['ahead']])
@pytest.mark.parametrize('how', [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_worker_outlives_who_started_it(tmp_path, how, ahead):
    command = [sys.executable, '-c', PARENT, *ahead]
    parent = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL)
    with parent.stdin as given:
        given.write(pickle.dumps([busy(tmp_path, 0), busy(tmp_path, 1)]))
    until(lambda: len(pids_in(tmp_path)) == 2)
    pids = pids_in(tmp_path)
    assert all(map(is_running, pids))
    parent.send_signal(how)
    parent.wait(PATIENCE)
    until(lambda: not any(map(is_running, pids)))


HOLD = """
import sys, time
from pathlib import Path
from bvh_ros.tree.compiler.kernel_files import EntryLock

sleep = time.sleep

def wait(seconds):
    print('waits', flush=True)
    sleep(seconds)

time.sleep = wait
lock = EntryLock()
print(lock.acquire(Path(sys.argv[1]), 'this'), flush=True)
part = EntryLock()  # of what is compiled meanwhile
part.acquire(Path(sys.argv[1]), 'a part')
part.release()
print('still held', flush=True)
sleep(3600)
"""


@pytest.mark.skipif(sys.platform == 'win32', reason='no locks')
def test_who_wants_the_same_waits_until_its_holder_has_ended(tmp_path):
    def start():
        command = [sys.executable, '-c', HOLD, str(tmp_path)]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    processes = [start()]
    try:
        said = [processes[0].stdout.readline() for _ in range(2)]
        assert said == ['False\n', 'still held\n']
        mine = EntryLock()
        assert not mine.acquire(tmp_path, 'that')
        mine.release()
        processes.append(start())
        assert processes[1].stdout.readline() == 'waits\n'
        processes[0].kill()
        assert next(line for line in processes[1].stdout if line != 'waits\n') == 'True\n'
    finally:
        for process in processes:
            process.kill()
            process.wait()
            process.stdout.close()
