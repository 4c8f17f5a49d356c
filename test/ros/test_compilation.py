# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Jobs are run where they are compiled, then here; once done they are only run here."""

import io
import os
import time
from functools import partial

import pytest
from ros.patience import PATIENCE

from bvh_ros.ros.compilation import Compilation, Progress
from bvh_ros.ros.compile_jobs import Job, Needs, jobs
from bvh_ros.scene import ShapeKind
from bvh_ros.tree.compiler import kernel_cache

WRITE = 'import os; open({!r}, "a").write(f"{{os.getpid()}} ")'


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path / 'cache'))
    kernel_cache.find_folder.cache_clear()
    yield tmp_path
    kernel_cache.find_folder.cache_clear()


def job(folder, name, *, early=False, seconds=1000.0):
    """One that writes down in which processes it ran; that takes no share of so many seconds."""
    run = partial(exec, WRITE.format(str(folder / name)), {})
    return Job(name, name, seconds, run, early)


def finish(compilation):
    deadline = time.monotonic() + PATIENCE
    while not compilation.is_done:
        compilation.go_on(0.1)
        yield compilation.percent(), compilation.has_begun_to_answer
        assert time.monotonic() < deadline


def processes(folder, name):
    return [int(pid) for pid in (folder / name).read_text().split()]


def test_what_is_compiled_elsewhere_is_run_here_and_next_time_only_here(tmp_path):
    chosen = [job(tmp_path, 'first', early=True), job(tmp_path, 'second'), job(tmp_path, 'third')]
    assert kernel_cache.is_first_use()
    compilation = Compilation(chosen, 1)
    assert (compilation.seconds, compilation.percent()) == (3000.0, 0)
    assert not compilation.has_begun_to_answer
    seen = [*finish(compilation)]
    assert [percent for percent, _ in seen] == sorted(percent for percent, _ in seen)
    assert seen[-1] == (100, True)
    assert (False in {begun for _, begun in seen}) == (seen[0][1] is False)
    for name in ('first', 'second', 'third'):
        elsewhere, here = processes(tmp_path, name)
        assert elsewhere != here == os.getpid()

    assert not kernel_cache.is_first_use()
    again = Compilation(chosen, 1)
    assert again.seconds == 0.0
    assert [*finish(again)][-1] == (100, True)
    assert processes(tmp_path, 'first')[2:] == [os.getpid()]


def test_progress_is_what_the_processor_has_done():
    """On a busy machine a job that waits is not nearly done; one that takes longer than expected
    says so, and that others will.
    """
    wait = Job('wait', 'wait', 25.0, partial(time.sleep, 0.5))
    waiting = Compilation([wait], 1)
    seen = [percent for percent, _ in finish(waiting)]
    assert max(seen[:-1], default=0) < 10
    assert seen[-1] == 100

    burn = 'import time\nwhile time.process_time() < 2.0: pass'
    work = [Job(name, name, 0.5, partial(exec, burn, {})) for name in ('one', 'two')]
    working = Compilation(work, 1)
    left, seen = [], []
    while not working.is_done:
        working.go_on(0.1)
        seen.append(working.percent())
        left.append(working.time_left())
    assert seen == sorted(seen)
    assert max(left) > 1.0  # the second one is as slow as the first
    assert left[-1] == 0.0


def test_where_nothing_can_be_kept_all_is_run_here(tmp_path, recwarn):
    (tmp_path / 'cache').write_text('')  # no folder
    kernel_cache.find_folder.cache_clear()
    assert not kernel_cache.is_first_use()
    assert [*finish(Compilation([job(tmp_path, 'one'), job(tmp_path, 'two')]))]
    assert processes(tmp_path, 'one') == processes(tmp_path, 'two') == [os.getpid()]
    assert 'not kept' in str(recwarn.pop(RuntimeWarning).message)


def test_what_fails_elsewhere_is_tried_here_and_what_fails_here_says_why(tmp_path):
    here = os.getpid()
    code = f'import os; assert os.getpid() == {here}'
    fine = Job('not elsewhere', 'not elsewhere', 1.0, partial(exec, code, {}))
    assert [*finish(Compilation([fine], 1))]
    bad = Job('bad', 'bad', 1.0, partial(int, 'no number'))
    with pytest.raises(ValueError, match='no number'):
        [*finish(Compilation([bad], 1))]


def test_jobs_of_other_configurations_are_other_ones():
    def keys_of(**others):
        usual = {'planar': False, 'margin': 0.0, 'kinds': [ShapeKind.BOX], 'batch': True}
        return [job.key for job in jobs(Needs(**{**usual, **others}))]

    keys = keys_of()
    assert {*keys} == {*keys_of(kinds=(ShapeKind.BOX,))}
    assert {*keys} > {*keys_of(batch=False)}
    for other in ({'planar': True}, {'margin': 0.1}, {'kinds': [ShapeKind.BOX, ShapeKind.MESH]}):
        assert not {*keys} & {*keys_of(**other)}
    assert keys_of(margin=0.1) == keys_of(margin=0.2)


def test_people_see_a_bar_on_a_terminal_and_few_lines_elsewhere(tmp_path):
    said, terminal = [], io.StringIO()
    compilation = Compilation([job(tmp_path, 'trees'), job(tmp_path, 'rays')], 1)
    for progress in (Progress(said.append, terminal), Progress(said.append)):
        progress.begin(compilation)
        progress.show(compilation)
    bar = terminal.getvalue()
    assert '[........................] compiling: 0 %, about ' in bar
    assert 's left (trees)' in bar
    assert [line.partition(',')[0] for line in said] == ['first start here: compiling'] * 2
    assert [*finish(compilation)]
    progress.end(compilation)
    assert said[2].startswith('compiled in ')
