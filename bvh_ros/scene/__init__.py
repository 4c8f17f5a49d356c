# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The scene: named obstacles on top of one tree. Imports neither ROS nor python-fcl."""

from .geometry.meshes import Mesh, mesh_of
from .geometry.shapes import ShapeKind, Shapes
from .parts import Part
from .refusals import Block, Refusal, Refusals
from .results import NO_NODE, BoxHits, CastHits, Obstacle, SceneHit, TooManyHitsError
from .scene import Scene
from .store.names import Families, Numbered

__all__ = [
    'NO_NODE',
    'Block',
    'BoxHits',
    'CastHits',
    'Families',
    'Mesh',
    'Numbered',
    'Obstacle',
    'Part',
    'Refusal',
    'Refusals',
    'Scene',
    'SceneHit',
    'ShapeKind',
    'Shapes',
    'TooManyHitsError',
    'mesh_of',
]
