# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The kinds of topics that obstacles come from.

A module is imported only when a source of its type is configured.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, NamedTuple

from bvh_ros.ros.parameters import FARTHEST, ConfigurationError, Option, SourceSettings
from bvh_ros.ros.texts import as_line
from bvh_ros.scene import AS_CONVEX, AS_SOLID, AS_SURFACE, ShapeKind

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.sources.source import Source
    from bvh_ros.ros.world.frames import Frames
    from bvh_ros.scene import NodeScene


REACH = (-FARTHEST, FARTHEST)
NONE, GIVEN, CONSTANT_VELOCITY = 'none', 'given', 'constant_velocity'
FOLLOWING = (
    Option(
        'max_speed',
        50.0,
        'With constant_velocity: an obstacle that is faster (m/s) from one update to the next has '
        'jumped, and is at rest until the one after.',
        minimum=1e-6,
    ),
    Option(
        'smoothing',
        0.3,
        'With constant_velocity: after so many seconds a step counts 1/e. 0: only the last one '
        'counts.',
        minimum=0.0,
    ),
)


def _predict(*choices: str) -> Option:
    text = 'Where velocities come from, for questions about other times than now.'
    return Option('predict', NONE, text, choices=(NONE, *choices))


MESHES = Option(
    'meshes',
    AS_CONVEX,
    'What lists of triangles are: convex solids; solids where they are closed, else surfaces; or '
    'surfaces. Other than convex ones are compiled for at the start.',
    choices=(AS_CONVEX, AS_SOLID, AS_SURFACE),
)
OCCUPIED_AT = Option(
    'occupied_at',
    0.5,
    'Leaves of a full octomap with at least this probability are occupied.',
    *(0.0, 1.0),
)
SOLIDS = ShapeKind.BOX, ShapeKind.SPHERE, ShapeKind.CYLINDER, ShapeKind.MESH


class SourceType(NamedTuple):
    """The module of a type of source, which shapes it brings and its options."""

    module: str  # in this folder; the class is called after the type
    kinds: tuple[ShapeKind, ...]
    options: tuple[Option, ...]


SOURCE_TYPES = {
    'MarkerArray': SourceType(
        'marker_array', SOLIDS, (MESHES, _predict(CONSTANT_VELOCITY), *FOLLOWING)
    ),
    'PointCloud2': SourceType(
        'point_cloud2',
        (ShapeKind.BOX,),
        (
            Option(
                'voxel',
                0.1,
                'Edge length (m) of the cube at each point of a cloud without sizes.',
                minimum=0.0,
                maximum=FARTHEST,
            ),
            _predict(GIVEN, CONSTANT_VELOCITY),
            *FOLLOWING,
        ),
    ),
    'OccupancyGrid': SourceType(
        'occupancy_grid',
        (ShapeKind.BOX,),
        (
            Option('occupied_at', 65, 'Cells of at least this value are occupied.', 0, 127),
            Option('z_min', 0.0, 'Lower end (m) of the obstacles above the grid.', *REACH),
            Option('z_max', 2.0, 'Upper end (m) of the obstacles above the grid.', *REACH),
            Option(
                'unknown', 'free', 'What unknown cells (-1) are.', choices=('free', 'occupied')
            ),
        ),
    ),
    'Detection3DArray': SourceType(
        'detection_array', (ShapeKind.BOX,), (_predict(CONSTANT_VELOCITY), *FOLLOWING)
    ),
    'CollisionObject': SourceType('collision_object', SOLIDS, (MESHES,)),
    'PlanningScene': SourceType('planning_scene', SOLIDS, (MESHES, OCCUPIED_AT)),
    'Octomap': SourceType('octomap', (ShapeKind.BOX,), (OCCUPIED_AT,)),
}


def create_source(
    node: Node, settings: SourceSettings, scene: NodeScene, frames: Frames
) -> Source:
    """Return the source that these settings describe, not yet subscribed.

    Raises
    ------
    ConfigurationError
        If its message package is not installed, or an option cannot be used.
    """
    kind = SOURCE_TYPES[settings.type]
    try:
        module = importlib.import_module(f'{__name__}.{kind.module}')
    except ImportError as error:
        package = (error.name or __name__).partition('.')[0]
        raise ConfigurationError(
            f"source '{settings.name}' needs {package}, which cannot be imported here: "
            f'{as_line(error)}'
        ) from error
    source: Source = getattr(module, f'{settings.type}Source')(node, settings, scene, frames)
    return source
