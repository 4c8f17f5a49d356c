# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The report's quick form runs and writes what it promises. Timings depend on the machine."""

import csv
import subprocess
import sys

import pytest

pytest.importorskip('matplotlib')

from bvh_ros.report import cli
from bvh_ros.report.page import Page

pytestmark = pytest.mark.slow


@pytest.fixture(scope='module', params=sorted(cli.PARTS))
def written(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    arguments = [request.param, '--quick', '--out', str(folder)]
    # Apart: it begins ROS by itself, which other tests may have begun here.
    program = f'from bvh_ros.report import cli; cli.main({arguments})'
    subprocess.run([sys.executable, '-c', program], check=True)
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
    for part in ('stability', 'planner', 'stability'):
        page = Page(tmp_path)
        page.begin(part.title(), 'Text.')
        page.add(f'### More of {part}')
        page.write()
    text = (tmp_path / 'report.md').read_text(encoding='utf-8')
    headings = [line for line in text.splitlines() if line.startswith('#')]
    assert headings == [
        '# bvh_ros: report', '## Planner', '### More of planner', '## Stability',
        '### More of stability',
    ]  # fmt: skip


def test_an_unknown_part_is_refused(tmp_path):
    with pytest.raises(SystemExit):
        cli.main(['guess', '--out', str(tmp_path)])


def test_a_folder_of_recordings_must_be_there(tmp_path, capsys):
    with pytest.raises(SystemExit):
        cli.main(['error', '--data', str(tmp_path / 'nowhere')])
    assert f'--data {tmp_path}/nowhere: there is no such folder' in capsys.readouterr().err
