# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whatever a parameter or an argument is, the node runs or says in one line what is wrong."""

import os
import re
import subprocess
import sys
from importlib.util import find_spec

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from ros import forking
from ros.messages import marker
from ros.patience import PATIENCE
from tree.compiler.alone import run_alone

from bvh_ros.ros.access import BvhServer, ConfigurationError

EVERYTHING = {
    'sources': ['m', 'c', 'g'],
    'm.type': 'MarkerArray',
    'c.type': 'PointCloud2',
    'g.type': 'OccupancyGrid',
    'm.topic': '/m',
    'c.topic': '/c',
    'g.topic': '/g',
    'views': ['v'],
    'transforms': ['t'],
    't.xyz': [0.0, 0.0, 1.0],
    'virtual_scan.pose_topic': '/p',
    'footprint': [0.5],
}
RCLPYS_OWN = 'start_type_description_service'
LONG = 'x' * 10_000
NAN, INF = float('nan'), float('inf')
ODD = (
    *(True, 0, 1, 3, -1, 2**63 - 1, -(2**63)),
    *(0.0, 0.5, -1.0, 1e-320, 1e200, -1e200, NAN, INF, -INF),
    *('', 'a//b', '{', 'error: ', LONG, 'two\nlines'),
    *([], [True], [2**63 - 1], [0.5], [NAN], [INF], [1e200], [-1.0, 1.0, 1.0], [1e200] * 3),
    *([1e200] * 4, [0.0] * 4, [0.5] * 3, [0.5] * 6, [0.5] * 7, [NAN] * 6),
    *([''], ['a//b'], [LONG], ['x', 'x']),
)
FLAG, COUNT, NOTHING = (True,), (1, 3), ()
SPAN = (0, 1, 3, 0.0, 0.5, 1e-320)
DURATION = (*SPAN, 2**63 - 1, 1e200)
SPEED = (1, 3, 2**63 - 1, 0.5, 1e200)
PREFIX = ('', 'a//b', '{', LONG, 'two\nlines')
FRAME = ('a//b', '{', 'error: ', LONG, 'two\nlines')
NO_NAMES = ([], [''])
PATTERNS = ([], [''], ['a//b'], [LONG], ['x', 'x'])
SOURCE = {'type': NOTHING, 'topic': NOTHING, 'prefix': PREFIX, 'required': FLAG}
SOURCE |= {'max_age': DURATION}
PREDICTING = {'predict': NOTHING, 'max_speed': SPEED, 'smoothing': DURATION}
GROUPS = {
    'm': SOURCE | PREDICTING | {'meshes': NOTHING},
    'c': SOURCE | PREDICTING | {'voxel': SPAN},
    'g': {
        **SOURCE,
        'occupied_at': (0, 1, 3),
        'z_min': (0, 1, -1, 0.0, 0.5, -1.0, 1e-320),
        'z_max': SPAN,
        'unknown': NOTHING,
    },
    'v': {'include': PATTERNS, 'exclude': PATTERNS, 'skip_inside': FLAG},
    't': {
        'frame_id': ('', *FRAME),
        'parent': ('',),
        'xyz': ([-1.0, 1.0, 1.0], [0.5] * 3),
        'xyzw': ([0.5] * 4,),
    },
    'draw': {'limit': COUNT, 'first_depth': (0, 1, 3), 'last_depth': (0, 1, 3)},
    'virtual_scan': {
        'pose_topic': ('',),
        'type': NOTHING,
        'frame_id': FRAME,
        'view': ('',),
        'angle_min': (0, 1, 3, -1, 0.0, 0.5, -1.0, 1e-320),
        'angle_max': (0, 1, 3, -1, 0.0, 0.5, -1.0, 1e-320),
        'angle_increment': (1, 3, 0.5),
        'channels': (1,),
        'elevation_min': (0, -1, 0.0, -1.0),
        'elevation_max': (0, 1, 0.0, 0.5, 1e-320),
        'range_min': SPAN,
        'range_max': SPAN,
        'rate': SPAN,
    },
}
SHARE = (0, 1, 0.0, 0.5, 1e-320)
for name, package, options in (
    ('Detection3DArray', 'vision_msgs', PREDICTING),
    ('CollisionObject', 'moveit_msgs', {'meshes': NOTHING}),
    ('PlanningScene', 'moveit_msgs', {'meshes': NOTHING, 'occupied_at': SHARE}),
    ('Octomap', 'octomap_msgs', {'occupied_at': SHARE}),
):
    if find_spec(package):  # else the type is not offered
        EVERYTHING |= {f'{name}.type': name, f'{name}.topic': f'/{name}'}
        EVERYTHING['sources'] = [*EVERYTHING['sources'], name]
        GROUPS[name] = SOURCE | options
