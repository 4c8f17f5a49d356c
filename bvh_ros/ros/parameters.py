# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node's parameters, read once into plain settings."""

from __future__ import annotations

import difflib
import math
import os
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterValueException

from bvh_ros.ros.texts import shortened
from bvh_ros.scene.rows import ERROR_PREFIX

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.scene import Shapes

FARTHEST = 1e9  # m, of lengths: doubles are exact to a tenth of a micrometre there
Value = bool | int | float | str | list[str] | list[float]


class ConfigurationError(ValueError):
    """A parameter has a value that the node cannot work with; the text says which and why."""


@dataclass(frozen=True)
class Option:
    """One parameter: its default (whose type it keeps), meaning and range."""

    name: str
    default: Value
    description: str
    minimum: float = -sys.float_info.max
    maximum: float = sys.float_info.max
    choices: tuple[str, ...] = ()
    or_text: bool = False  # a string will do, too


def read(node: Node, prefix: str, option: Option) -> Any:
    """Return the value of a parameter; declare it, unless an earlier life of the node did."""
    name = prefix + option.name
    if node.has_parameter(name):
        return _checked(name, option, node.get_parameter(name).value)
    descriptor = ParameterDescriptor(
        description=option.description, read_only=True, dynamic_typing=True
    )
    if option.choices:
        descriptor.additional_constraints = 'One of: ' + ', '.join(option.choices)
    low, high = option.minimum, option.maximum
    if isinstance(option.default, float):
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    elif isinstance(option.default, int) and not isinstance(option.default, bool):
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    try:
        value = node.declare_parameter(name, option.default, descriptor).value
    except InvalidParameterValueException as error:
        raise _out_of_range(name, option) from error
    return _checked(name, option, value)


def _checked(name: str, option: Option, value: Any) -> Any:
    """Return the value in its option's type or raise ConfigurationError."""
    default = option.default
    if option.or_text and isinstance(value, str):
        return value
    if isinstance(default, list):
        return _checked_list(name, default, value)
    if isinstance(default, bool):
        good, wanted = isinstance(value, bool), 'true or false'
    elif isinstance(default, float):
        good, wanted = _is_number(value, (int, float)), 'a number'
        value = float(value) if good else value
    elif isinstance(default, int):
        good, wanted = _is_number(value, (int,)), 'a whole number'
    else:
        good, wanted = isinstance(value, str), 'a string'
    if not good:
        raise _must_be(name, wanted, value)
    if option.choices and value not in option.choices:
        raise _must_be(name, f'one of {", ".join(option.choices)}', value)
    # An integer given for a double escapes rclpy's own range check, and so does NaN.
    if _is_number(value, (int, float)) and not option.minimum <= value <= option.maximum:
        raise _out_of_range(name, option)
    return value


def _checked_list(name: str, default: Sequence[object], value: Any) -> list[Any]:
    items = [] if value is None else list(value) if _is_list(value) else None
    if isinstance(default[0], float):
        unlimited = not all(_is_finite(item) for item in default)
        good = _is_limit if unlimited else _is_finite
        if items is not None and all(good(item) for item in items):
            return [float(item) for item in items]
        raise _must_be(name, 'numbers' if unlimited else 'finite numbers', value)
    if items is not None and all(isinstance(item, str) for item in items):
        # YAML cannot say "an empty list of strings" other than ['']
        return [item for item in items if item]
    raise _must_be(name, 'a list of strings', value)


def _must_be(name: str, wanted: str, value: Any) -> ConfigurationError:
    shown = shortened(repr(value))
    return ConfigurationError(f"parameter '{name}' must be {wanted}, not {shown}")


def _out_of_range(name: str, option: Option) -> ConfigurationError:
    unlimited = sys.float_info.max
    low = f'at least {option.minimum:.10g}' if option.minimum > -unlimited else ''
    high = f'at most {option.maximum:.10g}' if option.maximum < unlimited else ''
    limits = ' and '.join(limit for limit in (low, high or 'finite') if limit)
    return ConfigurationError(f"parameter '{name}' must be {limits}")


def _is_number(value: Any, types: tuple[type, ...]) -> bool:
    return isinstance(value, types) and not isinstance(value, bool)


