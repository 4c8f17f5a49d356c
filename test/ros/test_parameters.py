# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whatever a parameter or an argument is, the node runs or says in one line what is wrong."""

import os
import subprocess
import sys
from importlib.util import find_spec

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

from rclpy.node import Node
from rclpy.parameter import Parameter
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


@pytest.mark.parametrize(
    ('parameters', 'named'),
    [
        ({'footprint': [1e200]}, 'footprint'),
        ({'m.max_speed': 0.0}, 'm.max_speed'),
        ({'transforms': ['t', 'a']}, 'transforms'),
        ({'virtual_scan.view': 'nowhere'}, 'virtual_scan.view'),
    ],
)
def test_these_are_refused(complaint, parameters, named):
    assert complaint(EVERYTHING) == ''
    assert f"'{named}'" in complaint({**EVERYTHING, **parameters})


@pytest.mark.parametrize('package', ['vision_msgs', 'moveit_msgs', 'octomap_msgs'])
def test_a_type_is_not_offered_without_its_message_package(complaint, monkeypatch, package):
    types = {
        'vision_msgs': 'Detection3DArray',
        'moveit_msgs': 'CollisionObject',
        'octomap_msgs': 'Octomap',
    }
    for module in [name for name in sys.modules if name.startswith('bvh_ros.ros.sources.')]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, f'{package}.msg', None)  # as if it were not there
    monkeypatch.setitem(sys.modules, package, None)
    said = complaint({'sources': ['s'], 's.type': types[package], 's.topic': '/s'})
    assert said.startswith(f"source 's' needs {package}")
    assert complaint({}) == ''


def started(executable, *arguments):
    return subprocess.run(
        [sys.executable, '-m', f'bvh_ros.ros.{executable}', *arguments],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )


@pytest.mark.parametrize(
    ('executable', 'arguments', 'reason'),
    [
        ('node', '--ros-args -p use_sim_time:=maybe', "'use_sim_time'"),
        ('lifecycle_node', '--ros-args -p use_sim_time:=3', "'use_sim_time'"),
        ('node', '--ros-args --bogus', "unknown ROS arguments: ['--bogus']"),
        ('lifecycle_node', '-p margin:=1.0', 'unrecognized arguments: -p margin:=1.0'),
        ('node', '--ros-args -p margin:=1e308', "'margin' must be at least 0 and at most"),
        ('node', '--ros-args --params-file /nowhere', '/nowhere'),
    ],
)
def test_a_wrong_command_line_ends_with_one_plain_line(executable, arguments, reason):
    ended = started(executable, *arguments.split(' '))
    assert ended.returncode == 2
    assert 'Traceback' not in ended.stderr
    *_, line = ended.stderr.splitlines()
    assert line.startswith(f'bvh_{executable}: ')
    assert reason in line


def test_help_is_given():
    ended = started('node', '--help')
    assert (ended.returncode, ended.stderr) == (0, '')
    assert 'come after --ros-args' in ended.stdout


@pytest.mark.parametrize(
    'arguments',
    [('bvh_ros.demo', '--domain', '233'), ('bvh_ros.report.cli', 'speed', '--out', os.devnull)],
)
def test_wrong_arguments_of_the_others(arguments):
    module, *rest = arguments
    main = f'import sys; from {module} import main; sys.exit(main(sys.argv[1:]))'
    ended = run_alone(main, *rest, ends=2)
    assert 'Traceback' not in ended.stderr
    assert rest[-2] in ended.stderr.splitlines()[-1]


@pytest.mark.slow
def test_a_huge_frame_is_shortened_where_it_is_told(start_node, messages):
    world = start_node()
    huge = 'f' * 1_000_000
    world.markers(messages.marker(1, frame=huge))
    world.markers(messages.marker(2, ns='n' * 1_000_000, size=(-1, 1, 1)))
    status = world.status('source markers')
    world.until(lambda: world.status('source markers').values['refused'] == '2')
    (pose,) = world.plan('raycast', (0, 0, 0), (1, 0, 0), frame=huge).poses
    status = world.status('source markers')
    for said in (world.said(), str(status), world.status('queries').values['last reason']):
        assert len(said) < 10_000
    for said in (world.said(), pose.header.frame_id):
        assert 'ffff... (1000000 characters)' in said
    assert 'nnnn... (1000002 characters)' in str(status)