# Of the odd values, those that a parameter may have; all others are refused.
ACCEPTED = {
    'frame_id': FRAME,
    'planar': FLAG,
    'margin': SPAN,
    'max_obstacles': COUNT,
    'max_hits': COUNT,
    'nearest_limit': COUNT,
    'region': ([0.5] * 6,),
    'max_prediction': SPAN,
    'uncertainty': SPAN,
    'history': SPAN,
    'sources': NO_NAMES,
    'batch': FLAG,
    'footprint': ([0.5], [0.5] * 3),
    'footprint_height': SPAN,
    'path_between': FLAG,
    'threads': COUNT,
    'views': NO_NAMES,
    'transforms': NO_NAMES,
    'use_tf': FLAG,
    'mesh_paths': NO_NAMES,
    'mesh_limit': COUNT,
    'mesh_megabytes': (1, 3, 0.5),
    **{f'{of}.{name}': good for of, group in GROUPS.items() for name, good in group.items()},
}


@pytest.fixture
def complaint(ros):
    """What the node says of these parameters; empty if it can use them."""

    def of(parameters):
        # Without what rclpy opens for each node: that took half of the time.
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        overrides.append(Parameter(RCLPYS_OWN, value=False))
        lean = {'start_parameter_services': False, 'enable_rosout': False}
        node = Node('n', parameter_overrides=overrides, **lean)
        try:
            BvhServer(node).destroy()
        except ConfigurationError as error:
            return str(error)
        finally:
            node.destroy_node()
        return ''

    return of


def is_same(one, other):
    """Whether two values are the same, and of the same type."""
    return type(one) is type(other) and repr(one) == repr(other)


@pytest.mark.slow
def test_every_parameter_with_every_odd_value(complaint):
    """A value is refused unless the table has it; the refusal names the parameter."""
    node = Node('n', parameter_overrides=[Parameter(n, value=v) for n, v in EVERYTHING.items()])
    BvhServer(node).destroy()
    declared = {*node._parameters} - {'use_sim_time', RCLPYS_OWN}
    node.destroy_node()
    assert declared == {*ACCEPTED}
    for name, good in ACCEPTED.items():
        for value in ODD:
            said = complaint({**EVERYTHING, name: value})
            accepted = any(is_same(value, one) for one in good)
            assert (not said) == accepted, (name, value, said)
            about = ('stands on', '.type') if name in ('t.parent', 'sources') else ()
            assert not said or any(word in said for word in (name, *about)), (name, value, said)
            assert said == '' or said.isprintable(), (name, value)
            assert len(said) <= 500, (name, value, said)