def _is_finite(value: Any) -> bool:
    return _is_number(value, (int, float)) and math.isfinite(value)


def _is_limit(value: Any) -> bool:
    return _is_number(value, (int, float)) and not math.isnan(value)


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, (str, bytes))


# The settings of the node, as plain values.

SHARED = 1024  # rows: with fewer, threads take longer to begin than they save


@dataclass(frozen=True)
class SourceSettings:
    """The settings of one source."""

    name: str
    type: str
    topic: str
    prefix: str
    required: bool
    max_age: float  # s, 0 = unlimited
    options: Mapping[str, Any]  # those of its type

    @property
    def predicts(self) -> bool:
        """Whether its obstacles have velocities."""
        return bool(self.options.get('predict', 'none') != 'none')


@dataclass(frozen=True)
class ViewSettings:
    """The settings of one view."""

    name: str
    include: tuple[str, ...]
    exclude: tuple[str, ...]
    skip_inside: bool


@dataclass(frozen=True)
class TransformSettings:
    """Where one frame lies in another, for ever."""

    frame_id: str
    parent: str
    xyz: tuple[float, ...]  # m
    xyzw: tuple[float, ...]  # of length 1, to within 1 %


@dataclass(frozen=True)
class Settings:
    """The settings of the node."""

    frame_id: str
    planar: bool
    margin: float  # m
    max_obstacles: int
    max_hits: int
    region: tuple[tuple[float, ...], tuple[float, ...]] | None  # lo, hi, m; None is everywhere
    nearest_limit: int
    max_prediction: float  # s
    uncertainty: float  # m/s
    history: float  # s
    batch: bool
    footprint: tuple[Shapes, ...]  # its convex parts, one row each; none: there is none
    path_between: bool
    threads: int  # that share the rows of a batch
    use_tf: bool
    mesh_paths: Sequence[str]
    mesh_limit: int
    mesh_megabytes: float
    sources: tuple[SourceSettings, ...]
    views: tuple[ViewSettings, ...]
    transforms: tuple[TransformSettings, ...]
    groups: Mapping[str, Mapping[str, Any]]  # options of parts: group -> option -> value

    @property
    def predicts(self) -> bool:
        """Whether a source does."""
        return any(source.predicts for source in self.sources)

    def threads_for(self, rows: int) -> int:
        """How many threads share so many rows."""
        return self.threads if rows >= SHARED else 1


# The node's parameters, read once into plain settings.

