# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every script in examples/ runs, and prints what it promises."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parent.parent / 'examples'


def run(name, *arguments):
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *arguments],
        capture_output=True,
        text=True,
        timeout=600,  # what an example compiles first may take minutes
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(
    ('name', 'said'),
    [
        ('tree_alone.py', '10000 boxes moved'),
        pytest.param('moving_boxes.py', 'of 1000 meet a moving box', marks=pytest.mark.slow),
        ('virtual_lidar.py', 'of 32768 beams return'),
        ('planner_loop.py', 'at the goal after'),
    ],
)
def test_without_ros(name, said):
    assert said in run(name)


@pytest.mark.slow
def test_a_load_through_a_door(tmp_path):
    picture = tmp_path / 'door.png'
    poses, ways = run('load_through_a_door.py', '--picture', str(picture)).splitlines()
    assert not poses.endswith('; 0 of them hit a wall')
    assert ways.endswith('; 0 of them hit a wall')
    assert picture.stat().st_size > 10_000


@pytest.mark.slow
def test_a_sampling_planner(tmp_path):
    picture = tmp_path / 'planner.png'
    said = run('sampling_planner.py', '--ticks', '3', '--picture', str(picture))
    assert 'in 0 of them in touch' in said
    assert picture.stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.timeout(1300)  # seconds: the first node compiles
def test_through_a_node():
    pytest.importorskip('rclpy')
    assert 'in 0 of them in touch' in run('sampling_planner.py', '--ticks', '2', '--node')
    said = run('questions_a_second.py', '--rows', '500', '--seconds', '0.2').splitlines()
    assert len(said) == 4
    assert all(line.endswith('rows a second, 0 not answered') for line in said)


def test_an_arm_at_a_shelf(tmp_path):
    data = EXAMPLES.parents[1] / 'shared' / 'data'
    if not data.exists():
        pytest.skip('the recorded scenes are not there')
    picture = tmp_path / 'arm.png'
    said = run('arm_at_a_shelf.py', '--data', str(data), '--picture', str(picture))
    assert 0 < int(said.split()[0]) < 500
    assert picture.stat().st_size > 10_000


@pytest.mark.slow
def test_predicted_traffic(tmp_path):
    tracks = EXAMPLES.parents[1] / 'shared/data/commonroad_ngsim/USA_US101-4_1_T-1.csv'
    if not tracks.exists():
        pytest.skip('the recorded traffic is not there')
    picture = tmp_path / 'traffic.png'
    said = run('predicted_traffic.py', str(tracks), '--plot', str(picture)).splitlines()
    for line in said[-5:]:  # at every rate, prediction is nearer and misses fewer robots
        cells = [float(cell) for cell in line.replace('%', '').split('|')[2:8]]
        assert max(cells[1:3]) < 0.2 * cells[0]
        assert max(cells[4:]) < 0.5 * cells[3]
    assert picture.stat().st_size > 10_000


@pytest.mark.slow
def test_many_machines():
    pytest.importorskip('distributed', reason='extra [cluster] is not installed')
    few = '--boxes', '2e4', '--rays', '1e4', '--part', '5e3'
    assert 'again: ' in run('many_machines.py', *few)


def test_a_recording(tmp_path):
    pytest.importorskip('rosbags', reason='rosbags is not installed')
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    point, turn = types['geometry_msgs/msg/Point'], types['geometry_msgs/msg/Quaternion']
    stamp = types['builtin_interfaces/msg/Time'](0, 0)
    black = types['std_msgs/msg/ColorRGBA'](0.0, 0.0, 0.0, 1.0)

    def marker(number, x, action):
        return types['visualization_msgs/msg/Marker'](
            header=types['std_msgs/msg/Header'](stamp, 'map'),
            ns='crate',
            id=number,
            type=1,
            action=action,
            pose=types['geometry_msgs/msg/Pose'](point(x, 0.0, 0.0), turn(0.0, 0.0, 0.0, 1.0)),
            scale=types['geometry_msgs/msg/Vector3'](1.0, 1.0, 1.0),
            color=black,
            lifetime=types['builtin_interfaces/msg/Duration'](0, 0),
            frame_locked=False,
            points=[],
            colors=[],
            texture_resource='',
            texture=types['sensor_msgs/msg/CompressedImage'](
                types['std_msgs/msg/Header'](stamp, ''), '', np_bytes()
            ),
            uv_coordinates=[],
            text='',
            mesh_resource='',
            mesh_file=types['visualization_msgs/msg/MeshFile']('', np_bytes()),
            mesh_use_embedded_materials=False,
        )

    messages = [[marker(1, 2.0, 0), marker(2, 9.0, 0)], [marker(2, 4.0, 0)], [marker(1, 0.0, 2)]]
    kind = 'visualization_msgs/msg/MarkerArray'
    with Writer(tmp_path / 'bag', version=9) as bag:
        topic = bag.add_connection('/obstacles', kind, typestore=store)
        for k, markers in enumerate(messages):
            bag.write(topic, (k + 1) * 10**9, store.serialize_cdr(types[kind](markers), kind))
    assert run('play_a_recording.py', str(tmp_path / 'bag')).splitlines() == [
        "t = 1.00 s: 2 obstacles, within 5 m: ['crate/1']",
        "t = 2.00 s: 2 obstacles, within 5 m: ['crate/1', 'crate/2']",
        "t = 3.00 s: 1 obstacles, within 5 m: ['crate/2']",
    ]


def np_bytes():
    import numpy as np

    return np.empty(0, np.uint8)


@pytest.fixture(scope='module')
def node():
    """A node that hears markers and boxes of a laser."""
    rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)
    from bvh_ros.client import BvhClient
    from bvh_ros.ros.running import running_node, wait_until_ready

    laser = {'type': 'PointCloud2', 'topic': '/laser_boxes'}
    markers = {'type': 'MarkerArray', 'topic': '/examples/bvh/obstacles'}
    parameters = {'sources': ['markers', 'laser'], 'markers': markers, 'laser': laser}
    context = rclpy.Context()
    context.init()
    own = rclpy.create_node('examples', context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(own)
    try:
        with running_node('/examples', parameters) as process:
            client = BvhClient(own, '/examples/bvh')
            wait_until_ready(client, process)
            yield own, executor, client
    finally:
        executor.shutdown()
        context.try_shutdown()


def test_ask_a_node(node):
    assert run('ask_a_node.py', '/examples/bvh').splitlines() == [
        'first on the way: crate/1 at (4.5, 0.0, 0.5)',
        'a robot of 0.4 m, 0.8 m to the side, meets crate/1',
        '2 m to the side the way is free',
        "within 2 m of (9, 0): ['crate/2']",
    ]


def test_a_custom_source(node):
    from sensor_msgs.msg import LaserScan

    own, executor, client = node
    scans = own.create_publisher(LaserScan, '/scan', 10)
    source = subprocess.Popen([sys.executable, str(EXAMPLES / 'laser_scan_source.py')])
    try:
        scan = LaserScan(angle_min=-0.1, angle_increment=0.1, range_min=0.1, range_max=30.0)
        scan.header.frame_id, scan.ranges = 'map', [float('inf'), 6.0, 50.0]
        deadline = time.monotonic() + 60
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
        assert source.wait(20) == 0
    finally:
        if source.poll() is None:
            os.kill(source.pid, signal.SIGKILL)