OVERRIDES = 'qos_overrides./configured/obstacles.subscription'
GRID = {'sources': ['g'], 'g.type': 'OccupancyGrid', 'g.topic': 'g'}
LIDAR = {'use_tf': False, 'transforms': ['lidar']}
SCAN = {'virtual_scan.pose_topic': '/p'}
TALL = {'footprint_height': 1.0}
ANOTHER = 'the name of another parameter'
WRONG = [
    ({'margin': 'wide'}, "'margin' must be a number"),
    ({'margin': -1.0}, "'margin' must be at least 0"),
    ({'margin': NAN}, "'margin' must be"),
    ({'planar': 1}, "'planar' must be true or false"),
    ({'frame_id': ''}, "'frame_id' is empty"),
    ({'frame_id': 5}, "'frame_id' must be a string"),
    ({'max_obstacles': 0}, "'max_obstacles' must be at least 1"),
    ({'max_obstacles': 10.5}, "'max_obstacles' must be a whole number"),
    ({'history': -1.0}, 'history'),
    ({'max_prediction': -1.0}, 'max_prediction'),
    ({'sources': 'markers'}, 'must be a list'),
    ({'sources': ['a', 'a']}, 'there twice'),
    ({'sources': ['margin']}, 'name of another parameter'),
    ({'sources': ['views']}, 'name of another parameter'),
    ({'sources': ['a b']}, 'is not a name'),
    ({'sources': ['a']}, "'a.type' must be one of MarkerArray, PointCloud2, OccupancyGrid"),
    ({'sources': ['a'], 'a.type': 'LaserScan'}, "'a.type' must be one of"),
    ({'sources': ['a'], 'a.type': 'PointCloud2'}, "needs a parameter 'a.topic'"),
    ({'markers.max_age': -1.0}, "'markers.max_age' must be at least 0"),
    ({'markers.predict': 'given'}, 'markers.predict'),
    ({'markers.requierd': True}, "did you mean 'markers.required'"),
    ({f'{OVERRIDES}.relability': 'reliable'}, f"did you mean '{OVERRIDES}.reliability'"),
    ({'qos_overrides./obstacle.subscription.depth': 5}, 'is for nothing here'),
    ({f'{OVERRIDES}.reliability': 'relaible'}, 'must be one of reliable, best_effort'),
    ({f'{OVERRIDES}.depth': 0}, 'must be a whole number from 1'),
    ({f'{OVERRIDES}.depth': 'deep'}, 'must be a whole number from 1'),
    ({**GRID, 'g.unknown': 'maybe'}, "'g.unknown' must be one of free, occupied"),
    ({**GRID, 'g.z_min': 9.0}, "'g.z_min' is above 'g.z_max'"),
    *(
        ({'mesh_paths': [path]}, 'no absolute path of a fol')
        for path in ('/none', 'meshes', __file__)
    ),
    # views
    ({'views': ['1st']}, "'1st' is not a name"),
    ({'views': ['a/b']}, "'a/b' is not a name"),
    ({'views': ['markers']}, f"'markers' is {ANOTHER}"),
    ({'views': ['raycast']}, f"'raycast' is {ANOTHER}"),
    ({'views': ['margin']}, f"'margin' is {ANOTHER}"),
    ({'views': ['a', 'a']}, "'a' is there twice"),
    ({'views': [f'v{i}' for i in range(32)]}, 'names 32 views; there can be 31'),
    ({'views': ['a'], 'a.includes': ['x']}, "no parameter 'a.includes'; did you mean"),
    ({'views': ['a'], 'a.include': 'x'}, "'a.include' must be a list of strings"),
    ({'views': ['a' * 300]}, "(300 characters)' is not a name"),
    # transforms
    ({**LIDAR, 'lidar.xyz': [1.0, 2.0]}, "'lidar.xyz' must be 3 numbers of at most 1e+09"),
    ({**LIDAR, 'lidar.xyz': ['a', 'b', 'c']}, "'lidar.xyz' must be finite numbers"),
    ({**LIDAR, 'lidar.xyz': [1.0, 2.0, NAN]}, "'lidar.xyz' must be finite numbers"),
    ({**LIDAR, 'lidar.xyzw': [0.0, 0.0, 0.0, 0.0]}, "'lidar.xyzw' must be 4 numbers"),
    ({**LIDAR, 'lidar.parent': 'lidar'}, "'lidar' stands on itself"),
    ({**LIDAR, 'lidar.parrent': 'map'}, "did you mean 'lidar.parent'"),
    ({**LIDAR, 'sources': ['lidar']}, "'lidar' is the name of another"),
    # footprints
    *(({'footprint': bad}, 'footprint') for bad in ([1.0, 2.0], [-1.0], [INF], [0.0, 1.0, 1.0])),
    ({'footprint': '[[0, 0], [1, 1], [1, 0], [0, 1]]', **TALL}, 'is not simple'),
    ({'footprint': '[[0, 0], [1, 0]]', **TALL}, '3 to 200 corners'),
    ({'footprint': 'circle', **TALL}, 'must be a polygon'),
    ({'footprint': '{(0, 0), (1, 0), (0, 1)}', **TALL}, 'must be a polygon'),
    ({'footprint': "['00', '10', '01']", **TALL}, 'must be a polygon'),
    ({'footprint': '[[True, 0], [0, 1], [1, 1]]', **TALL}, 'must be a polygon'),
    ({'footprint': f'[[0, 0], [1, 0], [0, {10**400}]]', **TALL}, 'must be a polygon'),
    ({'footprint': '[]', **TALL}, '3 to 200 corners'),
    ({'path_between': True, **TALL}, "path_between' needs a 'footprint'"),
    ({'footprint': '[[0, 0], [1, 0], [1e300, 1]]', **TALL}, 'not within'),
    ({'footprint': '[[0, 0], [1, 0], [0, 1]]', 'footprint_height': 0.0}, 'footprint_height'),
    # the virtual scan
    ({**SCAN, 'virtual_scan.angle_min': 1.0, 'virtual_scan.angle_max': 0.0}, 'virtual_scan'),
    ({**SCAN, 'virtual_scan.range_min': 2.0, 'virtual_scan.range_max': 1.0}, 'virtual_scan'),
    ({**SCAN, 'virtual_scan.elevation_min': 0.1}, 'virtual_scan'),
    ({**SCAN, 'virtual_scan.channels': 2}, 'virtual_scan'),
    ({**SCAN, 'virtual_scan.frame_id': ''}, 'virtual_scan'),
    ({**SCAN, 'virtual_scan.angle_increment': 1e-6}, 'virtual_scan'),
    # beside others
    ({**EVERYTHING, 'footprint': [1e200]}, "'footprint'"),
    ({**EVERYTHING, 'm.max_speed': 0.0}, "'m.max_speed'"),
    ({**EVERYTHING, 'transforms': ['t', 'a']}, "'transforms'"),
    ({**EVERYTHING, 'virtual_scan.view': 'nowhere'}, "'virtual_scan.view'"),
]


