# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The scene: named obstacles on top of one tree. Imports neither ROS nor python-fcl."""

from .names import Families, Numbered
from .node_scene import NodeScene
from .results import (
    NO_NODE,
    Block,
    BoxHits,
    CastHits,
    Clearances,
    NearestObstacles,
    Obstacle,
    Refusal,
    Refusals,
    SceneHit,
    ShapeSweeps,
    TooManyHitsError,
)
from .scene import Scene
from .shapes.mesh import AS_CONVEX, AS_SOLID, AS_SURFACE, Mesh, mesh_of
from .shapes.shape import ShapeKind, Shapes, unchecked_shapes
from .updates import Part

__all__ = [
    'AS_CONVEX',
    'AS_SOLID',
    'AS_SURFACE',
    'NO_NODE',
    'Block',
    'BoxHits',
    'CastHits',
    'Clearances',
    'Families',
    'Mesh',
    'NearestObstacles',
    'NodeScene',
    'Numbered',
    'Obstacle',
    'Part',
    'Refusal',
    'Refusals',
    'Scene',
    'SceneHit',
    'ShapeKind',
    'ShapeSweeps',
    'Shapes',
    'TooManyHitsError',
    'mesh_of',
    'unchecked_shapes',
]
