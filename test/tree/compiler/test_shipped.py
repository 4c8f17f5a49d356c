# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Machine code that was compiled before the first start is used if it fits, and else not."""

import json
import os
import subprocess
import warnings

import numpy as np
import pytest
from numba.core import config
from tree.compiler.alone import run_alone

from bvh_ros.tree.access import checks
from bvh_ros.tree.compiler import kernel_cache, lean_kernel, shipped

CALL = """
import json, sys, warnings
import numpy as np
from bvh_ros.tree import checks

with warnings.catch_warnings(record=True) as said:
    assert checks.first_not_finite(np.array([[0.0, 1.0], [2.0, np.nan]])) == 1
kernel = checks.first_not_finite
if sys.argv[1:] == ['ship']:
    from bvh_ros.tree.compiler import kernel_cache
    kernel_cache.note('a job')
    kernel_cache.ship()
from bvh_ros.tree.compiler import kernel_cache
print(json.dumps([
    sum(kernel.stats.cache_misses.values()),
    kernel_cache.is_noted('a job'),
    [str(warning.message) for warning in said],
]))
"""
LEVEL = 'x86-64-v3'
ROWS = np.array([[0.0, 1.0], [2.0, np.nan]])
NOT_HERE = shipped.missing_features(shipped.LEVELS[LEVEL])

pytestmark = pytest.mark.skipif(bool(NOT_HERE), reason=f'no {LEVEL} processor: {NOT_HERE}')


def run(*arguments, **environment):
    ended = run_alone(CALL, *arguments, **environment)
    return json.loads(ended.stdout)


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    """What `bvh_warm_up --cpu x86-64-v3` leaves, of one small kernel."""
    place = tmp_path_factory.mktemp('shipped')
    misses, *_ = run(
        'ship',
        NUMBA_CACHE_DIR=str(place),
        BVH_ROS_KERNELS='',
        NUMBA_CPU_NAME=LEVEL,
        NUMBA_CPU_FEATURES='',
    )
    assert misses == 1
    return place


def folder_of(place):
    (manifest,) = place.glob(f'bvh_ros/*/{shipped.MANIFEST}')
    return manifest.parent


def test_a_start_compiles_nothing_and_writes_nothing(made, tmp_path):
    """Also where numba is told the name of another processor of this level."""
    own = tmp_path / 'own'
    before = {path: path.stat().st_mtime_ns for path in made.rglob('*')}
    found = run(NUMBA_CACHE_DIR=str(own), BVH_ROS_KERNELS=str(made), NUMBA_CPU_NAME='znver3')
    assert found == [0, True, []]
    assert not own.exists()
    assert {path: path.stat().st_mtime_ns for path in made.rglob('*')} == before


@pytest.fixture
def start_from(tmp_path, monkeypatch):
    """What is a new start to numba: from this place, how many kernels were compiled, and why."""

    def start(place):
        monkeypatch.setenv(shipped.VARIABLE, str(place))
        monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path / 'own'))
        forget()
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter('always')
            kernel = lean_kernel(checks.first_not_finite.py_func)
            assert kernel(ROWS) == 1
        return sum(kernel.stats.cache_misses.values()), [str(line.message) for line in said]

    yield start
    forget()


def forget():
    shipped.find.cache_clear()
    kernel_cache.find_folder.cache_clear()


def test_all_may_read_it_and_only_its_maker_writes(made):
    for path in (folder_of(made).parent, folder_of(made), *folder_of(made).iterdir()):
        assert path.stat().st_mode & 0o777 == (0o755 if path.is_dir() else 0o644), path


def edited(place, made, **changes):
    """A copy whose manifest says something else."""
    subprocess.run(['cp', '-a', made / 'bvh_ros', place], check=True)
    manifest = folder_of(place) / shipped.MANIFEST
    manifest.write_text(json.dumps({**json.loads(manifest.read_text()), **changes}))
    return place


