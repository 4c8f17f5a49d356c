# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Triangles to meshes, while others have their turn."""

from __future__ import annotations

from collections.abc import Generator

from bvh_ros.ros.conversions.marker_table import Floats
from bvh_ros.scene import Mesh, mesh_of
from bvh_ros.scene.store import run_in_thread

MANY = 500  # triangles: more take longer than 10 ms


def examined(triangles: Floats, planar: bool) -> Generator[None, None, Mesh]:
    """Make a mesh of triangles (n, 3, 3) and all that a scene needs of it; pause now and then.

    A large one takes a second, most of it in numpy, so another thread examines it.

    Raises
    ------
    ValueError
        If they are no convex solid.
    """
    if len(triangles) <= MANY:
        mesh = _examine(triangles, planar)
        yield
        return mesh
    return (yield from run_in_thread(_examine, triangles, planar))


def _examine(triangles: Floats, planar: bool) -> Mesh:
    mesh = mesh_of(triangles)
    # Made when they are first asked for, and kept.
    _ = mesh.outline if planar else (mesh.tree, mesh.discs)
    return mesh
