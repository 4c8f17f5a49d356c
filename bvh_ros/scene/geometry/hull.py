# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The vertices of a convex mesh, as kernels read them."""

from typing import Any, NamedTuple

from numba import types

from ...tree.compiler import chosen_by_types
from .shapes import MESH


class Hull(NamedTuple):
    """Vertices of a mesh, for GJK."""

    places: Any
    discs: Any
    """See `farthest`."""
    radius: Any
    """A length beyond which no vertex is, m."""


@chosen_by_types
def hull_of(hulls, shape):
    """Vertices of a shape's mesh, none if it has none; None where there are no meshes."""
    return _nothing_of if isinstance(hulls, types.NoneType) else _vertices_of


@chosen_by_types
def hull_of_point(hull):
    """A hull without vertices, of the same type."""
    return _nothing if isinstance(hull, types.NoneType) else _no_vertices


def _nothing_of(hulls, shape):
    return None


def _vertices_of(hulls, shape):
    if shape.kind != MESH:
        return Hull(hulls.vertices[:0], hulls.discs[:0], 1.0)
    span = hulls.spans[shape.mesh]
    return Hull(
        hulls.vertices[span.vertices[0] : span.vertices[1]],
        hulls.discs[span.discs[0] : span.discs[1]],
        span.radius,
    )


def _nothing(hull):
    return None


def _no_vertices(hull):
    return Hull(hull.places[:0], hull.discs[:0], 1.0)