@pytest.mark.parametrize(
    ('changes', 'reason'),
    [
        ({'Python': 'cpython-27'}, 'other Python'),
        ({'sources': 'older'}, 'other sources'),
        ({'numba, llvmlite and their settings': ['0.1']}, 'other numba, llvmlite'),
        ({'features': ['avx', 'of-some-day']}, 'this processor has no of-some-day'),
        ({'codegen': 7}, 'cannot be read'),
        ({'features': None}, 'cannot be read'),
    ],
)
def test_what_does_not_fit_is_compiled_with_one_line_why(
    made, tmp_path, start_from, changes, reason
):
    place = edited(tmp_path, made, **changes)
    misses, (line,) = start_from(place)
    assert misses == 1
    assert reason in line
    assert str(place) in line


def test_settings_that_change_code_do_not_fit(made, monkeypatch, start_from):
    assert start_from(made) == (0, [])
    monkeypatch.setattr(config, 'OPT', 1)
    misses, (line,) = start_from(made)
    assert (misses, 'other numba, llvmlite and their settings' in line) == (1, True)


def test_a_named_folder_without_kernels_is_said_and_an_empty_name_is_none(tmp_path, start_from):
    misses, (line,) = start_from(tmp_path / 'no')
    assert (misses, 'there are none' in line) == (1, True)
    assert start_from('') == (0, [])


@pytest.mark.parametrize('how', ['link', 'group', 'world', 'other owner'])
def test_an_unsafe_folder_is_not_used(made, tmp_path, start_from, how):
    place = edited(tmp_path, made)
    folder = folder_of(place)
    if how == 'link':
        folder.rename(tmp_path / 'elsewhere')
        folder.symlink_to(tmp_path / 'elsewhere')
    elif how == 'other owner':
        if os.geteuid() != 0:
            pytest.skip('only root can give a folder away')
        os.chown(folder, 20001, -1)
    else:
        folder.chmod(0o775 if how == 'group' else 0o757)
    misses, (line,) = start_from(place)
    assert misses == 1
    assert 'is a link' in line or 'may write there' in line


@pytest.mark.parametrize('how', ['damaged', 'writable', 'other owner'])
def test_an_unsafe_file_is_not_used(made, tmp_path, start_from, how):
    place = edited(tmp_path, made)
    (file,) = folder_of(place).glob('*.nbc')
    if how == 'damaged':
        file.write_bytes(file.read_bytes()[:-1] + b'\0\0')
    elif how == 'writable':
        file.chmod(0o646)
    elif os.geteuid() == 0:
        os.chown(file, 20001, -1)
    else:
        pytest.skip('only root can give a file away')
    assert start_from(place) == (1, [])


@pytest.mark.skipif(os.geteuid() != 0, reason='only root can ship for others')
def test_what_root_shipped_serves_every_user(made, monkeypatch, start_from):
    monkeypatch.setattr(os, 'geteuid', lambda: 20001)
    assert start_from(made) == (0, [])


def test_of_what_fits_the_most_demanding_is_used(made, tmp_path, start_from):
    place = edited(tmp_path, made)
    best = folder_of(place)
    less = best.with_name('less')
    subprocess.run(['cp', '-a', best, less], check=True)
    content = json.loads((best / shipped.MANIFEST).read_text())
    content['features'] = content['features'][:3]
    (less / shipped.MANIFEST).write_text(json.dumps(content))
    assert start_from(place) == (0, [])
    assert shipped.find(kernel_cache.settings()).folder == best


def test_the_folder_inside_the_package_is_found_without_a_name(made, monkeypatch):
    monkeypatch.delenv(shipped.VARIABLE, raising=False)
    monkeypatch.setattr(shipped, 'IN_PACKAGE', made)
    shipped.find.cache_clear()
    assert shipped.find(kernel_cache.settings()).folder == folder_of(made)
    shipped.find.cache_clear()