NO_FOOTPRINT = (0.0,)
PLANAR_HEIGHT = 1.0  # m, of what is seen from above
NODE_OPTIONS = (
    Option('frame_id', 'map', 'Frame in which obstacles are kept and answers are given.'),
    Option('planar', False, 'See the world from above: footprints in a 2D tree, z is ignored.'),
    Option(
        'margin',
        0.0,
        'Every box in the tree is fattened by this many metres, so that small moves cost no work. '
        'Answers do not depend on it.',
        minimum=0.0,
        maximum=FARTHEST,
    ),
    Option(
        'max_obstacles',
        1_000_000,
        'More obstacles than this are refused.',
        minimum=1,
        maximum=2**31 - 1,
    ),
    Option(
        'max_hits',
        5_000,
        'An answer of raycast_all or overlap with more obstacles than this is an error: while a '
        'reply is written no other query is answered, 10 us an obstacle.',
        minimum=1,
        maximum=2**31 - 1,
    ),
    Option(
        'nearest_limit',
        16,
        'How many obstacles nearest to a point ~/nearest returns at most.',
        minimum=1,
        maximum=100_000,
    ),
    Option(
        'region',
        [-math.inf] * 3 + [math.inf] * 3,
        'Only obstacles whose bounds touch the box from the first three to the last three numbers '
        '(m, in frame_id) are kept, and queries are answered about these.',
    ),
    Option(
        'max_prediction',
        1.0,
        'So far ahead of the newest data (s) there are answers, where a source '
        'predicts. An obstacle without an update for longer stays at its last predicted place.',
        *(0.0, 1e6),
    ),
    Option(
        'uncertainty',
        0.0,
        'At other times than those of their stamps obstacles that move are larger all round by so '
        'many metres for each second between. In a planar world only vx and vy count as motion.',
        *(0.0, 1e6),
    ),
    Option(
        'history',
        0.0,
        'So much before the newest data (s) queries may name: the world is copied after each '
        'message.',
        *(0.0, 1e6),
    ),
    Option('sources', ['markers'], 'Names of the sources of obstacles; each has its own options.'),
    Option(
        'batch',
        True,
        'Answer clouds of rays on ~/rays by clouds of hits on ~/ray_hits; boxes and points, too.',
    ),
    Option(
        'footprint',
        [*NO_FOOTPRINT],
        'What goes along the paths on ~/paths: edge lengths of a box or the radius of a ball (m), '
        "centred on each pose; or a simple polygon as text, '[[x, y], ...]' as in Nav2, that "
        'stands on each pose. 0: there are no such topics.',
        or_text=True,
    ),
    Option(
        'footprint_height',
        0.0,
        'Height of a footprint that is a polygon (m). A planar world needs none.',
        *(0.0, FARTHEST),
    ),
    Option(
        'path_between',
        False,
        'Each row of ~/path_hits is about the way from the pose before, too.',
    ),
    Option(
        'threads',
        1,
        'So many threads, no more than there are processors, share the rows of a cloud or path. '
        'Answers do not depend on it.',
        minimum=1,
        maximum=1024,
    ),
    Option(
        'views',
        [''],
        'Names of views: parts of the world, each with patterns of obstacle names and services of '
        'its own.',
    ),
    Option(
        'transforms',
        [''],
        'Names of transforms that never change; each has a parent, xyz and xyzw of its own.',
    ),
    Option('use_tf', True, 'Transform other frames by tf2, where tf2_ros is installed.'),
    Option(
        'mesh_paths',
        [''],
        'Folders from which markers may name mesh files, file://; package:// names those of '
        'installed packages.',
    ),
    Option(
        'mesh_limit',
        200_000,
        'A mesh file with more triangles is refused.',
        minimum=1,
        maximum=10_000_000,
    ),
    Option('mesh_megabytes', 100.0, 'A larger mesh file is refused.', 1e-3, 1000.0),
)
SOURCE_OPTIONS = (
    Option('prefix', '', 'Begins the name of every obstacle of this source.'),
    Option('required', False, 'Until this source has sent all, every query answers an error.'),
    Option(
        'max_age',
        0.0,
        'Once this source has been silent for longer (s), every query answers an error. 0: never.',
        minimum=0.0,
    ),
)
VIEW_OPTIONS = (
    Option('include', ['*'], 'Glob patterns of the obstacle names that the view shows.'),
    Option('exclude', [''], 'Glob patterns of the obstacle names that it does not show.'),
    Option('skip_inside', False, 'Rays ignore obstacles that they start in.'),
)
TRANSFORM_OPTIONS = (
    Option('frame_id', '', 'The frame that is placed; empty: that of the name of the transform.'),
    Option('parent', '', 'The frame in which it is placed; empty: that of the node.'),
    Option('xyz', [0.0, 0.0, 0.0], 'Its origin in the parent, m.'),
    Option(
        'xyzw', [0.0, 0.0, 0.0, 1.0], 'Its orientation in the parent, a quaternion x, y, z, w.'
    ),
)
MOST_VIEWS = 31  # one bit each of a 32-bit mask; the first is for everything
# Other options and what rclpy itself declares: a source or view of such a name could not have its
# own.
RESERVED_NAMES = (
    *(option.name for option in NODE_OPTIONS),
    *('use_sim_time', 'qos_overrides', 'start_type_description_service'),
)
# What the node offers under its own name: `~/rays/raycast` beside `~/rays` would mislead.
OFFERED_NAMES = (
    *('raycast', 'raycast_all', 'overlap', 'clear', 'rebuild', 'validate', 'obstacles'),
    *('nearest', 'boxes', 'box_hits', 'points', 'nearest_hits', 'paths', 'path_hits'),
    *('rays', 'ray_hits', 'names', 'scene', 'tree', 'queries', 'virtual_scan'),
)
DEFAULT_SOURCE = 'markers'
DEFAULT_TYPE = 'MarkerArray'
DEFAULT_TOPIC = '~/obstacles'


