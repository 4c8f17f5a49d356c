# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Machine code that is not exactly what was written, by this user, is never run."""

import errno
import os
import pickle
import random
import re
import shutil
import subprocess
import sys

import llvmlite.binding as llvm
import numpy as np
import pytest
from numba.core import config
from numba.core.registry import cpu_target
from tree.compiler.alone import run_alone

from bvh_ros.tree import checks
from bvh_ros.tree.compiler import compiling, kernel_cache, kernel_files, shipped

ROWS = np.array([[0.0, 1.0], [2.0, np.nan]])


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache folder for this process."""
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path))
    kernel_cache.find_folder.cache_clear()
    monkeypatch.setattr(kernel_files.SealedFiles, 'warned', False)
    yield tmp_path / 'bvh_ros'
    kernel_cache.find_folder.cache_clear()


def misses(function=checks.first_not_finite.py_func):
    """How often this kernel is compiled in what is a new process to numba, and that it works."""
    kernel = compiling.lean_kernel(function)
    assert kernel(ROWS) == 1
    return sum(kernel.stats.cache_misses.values())


def kept_files(cache):
    return sorted(cache.rglob('*.nbc'))


@pytest.mark.parametrize(
    ('setting', 'value'),
    [
        ('BOUNDSCHECK', 1),
        ('CPU_NAME', 'generic'),
        ('CPU_FEATURES', ''),
        ('OPT', 0),
        ('DEBUGINFO_DEFAULT', 1),
        ('ENABLE_AVX', False),
        ('LOOP_VECTORIZE', 0),
        ('SLP_VECTORIZE', 1),
        ('DISABLE_INTEL_SVML', True),
        ('LLVM_REFPRUNE_PASS', 0),
        ('A_SETTING_OF_SOME_DAY', 1),
    ],
)
def test_settings_that_change_code_are_another_folder(cache, monkeypatch, setting, value):
    monkeypatch.setattr(config, 'BOUNDSCHECK', None)  # whatever these tests are run with
    folder = kernel_cache.cache_folder()
    monkeypatch.setattr(config, setting, value, raising=False)
    assert kernel_cache.cache_folder() != folder


def test_settings_that_leave_code_as_it_is_share_it(cache, monkeypatch):
    folder = kernel_cache.cache_folder()
    for setting in ('CACHE_DIR', 'DEBUG_CACHE', 'NUMBA_NUM_THREADS', 'THREADING_LAYER'):
        monkeypatch.setattr(config, setting, 'other')
        assert kernel_cache.cache_folder() == folder, setting


@pytest.mark.skipif(bool(config.BOUNDSCHECK), reason='here all code is checked')
def test_checked_code_is_not_taken_for_unchecked(cache, monkeypatch):
    """The second slot is written behind its array's end, to memory that is there."""
    handles, slots = np.arange(2), np.zeros(2, np.int64)
    asked = handles, handles, np.zeros(0, np.bool_), slots[:1]
    function = checks.fill_slots.py_func
    assert compiling.kernel(function)(*asked) == (-1, 0)
    assert slots[1] == 1
    monkeypatch.setattr(config, 'BOUNDSCHECK', 1)
    with pytest.raises(IndexError):
        compiling.kernel(function)(*asked)
    monkeypatch.setattr(config, 'BOUNDSCHECK', None)
    assert compiling.kernel(function)(*asked) == (-1, 0)


def damaged(whole, random_bytes, other):
    """What may lie there in the place of a whole file."""
    middle = len(whole) // 2
    yield from (whole[:length] for length in (0, 1, 31, 32, 33, middle, len(whole) - 1))
    yield whole + b'\0'
    yield bytes(len(whole))
    yield random_bytes(len(whole))
    yield other
    for place in (0, 40, middle, len(whole) - 2):
        yield whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :]


def test_a_damaged_file_is_compiled_again(cache):
    assert (misses(), misses()) == (1, 0)
    (file,) = kept_files(cache)
    whole = file.read_bytes()
    for bad in damaged(whole, random.Random(3).randbytes, b'\x80\x04N.'):
        file.write_bytes(bad)
        assert (misses(), misses()) == (1, 0), bad[:40]
        assert kept_files(cache) == [file]


