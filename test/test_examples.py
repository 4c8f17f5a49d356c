# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every script in examples/ runs as a user runs it, says first what it shows, and ends with a
result; where something that it needs is missing, it ends at once with exit code 2.
"""

import ast
import os
import runpy
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parent.parent / 'examples'
SCRIPTS = sorted({file.name for file in EXAMPLES.glob('*.py')} - {'needs.py'})
# Runs a script where a module is missing.
WITHOUT = """
import runpy, sys
missing, script, *sys.argv[1:] = sys.argv[1:]
sys.modules[missing] = None
sys.path.insert(0, script.rpartition('/')[0])
runpy.run_path(script, run_name='__main__')
"""


def python(*arguments):
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        timeout=1500,  # seconds: what an example compiles first takes minutes on a loaded machine
        check=False,
    )


def run(name, *arguments):
    done = python(str(EXAMPLES / name), *arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_guide_lists_every_script():
    guide = (EXAMPLES.parent / 'docs' / 'guide.md').read_text('utf-8')
    assert [name for name in SCRIPTS if f'| `examples/{name}` |' not in guide] == []


@pytest.fixture
def ended(monkeypatch, capsys):
    """Run a script in this process that ends at once: its exit code, and what it says."""

    def end(name, *arguments):
        monkeypatch.syspath_prepend(EXAMPLES)
        monkeypatch.setattr(sys, 'argv', [name, *arguments])
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(str(EXAMPLES / name), run_name='__main__')
        return (ended.value.code, *capsys.readouterr())

    return end


@pytest.mark.parametrize('name', SCRIPTS)
def test_help_is_the_docstring(ended, name):
    pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)
    pytest.importorskip('distributed', reason='extra [cluster] is not installed')
    pytest.importorskip('rosbags', reason='rosbags is not installed')
    text = ast.get_docstring(ast.parse((EXAMPLES / name).read_text('utf-8')))
    code, said, _ = ended(name, '--help')
    assert code == 0
    assert text in said


@pytest.mark.parametrize(
    ('name', 'first', 'last'),
    [
        ('tree_alone.py', 'A tree of 10,000 boxes', 'pairs of boxes touch each other.'),
        pytest.param(
            *('moving_boxes.py', '1,000 robots drive', 'answers would be wrong'),
            marks=pytest.mark.slow,
        ),
        ('virtual_lidar.py', 'A lidar of 64 rings', ' is nearest: '),
        ('planner_loop.py', 'A robot drives 28 m', 'It stood still for '),
    ],
)
def test_without_ros(name, first, last):
    said = run(name).splitlines()
    assert said[0].startswith(first)
    assert last in said[-1]


ROS = 'ROS 2 is missing: '
LACKING = [
    ('rclpy', ROS, 'ask_a_node.py'),
    ('rclpy', ROS, 'laser_scan_source.py'),
    ('rclpy', ROS, 'questions_a_second.py'),
    ('sensor_msgs', ROS, 'sampling_planner.py --node'),
    ('rosbags', 'rosbags is missing: ', 'play_a_recording.py bag'),
    ('distributed', 'Dask is missing: ', 'many_machines.py'),
    ('matplotlib', 'a picture needs matplotlib: ', 'arm_at_a_shelf.py --picture a.png'),
    ('matplotlib', 'a picture needs matplotlib: ', 'sofa_through_a_doorway.py --picture a.png'),
]


@pytest.mark.parametrize(('missing', 'says', 'command'), LACKING, ids=lambda part: str(part)[:40])
def test_what_is_missing_is_said_at_once(missing, says, command):
    name, *arguments = command.split()
    done = python('-c', WITHOUT, missing, str(EXAMPLES / name), *arguments)
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith(says)
    assert len(done.stderr.splitlines()) == 1


NO_FILES = [
    ('there is no /none/a: ', 'arm_at_a_shelf.py --scenes /none/a'),
    ('/none/a cannot be read ', 'predicted_traffic.py /none/a'),
    ('/none/a.png cannot be written: ', 'predicted_traffic.py --plot /none/a.png'),
    ('/none/a.png cannot be written: ', 'sampling_planner.py --picture /none/a.png'),
    ('/none/a.png cannot be written: ', 'load_through_a_door.py --picture /none/a.png'),
    ('/none/a.png cannot be written: ', 'sofa_through_a_doorway.py --picture /none/a.png'),
    ('name a bag that is there: ', 'play_a_recording.py /none/a'),
]


@pytest.mark.parametrize(('says', 'command'), NO_FILES, ids=lambda part: str(part)[:40])
def test_files_that_are_not_there_are_named(ended, says, command):
    if command.startswith('play_a_recording.py'):
        pytest.importorskip('rosbags', reason='rosbags is not installed')
    code, _, said = ended(*command.split())
    assert code == 2
    assert said.startswith(says)
    assert len(said.splitlines()) == 1


@pytest.mark.slow
def test_a_node_that_is_not_there():
    pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)
    done = python(str(EXAMPLES / 'ask_a_node.py'), '/nobody/bvh')
    assert done.returncode == 2
    assert done.stderr.startswith('there is no node /nobody/bvh: start one')


@pytest.mark.slow
def test_a_load_through_a_door(tmp_path):
    picture = tmp_path / 'door.png'
    _, poses, ways, _ = run('load_through_a_door.py', '--picture', str(picture)).splitlines()
    assert not poses.endswith('; 0 of them hit a wall')
    assert ways.endswith('; 0 of them hit a wall')
    assert picture.stat().st_size > 10_000


@pytest.mark.slow
def test_a_sofa_through_a_doorway(tmp_path):
    picture = tmp_path / 'sofa.png'
    said = run('sofa_through_a_doorway.py', '--picture', str(picture)).splitlines()
    assert said[0].startswith('A sofa of 0.90 x 0.85 m, on its end, is driven through a door of')
    assert said[1].startswith('the wall: Mesh(solid of ')
    assert said[2].startswith('the meshes: a way of ')
    for line, hull in zip(said[3:5], ('sofa', 'wall'), strict=True):
        assert line.startswith(f'the hull of the {hull}: no way; ')
    assert said[-1].startswith('The sofa gets through the doorway: on the way it turns by ')
    assert picture.stat().st_size > 10_000


@pytest.mark.slow
def test_a_sampling_planner(tmp_path):
    picture = tmp_path / 'planner.png'
    said = run('sampling_planner.py', '--ticks', '3', '--picture', str(picture)).splitlines()
    assert said[0].startswith('A robot drives 30 m among 1,000 moving people')
    assert said[2].endswith('--ticks has ended the drive; in 0 ticks it was touched.')
    assert picture.stat().st_size > 10_000


@pytest.mark.slow
def test_through_a_node():
    pytest.importorskip('rclpy')
    said = run('sampling_planner.py', '--ticks', '2', '--node')
    assert said.endswith('in 0 ticks it was touched.\n')
    said = run('questions_a_second.py', '--rows', '500', '--seconds', '0.2').splitlines()
    assert len(said) == 6
    assert all(line.endswith('rows a second, 0 not answered') for line in said[1:5])
    assert said[5].startswith('The node answers up to ')


def test_an_arm_at_a_shelf(tmp_path):
    picture = tmp_path / 'arm.png'
    said = run('arm_at_a_shelf.py', '--picture', str(picture)).splitlines()
    assert 0 < int(said[2].split()[0]) < 500
    assert picture.stat().st_size > 10_000
    scenes = EXAMPLES.parents[1] / 'shared/data/manipulation_scenes/scenes.csv'
    if scenes.exists():
        said = run('arm_at_a_shelf.py', '--scenes', str(scenes)).splitlines()
        assert 0 < int(said[2].split()[0]) < 500


@pytest.mark.slow
@pytest.mark.parametrize('recording', ['', 'commonroad_ngsim/USA_US101-4_1_T-1.csv'])
def test_predicted_traffic(tmp_path, recording):
    tracks = EXAMPLES.parents[1] / 'shared/data' / recording
    if recording and not tracks.exists():
        pytest.skip('the recorded traffic is not there')
    picture = tmp_path / 'traffic.png'
    given = [str(tracks)] if recording else []
    said = run('predicted_traffic.py', *given, '--plot', str(picture)).splitlines()
    assert 'are hit without a warning' in said[-2]
    for line in said[-7:-2]:  # at every rate, prediction is nearer and misses fewer robots
        cells = [float(cell) for cell in line.replace('%', '').split('|')[2:8]]
        assert max(cells[1:3]) < 0.2 * cells[0]
        assert max(cells[4:]) < 0.5 * cells[3]
    assert picture.stat().st_size > 10_000


@pytest.mark.slow
def test_many_machines():
    pytest.importorskip('distributed', reason='extra [cluster] is not installed')
    few = '--boxes', '2e4', '--rays', '1e4', '--part', '5e3'
    said = run('many_machines.py', *few)
    assert 'again: ' in said
    assert said.splitlines()[-1].startswith('No worker took more than ')


def test_a_recording(tmp_path):
    pytest.importorskip('rosbags', reason='rosbags is not installed')
    pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)
    from bag_files import write
    from ros.messages import marker
    from visualization_msgs.msg import Marker, MarkerArray

    arrays = [
        [marker(1, (2, 0, 0), ns='crate'), marker(2, (9, 0, 0), ns='crate')],
        [marker(2, (4, 0, 0), ns='crate')],
        [marker(1, ns='crate', action=Marker.DELETE)],
    ]
    messages = [(k, MarkerArray(markers=array)) for k, array in enumerate(arrays, 1)]
    write(tmp_path / 'bag', {'/obstacles': messages}, begin=0)
    assert run('play_a_recording.py', str(tmp_path / 'bag')).splitlines() == [
        'The cubes in the MarkerArrays of bag, and which are within 5 m of the origin.',
        "t = 1.00 s: 2 obstacles, within 5 m: ['crate/1']",
        "t = 2.00 s: 2 obstacles, within 5 m: ['crate/1', 'crate/2']",
        "t = 3.00 s: 1 obstacles, within 5 m: ['crate/2']",
        '2 obstacles came within 5 m of the origin; 1 are there at the end.',
    ]


@pytest.fixture(scope='module')
def node():
    """A node that hears markers and boxes of a laser; a loaded machine needs minutes for it."""
    rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)
    from bvh_ros.client import BvhClient
    from bvh_ros.ros import running

    laser = {'type': 'PointCloud2', 'topic': '/laser_boxes'}
    markers = {'type': 'MarkerArray', 'topic': '/examples/bvh/obstacles'}
    parameters = {'sources': ['markers', 'laser'], 'markers': markers, 'laser': laser}
    context = rclpy.Context()
    context.init()
    own = rclpy.create_node('examples', context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(own)
    try:
        with (
            pytest.MonkeyPatch.context() as patch,
            running.running_node('/examples', parameters) as process,
        ):
            patch.setattr(running, 'START_TIMEOUT', 1000.0)
            client = BvhClient(own, '/examples/bvh', timeout=1000.0)
            running.wait_until_ready(client, process)
            yield own, executor, client
    finally:
        executor.shutdown()
        context.try_shutdown()


def test_ask_a_node(node):
    assert run('ask_a_node.py', '/examples/bvh').splitlines() == [
        'Three crates are shown to the node /examples/bvh, and it is asked about them.',
        'first on the segment: crate/1 at (4.5, 0.0, 0.5)',
        'a robot of 0.4 m, 0.8 m to the side, meets crate/1',
        '2 m to the side the way is free',
        "within 2 m of (9, 0): ['crate/2']",
    ]


def test_a_custom_source(node):
    from sensor_msgs.msg import LaserScan

    own, executor, client = node
    scans = own.create_publisher(LaserScan, '/scan', 10)
    source = subprocess.Popen(
        [sys.executable, str(EXAMPLES / 'laser_scan_source.py')], stdout=subprocess.PIPE, text=True
    )
    try:
        scan = LaserScan(angle_min=-0.1, angle_increment=0.1, range_min=0.1, range_max=30.0)
        scan.header.frame_id, scan.ranges = 'map', [float('inf'), 6.0, 50.0]
        deadline = time.monotonic() + 1000
        hit = None
        while hit is None:
            assert time.monotonic() < deadline
            scans.publish(scan)
            executor.spin_once(timeout_sec=0.1)
            # Along the beam, but below the crates that another test leaves on the floor.
            hit = client.raycast((0.0, 0.0, -0.05), (50.0, 0.0, -0.05))
        assert hit.name == 'laser#0'
        assert abs(hit.point[0] - 5.7) < 1e-5
        source.send_signal(signal.SIGINT)
        assert source.wait(1000) == 0
        said = source.stdout.read().splitlines()
        assert said[0] == 'Scans on /scan become boxes on /laser_boxes, until Ctrl-C.'
        assert said[-1].endswith(' boxes.')
        source.stdout.close()
    finally:
        if source.poll() is None:
            os.kill(source.pid, signal.SIGKILL)