def read_settings(
    node: Node, types: Mapping[str, Sequence[Option]], groups: Mapping[str, Sequence[Option]]
) -> Settings:
    """Declare and read all parameters.

    Parameters
    ----------
    types : mapping of str to sequence of Option
        The source types there are, with the options of each.
    groups : mapping of str to sequence of Option
        What else has options of its own.

    Raises
    ------
    ConfigurationError
        If a value has the wrong type or range, or contradicts another.
    """
    values = {option.name: read(node, '', option) for option in NODE_OPTIONS}
    if not values['frame_id']:
        raise ConfigurationError("parameter 'frame_id' is empty")
    names, views, transforms = (values.pop(key) for key in ('sources', 'views', 'transforms'))
    reserved = (*RESERVED_NAMES, *groups)
    _check_names('sources', names, reserved)
    _check_names('views', views, (*reserved, *OFFERED_NAMES, *names))
    _check_names('transforms', transforms, (*reserved, *names, *views))
    if len(views) > MOST_VIEWS:
        raise ConfigurationError(
            f"parameter 'views' names {len(views)} views; there can be {MOST_VIEWS}"
        )
    _check_folders(values['mesh_paths'])
    region = _region(values.pop('region'), values['planar'])
    height = values.pop('footprint_height')
    footprint = _footprint(values.pop('footprint'), height, planar=values['planar'])
    if values['path_between'] and not footprint:
        raise ConfigurationError("parameter 'path_between' needs a 'footprint'")
    settings = Settings(
        **values,
        region=region,
        footprint=footprint,
        sources=tuple(_read_source(node, name, types) for name in names),
        views=tuple(_read_view(node, name) for name in views),
        transforms=tuple(_read_transform(node, name, values['frame_id']) for name in transforms),
        groups={
            group: {option.name: read(node, f'{group}.', option) for option in options}
            for group, options in groups.items()
        },
    )
    _check_for_misspelt_options(node, [*names, *views, *transforms, *groups])
    return settings


def _check_folders(paths: Sequence[str]) -> None:
    for path in paths:
        if not (os.path.isabs(path) and os.path.isdir(path)):
            raise ConfigurationError(
                f"parameter 'mesh_paths': {shortened(path)!r} is no absolute path of a folder"
            )


def _region(
    corners: Sequence[float], planar: bool
) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    lo, hi = corners[:3], corners[3:]
    if len(corners) != 6 or any(
        a > b or a == math.inf or b == -math.inf for a, b in zip(lo, hi, strict=True)
    ):
        raise ConfigurationError(
            f"parameter 'region' must be [xmin, ymin, zmin, xmax, ymax, zmax], not {corners}"
        )
    if not any(math.isfinite(x) for x in corners):
        return None
    axes = 2 if planar else 3
    return tuple(lo[:axes]), tuple(hi[:axes])


def _footprint(given: str | Sequence[float], height: float, *, planar: bool) -> tuple[Shapes, ...]:
    if not isinstance(given, str) and tuple(given) == NO_FOOTPRINT:
        return ()
    from bvh_ros.ros import footprint

    try:
        if not isinstance(given, str):
            return footprint.of_numbers(given, FARTHEST)
        if not (planar or height > 0.0):
            raise ConfigurationError(
                "parameter 'footprint_height' must be above 0 where the footprint is a polygon"
            )
        return footprint.of_polygon(given, height or PLANAR_HEIGHT, FARTHEST)
    except ConfigurationError:
        raise
    except ValueError as error:
        shown = shortened(str(given))
        raise ConfigurationError(f"parameter 'footprint' {error}; it is {shown}") from error


