# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of recorded scenes through the demo: real traffic, a building and a map."""

import csv
import re
from collections import defaultdict

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)
pytest.importorskip('rosbags', reason='rosbags is not installed')

from bag_files import write
from demos import finished, rows_of, start
from ros.messages import cloud, grid, marker
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from bvh_ros import bags, scenarios

NEVER = QosTime(0, 0)
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    *(NEVER, NEVER, QosLiveliness.AUTOMATIC, NEVER, False),
)


def traffic(shared_data, frames, frame_id='odom'):
    """The first frames of a track file."""
    rows = defaultdict(list)
    with (shared_data / 'commonroad_ngsim' / 'USA_Peach-4_8_T-1.csv').open(newline='') as file:
        for row in csv.DictReader(file):
            rows[float(row['t_s'])].append(row)
    return [
        (t, MarkerArray(markers=[vehicle(row, frame_id) for row in rows[t]]))
        for t in list(rows)[:frames]
    ]


def vehicle(row, frame_id):
    at, size, turn = (
        [float(row[name]) for name in names.split()]
        for names in ('cx cy cz', 'sx sy sz', 'qx qy qz qw')
    )
    return marker(row['id'], at, size, turn=turn, ns='car', frame=frame_id)


def building(shared_data):
    """72,153 cubes as one cloud."""
    file = shared_data / 'octomap_fr079' / 'occupied_voxels.csv'
    table = np.loadtxt(file, delimiter=',', skiprows=1)[:, (0, 1, 2, 3, 3, 3)]
    message = cloud(dict(zip(('x', 'y', 'z', 'sx', 'sy', 'sz'), table.T, strict=True)), kind='f4')
    message.header.frame_id = 'map'
    return [(0.0, message)], len(table)


def floor(shared_data):
    """The map of occupied cells."""
    file = shared_data / 'willow_garage_map' / 'occupied_cells.csv'
    cells = np.loadtxt(file, delimiter=',', skiprows=1)
    columns, rows = np.rint(cells[:, :2] / 0.1 - 0.5).astype(int).T
    values = np.zeros((rows.max() + 1, columns.max() + 1), np.int8)
    values[rows, columns] = 100
    return [(0.0, grid(values, 0.1))]


def played(*arguments):
    """The output of a demo that ended well, and how many rows its table has."""
    code, output, errors = finished(start(*arguments))
    assert code == 0, output + errors
    assert '0 errors' in output
    return output, len(rows_of(output))


@pytest.mark.slow
def test_markers_in_their_own_frame_at_another_pace(shared_data, tmp_path):
    frames = traffic(shared_data, 41)
    text = [(t, String(data='x')) for t, _ in frames * 3]
    path = write(tmp_path / 'bag', {'/chatter': text, '/tracks': frames})
    output, rows = played('--replay', path, '--speed', '2')
    assert '/tracks (MarkerArray): 41 messages\n41 messages in 4.0 s\n' in output
    assert f'{len(frames[0][1].markers)} obstacles between' in output
    assert rows >= 6
    took = float(re.search(r'41 messages in (\d+\.\d) s;', output)[1])
    assert took >= 2.0
    assert re.search(r'  car/\d', output)


def test_a_cloud_in_a_bare_file(shared_data, tmp_path):
    messages, count = building(shared_data)
    path = write(tmp_path / 'bag', {'/boxes': messages, '/tracks': traffic(shared_data, 1)})
    (path,) = path.glob('*.mcap')
    output, rows = played('--replay', path, '--topic', '/boxes')
    assert f'{count} obstacles between' in output
    assert 'not played: /tracks' in output
    assert 'replay#' in output
    assert rows == 3


@pytest.mark.slow
def test_a_latched_map_in_sqlite(shared_data, tmp_path):
    path = write(
        tmp_path / 'bag',
        {'/map': floor(shared_data)},
        storage=StoragePlugin.SQLITE3,
        qos=[LATCHED],
    )
    assert bags.find(path).tracks[0].transient_local
    output, rows = played('--replay', path)
    assert '/map (OccupancyGrid): 1 messages' in output
    assert 'replay#' in output
    assert rows == 3