def test_what_was_not_written_to_its_end_is_removed(cache):
    misses()
    (file,) = kept_files(cache)
    abandoned, begun = (file.with_name(name + shipped.DRAFT) for name in 'ab')
    for draft in abandoned, begun:
        draft.touch()
    os.utime(abandoned, (0.0, 0.0))
    kernel_cache.find_folder.cache_clear()
    assert misses() == 0
    assert (abandoned.exists(), begun.exists()) == (False, True)


def test_what_machine_code_was_made_from_is_not_kept(cache):
    """A second process runs it all the same, see `test_kernel_cache`."""
    assert misses() == 1
    [path] = kept_files(cache)
    (_, _, (code, bitcode)), *_ = pickle.loads(path.read_bytes()[kernel_files.SEAL :])
    module = llvm.parse_bitcode(bitcode)
    bodies = [[*block.instructions] for f in module.functions for block in f.blocks]
    assert [len(body) for body in bodies] == [1] * len(bodies)
    assert len(bodies) >= 2  # the kernel, and how Python calls it
    assert code


def test_a_part_is_kept_that_only_names_an_address():
    """As numba does of a function that is handed over, twice if it is handed over twice; one that
    reads there is of one process.
    """
    word = '@numba.dynamic.globals.7f = global i64 5\n'
    again = '@numba.dynamic.globals.7f.1 = global i64 5\n'
    read = '%x = load i64, ptr @numba.dynamic.globals.7f{}\nret i64 %x'
    for words, body, reads in (
        (word, 'ret i64 1', False),
        (word, read.format(''), True),
        (word + again, 'ret i64 1', False),
        (word + again, read.format('.1'), True),
    ):
        code = llvm.parse_assembly(f'{words}define i64 @part() {{ {body} }}').as_bitcode()
        generator = cpu_target.target_context.codegen()
        assert (
            kernel_files.PartCode.of_bitcode(generator, 'part', code).has_dynamic_globals is reads
        )


def test_another_file_under_a_kernels_name_is_compiled_again(cache):
    """Another kernel's, another version's, a folder, a link to nothing, one that is not ours."""
    compiling.lean_kernel(checks.first_no_box.py_func)(ROWS, ROWS)
    (other,) = kept_files(cache)
    misses()
    (file,) = {*kept_files(cache)} - {other}
    shutil.copy(other, file)
    assert (misses(), misses()) == (1, 0)
    (cache / 'old').mkdir()
    old = kernel_files.SealedFiles.seal_of(cache / 'old' / file.name, file.read_bytes()[32:])
    file.write_bytes(old + file.read_bytes()[32:])
    assert (misses(), misses()) == (1, 0)
    file.unlink()
    file.symlink_to('nothing')
    assert (misses(), misses()) == (1, 0)
    file.chmod(0o666)
    assert (misses(), misses()) == (1, 0)
    file.unlink()
    file.mkdir()
    with pytest.warns(RuntimeWarning, match='not kept'):
        assert misses() == 1


class Raising:
    """Whole, but made by another version of what it needs: unpickled, it raises."""

    def __init__(self, error):
        self.error = error

    def __reduce__(self):
        return _raise, (self.error,)


def _raise(error):
    raise error


@pytest.mark.parametrize(
    'error', [AttributeError, EOFError, ImportError, KeyError, MemoryError, TypeError, ValueError]
)
def test_what_no_longer_unpickles_is_compiled_again(cache, error):
    misses()
    (file,) = kept_files(cache)
    content = pickle.dumps(Raising(error))
    file.write_bytes(kernel_files.SealedFiles.seal_of(file, content) + content)
    assert (misses(), misses()) == (1, 0)


NO_SPACE = """
import resource, sys
import numpy as np
from bvh_ros.tree import checks

resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), -1))
rows = np.array([[0.0, 1.0], [2.0, np.nan]])
assert checks.first_not_finite(rows) == 1
assert checks.first_no_box(rows, rows - [0.0, 1.0]) == 0
"""


def test_on_a_full_disk_kernels_are_compiled_in_memory_with_one_warning(tmp_path):
    """Files that end after some bytes are as good as a disk that does; none is left behind."""
    ended = run_alone(NO_SPACE, '1000', NUMBA_CACHE_DIR=str(tmp_path))
    assert ended.stderr.count('RuntimeWarning') == 1, ended.stderr
    assert 'not kept: [Errno 27]' in ended.stderr
    assert not [path for path in tmp_path.rglob('*') if path.is_file() and path.stat().st_size]
    assert run_alone(NO_SPACE, '-1', NUMBA_CACHE_DIR=str(tmp_path)).stderr == ''