def _read_source(node: Node, name: str, types: Mapping[str, Sequence[Option]]) -> SourceSettings:
    prefix = f'{name}.'
    is_default = name == DEFAULT_SOURCE
    known = ', '.join(types)
    type_option = Option('type', DEFAULT_TYPE if is_default else '', f'One of: {known}')
    topic_option = Option('topic', DEFAULT_TOPIC if is_default else '', 'Topic to subscribe to.')
    # Both visualization_msgs/MarkerArray and MarkerArray will do.
    type_name = read(node, prefix, type_option).rpartition('/')[2]
    if type_name not in types:
        raise ConfigurationError(
            f"parameter '{name}.type' must be one of {known}, not {shortened(type_name)!r}"
        )
    topic = read(node, prefix, topic_option)
    if not topic:
        raise ConfigurationError(f"source '{name}' needs a parameter '{name}.topic'")
    shared = {option.name: read(node, prefix, option) for option in SOURCE_OPTIONS}
    if shared['prefix'].startswith(ERROR_PREFIX):
        raise ConfigurationError(
            f"parameter '{name}.prefix' must not begin with {ERROR_PREFIX!r}: error replies do"
        )
    own = {option.name: read(node, prefix, option) for option in types[type_name]}
    return SourceSettings(name=name, type=type_name, topic=topic, options=own, **shared)


def _read_view(node: Node, name: str) -> ViewSettings:
    values = {option.name: read(node, f'{name}.', option) for option in VIEW_OPTIONS}
    include, exclude = tuple(values['include']), tuple(values['exclude'])
    return ViewSettings(name, include, exclude, values['skip_inside'])


def _read_transform(node: Node, name: str, frame_id: str) -> TransformSettings:
    if not any(given.startswith(f'{name}.') for given in given_at_start(node)):
        raise ConfigurationError(
            f"parameter 'transforms': {shortened(name)!r} has no parameters; "
            f"give '{name}.xyz', '{name}.xyzw' or '{name}.parent'"
        )
    values = {option.name: read(node, f'{name}.', option) for option in TRANSFORM_OPTIONS}
    xyz, xyzw = tuple(values['xyz']), tuple(values['xyzw'])
    if len(xyz) != 3 or not all(abs(x) <= FARTHEST for x in xyz):
        raise ConfigurationError(
            f"parameter '{name}.xyz' must be 3 numbers of at most {FARTHEST:g}, "
            f'not {shortened(str(list(xyz)))}'
        )
    if len(xyzw) != 4 or abs(math.hypot(*xyzw) - 1.0) > 0.01:
        raise ConfigurationError(
            f"parameter '{name}.xyzw' must be 4 numbers, a quaternion x, y, z, w of length 1"
        )
    return TransformSettings(values['frame_id'] or name, values['parent'] or frame_id, xyz, xyzw)


def _check_names(parameter: str, names: Sequence[str], taken: Sequence[str]) -> None:
    for name in names:
        if not re.fullmatch('[A-Za-z][A-Za-z0-9_]{0,79}', name):
            raise ConfigurationError(
                f"parameter '{parameter}': {shortened(name)!r} is not a name "
                '(at most 80 letters, digits and underscores)'
            )
        if name in taken:
            raise ConfigurationError(
                f"parameter '{parameter}': {shortened(name)!r} is the name of another parameter, "
                'source, view, service or topic'
            )
        if names.count(name) > 1:
            raise ConfigurationError(
                f"parameter '{parameter}': {shortened(name)!r} is there twice"
            )


def _check_for_misspelt_options(node: Node, owners: Sequence[str]) -> None:
    """Refuse options that do not exist: a misspelt `required` would make the world look safe."""
    declared = node.list_parameters([], 0).names
    for name in given_at_start(node):
        owner = name.partition('.')[0]
        if name in declared or owner == 'qos_overrides':
            continue
        question = hint(name, declared)
        if owner in owners:
            raise ConfigurationError(f"there is no parameter '{name}'{question}")
        node.get_logger().warning(f"parameter '{name}' is not one of this node{question}")


def hint(name: str, known: Sequence[str]) -> str:
    """Ask whether the most similar of these names is meant; '' if none is similar."""
    near = difflib.get_close_matches(name, known, 1)
    return f"; did you mean '{near[0]}'?" if near else ''


def given_at_start(node: Node) -> dict[str, Any]:
    """Return the parameters given at start; rclpy keeps them to itself."""
    given = getattr(node, '_parameter_overrides', {})
    return {name: parameter.value for name, parameter in given.items()}


# Parameters of the parts that draw and scan: `draw.*` and `virtual_scan.*`.

