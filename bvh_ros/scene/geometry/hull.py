# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The vertices of a convex mesh, as kernels read them."""

from typing import Any, NamedTuple

from ...tree.jit.compiling import lean_kernel
from .shapes import MESH


class Hull(NamedTuple):
    """Vertices of a mesh, for GJK."""

    places: Any
    discs: Any
    """See `farthest`."""
    radius: Any
    """A length beyond which no vertex is, m."""


@lean_kernel
def hull_of(hulls, shape):
    """Vertices of a shape's mesh; none if it has none."""
    if shape.kind != MESH:
        return Hull(hulls.vertices[:0], hulls.discs[:0], 1.0)
    span = hulls.spans[shape.mesh]
    return Hull(
        hulls.vertices[span.vertices[0] : span.vertices[1]],
        hulls.discs[span.discs[0] : span.discs[1]],
        span.radius,
    )