def test_a_disk_without_room_for_a_name(cache, monkeypatch):
    def full(*_args, **_options):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(shipped.tempfile, 'mkstemp', full)
    with pytest.warns(RuntimeWarning, match='No space left') as said:
        assert (misses(), misses()) == (1, 1)
    assert len(said) == 1
    monkeypatch.setattr(shipped.tempfile, 'TemporaryFile', full)
    monkeypatch.setattr(kernel_cache.tempfile, 'gettempdir', full)
    monkeypatch.delenv('NUMBA_CACHE_DIR')
    monkeypatch.setenv('XDG_CACHE_HOME', str(cache))
    kernel_cache.find_folder.cache_clear()
    with pytest.warns(RuntimeWarning, match='No space left') as said:
        assert (misses(), misses()) == (1, 1)
    assert len(said) == 1


def test_two_processes_compile_the_same_at_once(tmp_path):
    """Neither fails, and what they leave behind is whole."""
    command = [sys.executable, '-W', 'error', '-c', NO_SPACE, '-1']
    environment = {**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path)}
    processes = [
        subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    for process in processes:
        assert (process.communicate(timeout=1500)[1], process.returncode) == ('', 0)
    for file in kept_files(tmp_path):
        content = file.read_bytes()
        assert content[:32] == kernel_files.SealedFiles.seal_of(file, content[32:])


def test_the_folder_is_ours_alone(cache):
    umask = os.umask(0)
    try:
        misses()
    finally:
        os.umask(umask)
    for path in (cache, *cache.rglob('*')):
        assert path.stat().st_mode & 0o777 == (0o700 if path.is_dir() else 0o600), path


def make_unsafe(path, how):
    path.chmod(0o700)
    if how == 'link':
        path.rename(path.with_name('elsewhere'))
        path.symlink_to(path.with_name('elsewhere'))
    else:
        path.chmod(0o720 if how == 'group' else 0o702)


@pytest.mark.parametrize('part', ['own', 'hash'])
@pytest.mark.parametrize('how', ['link', 'group', 'world', 'owner'])
def test_an_unsafe_folder_is_not_used(cache, monkeypatch, part, how):
    misses()
    folder = kernel_cache.cache_folder()
    unsafe = cache if part == 'own' else folder
    if how != 'owner':
        make_unsafe(unsafe, how)
    elif os.geteuid() == 0:
        os.chown(unsafe, 20001, -1)
    else:
        monkeypatch.setattr(os, 'geteuid', lambda: 20001)
    kernel_cache.find_folder.cache_clear()
    with pytest.warns(RuntimeWarning, match=re.escape(f'not kept: {unsafe}')) as said:
        assert (misses(), misses()) == (1, 1)
    assert len(said) == 1
    # Where nobody named the folder, another one is found, and said.
    monkeypatch.setattr(os, 'geteuid', os.getuid)
    monkeypatch.delenv('NUMBA_CACHE_DIR')
    monkeypatch.setenv('XDG_CACHE_HOME', str(cache.parent))
    spare = cache.parent / 'spare'
    spare.mkdir()
    monkeypatch.setattr(kernel_cache.tempfile, 'gettempdir', lambda: str(spare))
    if how == 'owner' and os.getuid():
        return
    kernel_cache.find_folder.cache_clear()
    with pytest.warns(RuntimeWarning, match=re.escape(f'kept in {spare}/bvh_ros-{os.getuid()}')):
        assert (misses(), misses()) == (1, 0)


def test_a_file_where_the_folder_should_be(cache, recwarn):
    cache.write_text('')
    assert kernel_cache.cache_folder() is None
    assert 'not kept' in str(recwarn.pop(RuntimeWarning).message)
    assert misses() == 1


def test_a_user_without_a_home_leaves_no_folder_in_the_working_one(tmp_path, monkeypatch, cache):
    for name in ('NUMBA_CACHE_DIR', 'XDG_CACHE_HOME'):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os.path, 'expanduser', lambda path: path)
    monkeypatch.setattr(kernel_cache.tempfile, 'gettempdir', lambda: str(tmp_path))
    monkeypatch.chdir(tmp_path)
    folder = kernel_cache.cache_folder()
    assert folder.parent.name == f'bvh_ros-{os.geteuid()}'
    assert [path.name for path in tmp_path.iterdir()] == [folder.parent.name]