LASER_SCAN, POINT_CLOUD = 'LaserScan', 'PointCloud2'
MOST_RAYS = 1_000_000  # of one scan

DRAW_OPTIONS = (
    Option(
        'limit',
        10_000,
        'So many obstacles on ~/scene, boxes on ~/tree and rays on ~/queries are drawn at most.',
        minimum=1,
        maximum=1_000_000,
    ),
    Option('first_depth', 0, 'Upper end of the levels on ~/tree; the root has depth 0.', 0, 127),
    Option('last_depth', 6, 'Lower end of the levels on ~/tree.', 0, 127),
)
TURNS = (-100.0, 100.0)  # rad
SCAN_OPTIONS = (
    Option('pose_topic', '', 'PoseStamped of the scanner. Empty: there is no virtual scan.'),
    Option('type', LASER_SCAN, 'What ~/virtual_scan carries.', choices=(LASER_SCAN, POINT_CLOUD)),
    Option('frame_id', 'laser', "The scanner's own frame. Empty: points in the node's frame."),
    Option('view', '', 'The view that the scanner has; empty: it sees everything.'),
    Option(
        'angle_min', -math.pi, 'First direction (rad) about the z axis of the scanner.', *TURNS
    ),
    Option('angle_max', math.pi, 'Last direction (rad).', *TURNS),
    Option('angle_increment', math.pi / 180, 'Step between directions (rad).', 1e-6, math.tau),
    Option('channels', 1, 'Rings of a PointCloud2.', 1, 1024),
    Option('elevation_min', 0.0, 'Lowest ring (rad).', -math.pi / 2, math.pi / 2),
    Option('elevation_max', 0.0, 'Highest ring (rad).', -math.pi / 2, math.pi / 2),
    Option('range_min', 0.0, 'What is nearer (m) is -Inf.', 0.0, FARTHEST),
    Option('range_max', 100.0, 'What is farther (m) is +Inf.', 0.0, FARTHEST),
    Option('rate', 0.0, 'Scans a second from the newest pose; 0: one scan a pose.', 0.0, 1000.0),
)
GROUPS = {'draw': DRAW_OPTIONS, 'virtual_scan': SCAN_OPTIONS}


class DrawSettings(NamedTuple):
    """`draw.*`."""

    limit: int
    first_depth: int
    last_depth: int


class ScanSettings(NamedTuple):
    """`virtual_scan.*`, angles in rad, ranges in m."""

    pose_topic: str
    type: str
    frame_id: str
    view: str
    angle_min: float
    angle_max: float
    angle_increment: float
    channels: int
    elevation_min: float
    elevation_max: float
    range_min: float
    range_max: float
    rate: float


def draw_settings(values: Mapping[str, Any]) -> DrawSettings:
    """Return `draw.*`; ConfigurationError if the levels are upside down."""
    settings = DrawSettings(**values)
    if settings.first_depth > settings.last_depth:
        raise ConfigurationError("parameter 'draw.first_depth' exceeds 'draw.last_depth'")
    return settings


def scan_settings(values: Mapping[str, Any]) -> ScanSettings:
    """Return `virtual_scan.*`; ConfigurationError where one contradicts another."""
    settings = ScanSettings(**values)
    for what in ('angle', 'elevation', 'range'):
        if values[f'{what}_min'] > values[f'{what}_max']:
            raise ConfigurationError(
                f"parameter 'virtual_scan.{what}_min' exceeds 'virtual_scan.{what}_max'"
            )
    if settings.type == LASER_SCAN and (settings.channels > 1 or not settings.frame_id):
        raise ConfigurationError(
            "a LaserScan has one channel and a frame of its own: set 'virtual_scan.type' to "
            "PointCloud2 or change 'virtual_scan.channels' or 'virtual_scan.frame_id'"
        )
    beams = (settings.angle_max - settings.angle_min) / settings.angle_increment
    if beams * settings.channels > MOST_RAYS:
        raise ConfigurationError(
            "parameters 'virtual_scan.angle_min', 'virtual_scan.angle_max', "
            "'virtual_scan.angle_increment' and 'virtual_scan.channels' make more than "
            f'{MOST_RAYS} rays a scan'
        )
    return settings
