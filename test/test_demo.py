# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The demo ends by itself, and its table tells who was in the way."""

import re
import signal
import time
import urllib.request
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

import sys

from demos import finished, rows_of, start

from bvh_ros import demo, scenarios


@pytest.mark.slow
def test_recorded_traffic_and_the_warehouse_at_once(shared_data):
    """Two demos in one domain: each sees its own world only."""
    file = shared_data / 'commonroad_ngsim' / 'USA_Peach-4_8_T-1.csv'
    demos = start('--replay', str(file), '--speed', '3'), start('--speed', '4')
    (code, traffic, said), (other_code, warehouse, also_said) = map(finished, demos)
    assert (code, other_code) == (0, 0), said + also_said
    assert len(rows_of(traffic)) >= 6, traffic
    assert any(re.search(r'  (car|truck)/\d', row) for row in rows_of(traffic))
    assert any('  forklift/0' in row for row in rows_of(warehouse))
    assert 'forklift' not in traffic
    assert 'car/' not in warehouse
    assert '0 errors' in traffic
    assert '0 errors' in warehouse


@pytest.mark.parametrize(('how', 'code'), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_the_demo_and_its_node(how, code):
    demo = start()
    assert demo.stdout.readline().startswith('starting the node')
    (node,) = children_of(demo.pid)
    demo.send_signal(how)
    assert finished(demo)[0] == code
    assert not Path(f'/proc/{node}').exists()


def children_of(pid):
    children = Path(f'/proc/{pid}/task/{pid}/children')
    deadline = time.monotonic() + 1000
    while not (found := children.read_text().split()):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return found


def test_every_frame_of_the_warehouse():
    frames = list(scenarios.warehouse())
    assert len(frames) == scenarios.DURATION * scenarios.RATE
    for frame in frames:
        names = [(thing.namespace, thing.number) for thing in frame.things]
        assert len(set(names)) == len(names)


def test_markers_of_things_that_are_gone():
    thing = scenarios.Thing('box', 'a', 1, (1.0, 2.0, 3.0), (1.0, 1.0, 1.0), 0.0)
    add, delete = scenarios.markers([thing], [('a', 2)]).markers
    assert (add.ns, add.id, add.action) == ('a', 1, 0)
    assert (delete.ns, delete.id, delete.action) == ('a', 2, 2)
    assert [one.action for one in scenarios.markers([thing], [], begin=True).markers] == [3, 0]


@pytest.mark.slow
def test_the_demo_with_a_view_says_where_it_is_and_ends_it():
    pytest.importorskip('viser', reason='viser is not installed')
    demo = start('--view')
    line = demo.stdout.readline()
    address = re.fullmatch(r'the view: (http://127\.0\.0\.1:\d+); Ctrl-C ends it\n', line)
    children = children_of(demo.pid)
    with urllib.request.urlopen(address[1]) as page:
        assert b'<html' in page.read(1000)
    demo.send_signal(signal.SIGINT)
    assert finished(demo)[0] == 130
    assert not any(Path(f'/proc/{child}').exists() for child in children)


def test_without_viser_a_line_says_how_to_get_it(monkeypatch, capsys):
    monkeypatch.setattr('importlib.util.find_spec', lambda _name: None)
    monkeypatch.setattr(demo, 'keep_apart', lambda _domain: '')
    assert demo.main(['--view']) == 1
    said = "bvh_demo: the view needs viser: pip install 'bvh_ros[view]'\n"
    assert capsys.readouterr() == ('', said)


def test_a_picture_needs_no_node(tmp_path):
    code, output, _ = finished(start('--picture', str(tmp_path / 'demo.png')))
    assert (code, output) == (0, f'{tmp_path / "demo.png"}\n')
    assert (tmp_path / 'demo.png').read_bytes().startswith(b'\x89PNG')


@pytest.mark.parametrize(
    ('arguments', 'reason'),
    [
        (('--replay', '/nowhere'), 'there is no file or folder'),
        (('--topic', '/a'), '--topic is for bags'),
        (('--domain', '233'), '--domain'),
        (('--speed', '0'), '--speed'),
        (('--speed', 'nan'), '--speed'),
        (('--view', '--picture', 'a.png'), '--picture'),
        (('--picture', '/nowhere/a.png'), '/nowhere/a.png'),
    ],
)
def test_wrong_arguments(capsys, arguments, reason):
    with pytest.raises(SystemExit) as ended:
        sys.exit(demo.main(arguments))
    assert ended.value.code == 2
    assert reason in capsys.readouterr().err