def box(number, at, size):
    return MarkerArray(markers=[marker(number, at, size, ns='car')])


@pytest.mark.slow
def test_all_topics_with_obstacles_at_once(tmp_path):
    """Two use the same names. The corners are those of the boxes, not of points on them."""
    points = cloud({'x': [5, 6], 'y': [-9, -9], 'z': [0, 0]}, kind='f4')
    points.header.frame_id = 'map'
    topics = {
        '/cars': [(0.0, box(1, (0, 0, 0), (4, 4, 4))), (2.5, box(2, (0, 5, 0), (2, 2, 2)))],
        '/people': [(0.1, box(1, (20, 0, 0), (2, 2, 6)))],
        '/lidar/points': [(0.2, points)],
        '/chatter': [(0.3, String(data='x'))],
    }
    path = write(tmp_path / 'bag', topics)
    recording = bags.find(path)
    assert [track.topic for track in recording.tracks] == ['/cars', '/lidar/points', '/people']
    played_in_turn = [track.topic for _, track, _ in recording.messages()]
    assert played_in_turn == ['/cars', '/people', '/lidar/points', '/cars']
    output, _ = played('--replay', path)
    *_, last = re.findall('.* obstacles between .*', output)
    assert last == '5 obstacles between (-2.0, -9.1, -3.0) and (21.0, 6.0, 3.0)'
    assert '4 messages in 2.5 s' in output
    only, _ = played('--replay', path, '--topic', '/people')
    assert '1 obstacles between (19.0, -1.0, -3.0) and (21.0, 1.0, 3.0)' in only
    assert 'not played: /cars, /lidar/points' in only


def test_bags_that_cannot_be_played(tmp_path):
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'noise.mcap').write_bytes(b'\x89noise' * 100)
    (tmp_path / 'old.bag').write_bytes(b'#ROSBAG V2.0')
    chatter = write(tmp_path / 'chatter', {'/chatter': [(0.0, String(data='x'))]})
    for path, topic, reason in (
        (tmp_path / 'folder', '', 'is no ROS 2 bag'),
        (tmp_path / 'noise.mcap', '', 'is no ROS 2 bag'),
        (tmp_path / 'old.bag', '', 'ROS 1 bag.*rosbags-convert'),
        (chatter, '', 'no topic of type MarkerArray, PointCloud2, OccupancyGrid, but /chatter'),
        (chatter, '/tracks', r'no topic /tracks .* but /chatter \(std_msgs/msg/String\)'),
    ):
        with pytest.raises(bags.BagError, match=reason):
            bags.find(path, topic)
    code, _, errors = finished(start('--replay', chatter))
    assert code == 1
    assert errors.startswith('bvh_demo: the bag has no topic of type')


def test_a_file_that_is_no_track_file(tmp_path):
    path = tmp_path / 'tracks.csv'
    for content in (b'', b'a,b\n1,2\n', b'frame,t_s,id\n0,x,1\n', b'\xff\x00', b'frame\n' * 3):
        path.write_bytes(content)
        with pytest.raises(RuntimeError, match=r'tracks\.csv is no track file: '):
            next(scenarios.tracks(path))


def test_a_recording_without_obstacles_is_said_to_be_one():
    from bvh_ros import replay

    class NothingThere:
        extent = None

        def until_quiet(self, timeout):
            pass

    with pytest.raises(bags.BagError, match='brought no obstacle'):
        replay.ask_at_the_end(None, None, NothingThere(), 0.0)


def test_another_definition_of_a_type_is_refused(tmp_path):
    from rosbags.typesys import get_types_from_msg

    other = get_typestore(Stores.EMPTY)
    other.register(get_types_from_msg('int32 cells', 'nav_msgs/msg/OccupancyGrid'))
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection('/map', 'nav_msgs/msg/OccupancyGrid', typestore=other)
        writer.write(connection, 1, b'\x00\x01\x00\x00\x07\x00\x00\x00')
    with pytest.raises(bags.BagError, match='another definition'):
        bags.find(tmp_path / 'bag')
