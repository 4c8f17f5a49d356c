# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node's parameters, read once into plain settings."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from bvh_ros.ros.config.option import FARTHEST, ConfigurationError, Option, read
from bvh_ros.ros.config.settings import Settings, SourceSettings, TransformSettings, ViewSettings
from bvh_ros.ros.texts import shortened
from bvh_ros.scene.rows import ERROR_PREFIX

if TYPE_CHECKING:
    from rclpy.node import Node

NO_FOOTPRINT = (0.0,)
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
        'reply is written nobody else is answered, 10 us an obstacle.',
        minimum=1,
        maximum=2**31 - 1,
    ),
    Option(
        'nearest_limit',
        16,
        'How many obstacles nearest to a point ~/nearest tells of at most.',
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
        'So far ahead of the newest data (s) there are answers, where a source predicts; who was '
        'not told for longer stays where it is predicted last.',
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
        'So much before the newest data (s) can be asked about: the world is copied after each '
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
        'What goes along the paths on ~/paths, centred on each pose: edge lengths of a box, or '
        'the radius of a ball (m). 0: there are no such topics.',
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
)
SOURCE_OPTIONS = (
    Option('prefix', '', 'Begins the name of every obstacle of this source.'),
    Option('required', False, 'Until this source has told all, every query answers an error.'),
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
    Option('xyzw', [0.0, 0.0, 0.0, 1.0], 'Its orientation in the parent, a quaternion.'),
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
    region = _region(values.pop('region'), values['planar'])
    footprint = _footprint(values.pop('footprint'))
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


def _footprint(lengths: Sequence[float]) -> tuple[float, ...]:
    if tuple(lengths) == NO_FOOTPRINT:
        return ()
    if len(lengths) not in (1, 3) or not all(0.0 < length <= FARTHEST for length in lengths):
        raise ConfigurationError(
            "parameter 'footprint' must be [sx, sy, sz] of a box or [radius] of a ball, above 0 "
            f'and at most {FARTHEST:g}, not {shortened(str(lengths))}'
        )
    return tuple(lengths)


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
    if len(xyzw) != 4 or not any(xyzw):
        raise ConfigurationError(f"parameter '{name}.xyzw' must be 4 numbers that are not all 0")
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
    """Refuse options that nobody reads: a misspelt `required` would make the world look safe."""
    declared = node.list_parameters([], 0).names
    for name in given_at_start(node):
        owner = name.partition('.')[0]
        if name in declared or owner == 'qos_overrides':
            continue
        near = difflib.get_close_matches(name, declared, 1)
        hint = f"; did you mean '{near[0]}'?" if near else ''
        if owner in owners:
            raise ConfigurationError(f"there is no parameter '{name}'{hint}")
        node.get_logger().warning(f"parameter '{name}' is not one of this node{hint}")


def given_at_start(node: Node) -> dict[str, Any]:
    """Return the parameters given at start; rclpy keeps them to itself."""
    given = getattr(node, '_parameter_overrides', {})
    return {name: parameter.value for name, parameter in given.items()}