@pytest.mark.parametrize(('parameters', 'reason'), WRONG, ids=lambda part: str(part)[:60])
def test_wrong_parameters(configure, parameters, reason):
    with pytest.raises(ConfigurationError, match=re.escape(reason)):
        configure(parameters)


def test_these_are_right(configure):
    configure(EVERYTHING)
    assert configure({}).settings.footprint == ()


@pytest.mark.parametrize(
    ('package', 'kind'),
    [
        ('vision_msgs', 'Detection3DArray'),
        ('moveit_msgs', 'CollisionObject'),
        ('octomap_msgs', 'Octomap'),
    ],
)
def test_a_type_is_not_offered_without_its_message_package(complaint, monkeypatch, package, kind):
    for module in [name for name in sys.modules if name.startswith('bvh_ros.ros.sources.')]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, f'{package}.msg', None)  # as if it were not there
    monkeypatch.setitem(sys.modules, package, None)
    said = complaint({'sources': ['s'], 's.type': kind, 's.topic': '/s'})
    assert said.startswith(f"source 's' needs {package}")
    assert complaint({}) == ''


@pytest.mark.parametrize(
    ('executable', 'arguments', 'reason'),
    [
        ('node', '--ros-args -p use_sim_time:=maybe', "'use_sim_time'"),
        ('lifecycle_node', '--ros-args -p use_sim_time:=3', "'use_sim_time'"),
        ('node', '--ros-args --bogus', "unknown ROS arguments: ['--bogus']"),
        ('lifecycle_node', '-p margin:=1.0', 'unrecognized arguments: -p margin:=1.0'),
        ('node', '--ros-args -p margin:=1e308', "'margin' must be at least 0 and at most"),
        ('node', '--ros-args --params-file /nowhere', '/nowhere'),
        ('node', '--ros-args -p markers.topic:=a//b', "source 'markers'"),
    ],
)
def test_a_wrong_command_line_ends_with_one_plain_line(tmp_path, executable, arguments, reason):
    log = tmp_path / 'log'
    log.touch()
    node = forking.Fork(arguments.split(' '), log, f'bvh_{executable}')
    assert node.wait(PATIENCE) == 2
    said = log.read_text()
    assert 'Traceback' not in said
    *_, line = said.splitlines()
    assert line.startswith(f'bvh_{executable}: ')
    assert reason in line


def test_help_is_given():
    command = [sys.executable, '-m', 'bvh_ros.ros.node', '--help']
    ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert (ended.returncode, ended.stderr) == (0, '')
    assert 'come after --ros-args' in ended.stdout


def test_wrong_arguments_of_the_report():
    main = 'import sys; from bvh_ros.report.cli import main; sys.exit(main(sys.argv[1:]))'
    ended = run_alone(main, 'speed', '--out', os.devnull, ends=2)
    assert 'Traceback' not in ended.stderr
    assert '--out' in ended.stderr.splitlines()[-1]


@pytest.mark.slow
def test_a_huge_frame_is_shortened_where_it_is_told(start_node):
    world = start_node()
    huge = 'f' * 1_000_000
    world.markers(marker(1, frame=huge))
    world.markers(marker(2, ns='n' * 1_000_000, size=(-1, 1, 1)))
    status = world.status('source markers')
    world.until(lambda: world.status('source markers').values['refused'] == '2')
    (pose,) = world.plan('raycast', (0, 0, 0), (1, 0, 0), frame=huge).poses
    status = world.status('source markers')
    for said in (world.said(), str(status), world.status('queries').values['last reason']):
        assert len(said) < 10_000
    for said in (world.said(), pose.header.frame_id):
        assert 'ffff... (1000000 characters)' in said
    assert 'nnnn... (1000002 characters)' in str(status)
