# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report's quick form runs and writes what it promises. Timings depend on the machine."""

import csv
import subprocess
import sys

import pytest

pytest.importorskip('matplotlib')

pytestmark = pytest.mark.slow

PARTS = 'error', 'features', 'peers', 'planner', 'speed', 'stability'
REPORT = 'import sys; from bvh_ros.commands import bvh_report; sys.exit(bvh_report())'


def report(*arguments, code=0):
    """Run `bvh_report` and return its errors.

    Apart: it begins ROS by itself, which other tests may have begun here.
    """
    command = [sys.executable, '-c', REPORT, *map(str, arguments)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == code, ended.stderr
    return ended.stderr


@pytest.fixture(scope='module', params=PARTS)
def written(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    report(request.param, '--quick', '--out', folder)
    return folder


def test_page_shows_every_table_and_plot(written):
    page = (written / 'report.md').read_text(encoding='utf-8')
    assert page.startswith('# bvh_ros: report')
    assert '| ---' in page
    for picture in written.glob('*.png'):
        assert f'({picture.name})' in page
        assert picture.read_bytes().startswith(b'\x89PNG')


def test_tables_are_rectangular_and_filled(written):
    tables = list(written.glob('*.csv'))
    assert tables
    for path in tables:
        header, *rows = csv.reader(path.open(encoding='utf-8'))
        assert rows, path
        assert {len(row) for row in rows} == {len(header)}, path


def test_parts_of_several_runs_share_a_page(tmp_path):
    pages = []
    for part in ('stability', 'planner', 'stability'):
        report(part, '--quick', '--out', tmp_path)
        lines = (tmp_path / 'report.md').read_text(encoding='utf-8').splitlines()
        pages.append([line for line in lines if line.startswith('#')])
    (title, *stability), (_, *both), again = pages
    assert title == '# bvh_ros: report'
    assert stability[0] == '## Stability'
    assert both[0] == '## Planner'
    assert both[-len(stability) :] == stability
    assert len(both) > 1 + len(stability)
    assert again == [title, *both]


def test_an_unknown_part_is_refused(tmp_path):
    usage = report('guess', '--out', tmp_path, code=2)
    assert f'{{{",".join((*PARTS, "all"))}}}' in usage


def test_a_folder_of_recordings_must_be_there(tmp_path):
    said = report('error', '--data', tmp_path / 'nowhere', code=2)
    assert f'--data {tmp_path}/nowhere: there is no such folder' in said
