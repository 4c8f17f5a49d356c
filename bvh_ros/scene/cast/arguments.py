# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the kernels of this room are given.

Of `geometry` (a pair: records of `records.GEOMETRY`, one a slot, and the `mesh_store.Hulls`, or
None) and `footprints` (the same with records of `footprint.FOOTPRINT`) one is None: numba drops a
branch that asks for an argument that is None, so that a planar scene compiles none of the solid
shapes, and a scene without meshes nothing of theirs.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from ...tree.access import NOTHING, RAY_FLOATS, RAY_ROWS, ROOT, OpenTree, checks
from ...tree.compiler import chosen_by_types, entry_point, inlined, lean_kernel
from ..shapes.shape import Floats
from ..store import Columns

SCRATCH = RAY_FLOATS + 21  # floats of a `Scratch`
UNIT_T_MAX = np.ones(1)  # of segments
THIN = NOTHING  # the radii of thin rays
# slot, t, point, normal; where there are meshes, a row of `room_for_triangles`, too
BoxHit = tuple[int, float, Floats, Floats] | tuple[int, float, Floats, Floats, Floats]


class CastWorld(NamedTuple):
    """What rays go through."""

    nodes: Any
    tight: Any
    handles: Any
    root: Any
    geometry: Any
    footprints: Any


class Rays(NamedTuple):
    """n rays, or balls that go along them. A column of one row is one for all."""

    origins: Any
    """(n, 3), as the directions."""
    directions: Any
    """Or the goals, as `to_goals` says: then t_max is 1."""
    t_max: Any
    masks: Any
    radii: Any
    """THIN itself for thin rays."""
    to_goals: Any
    skip_inside: Any
    every: Any
    """Whether all obstacles that a ball meets are wanted, not only the first."""


class Hits(NamedTuple):
    """Hits, one a row."""

    slots: Any
    ts: Any
    features: Any


class Sweep(NamedTuple):
    """One thin ray, or ball."""

    origin: Floats
    direction: Floats
    radius: float
    mask: np.uint32
    skip_inside: bool
    every: bool


class Scratch(NamedTuple):
    """Room for one ray; see `slab` for its rows."""

    ray: Any
    box: Any
    work: Any


def every_row(values: NDArray[Any], count: int) -> NDArray[Any]:
    """What is one for all, or one a row, as one a row."""
    return values if len(values) == count else np.full(count, values[0])


def refuse_infinite(rays: Rays) -> None:
    """ValueError if a ray is not finite, or the path of a ball has no end."""
    names = ('starts', 'goals') if rays.to_goals else checks.RAY_ARGUMENTS
    checks.finite(names[0], rays.origins)
    checks.finite(names[1], rays.directions)
    count = len(rays.origins)
    with np.errstate(over='ignore', invalid='ignore'):
        if rays.to_goals:
            finite = np.isfinite(rays.directions - rays.origins).all(axis=1)
        elif rays.radii is THIN:  # a thin ray may have no end
            return
        else:
            lengths = every_row(rays.t_max, count)[:, None]
            finite = np.isfinite(rays.directions * lengths).all(axis=1)
            finite |= every_row(rays.radii, count) == 0.0
    if finite.all():
        return
    row = np.flatnonzero(~finite)[0]
    if rays.to_goals:
        raise ValueError(f'the segment of row {row} is longer than the largest double')
    raise ValueError(f't_max must end the path of a ball: row {row} has no end')


@lean_kernel
def fill_directions(starts, goals, directions):
    """Fill in the directions (n, 3) from starts to goals; return the first row that is not finite,
    or -1 without any.
    """
    for i in range(starts.shape[0]):
        for axis in range(3):
            directions[i, axis] = goals[i, axis] - starts[i, axis]
            if not np.isfinite(directions[i, axis]):
                return np.int64(i)
    return np.int64(-1)


@functools.cache
def directions_entry() -> Callable[..., Any]:
    """The machine code of `fill_directions`."""
    return entry_point(fill_directions, *(np.empty((0, 3)),) * 3)


def world_of(tree: OpenTree, columns: Columns) -> CastWorld:
    """The arrays of a scene."""
    nodes, _, tight, handles, state = tree.view().tree
    # As CastWorld(...), which would take one more call of a function of Python's.
    parts = nodes, tight, handles, state.item(ROOT), *columns.shapes
    return tuple.__new__(CastWorld, parts)


_codes: dict[tuple[Any, ...], Any] = {}


def code_for(
    kernel: Any,
    shapes: tuple[Any, Any],
    given: tuple[Any, ...],
    variant: object = None,
    calls: Callable[..., int] | None = None,
) -> Any:
    """The machine code of a kernel that takes a world, or `Columns.shapes`, and always the same
    types besides, but for those that `variant` distinguishes: numba would look at every array.
    If it has `calls`, the kernel calls another one at the address that this returns for the
    arguments given, and takes that before them.
    """
    solid, flat = shapes
    some = solid or flat
    key = kernel, solid is None, flat is None, type(some and some[1]), variant
    code = _codes.get(key)
    if code is None:
        if calls is None:
            code = entry_point(kernel, *given)
        else:
            address = calls(*given)
            code = functools.partial(entry_point(kernel, address, *given), address)
        _codes[key] = code
    return code


def call(kernel: Any, world: CastWorld, *arguments: Any) -> Any:
    """Call a kernel that takes a world, as of `code_for`."""
    given = world, *arguments
    return code_for(kernel, (world.geometry, world.footprints), given)(*given)


@inlined
def scratch_in(memory, ndim):
    """Room for one ray in SCRATCH floats, which kernels have on their stack."""
    ray, box = memory[: RAY_ROWS * ndim], memory[RAY_FLOATS : RAY_FLOATS + 2 * ndim]
    work = memory[RAY_FLOATS + 6 : SCRATCH]
    return Scratch(ray.reshape(RAY_ROWS, ndim), box.reshape(2, ndim), work.reshape(5, 3))


# ---- The triangle of a mesh that a thin ray meets: its row in the mesh as given, -1 for any other
# hit, and u and v, NaN then.


def room_for_triangles(shapes: tuple[Any, Any], count: int) -> Floats | None:
    """Where kernels write the triangles (count, 3) that rays meet; shapes as of `Columns.shapes`.
    None where there are no meshes in space: what is None is not compiled.
    """
    solid = shapes[0]
    return None if solid is None or solid[1] is None else np.empty((count, 3))


@chosen_by_types
def triangles_in(shapes, rows):
    """Rows as `room_for_triangles`, or None."""
    solid = shapes[0]
    has_meshes = not (isinstance(solid, types.NoneType) or isinstance(solid[1], types.NoneType))
    return _rows_themselves if has_meshes else _no_rows


@inlined
def _rows_themselves(shapes, rows):
    return rows


@inlined
def _no_rows(shapes, rows):
    return None


@inlined
def triangle_of(triangles, row):
    """A row of `room_for_triangles`, or None."""
    if triangles is None:
        return None
    return triangles[row]


@lean_kernel
def clear_triangle(triangle):
    """Write that no triangle is hit."""
    if triangle is not None:
        triangle[0], triangle[1], triangle[2] = -1.0, np.nan, np.nan


def too_long(start: Floats, goal: Floats) -> ValueError:
    """What is raised where the segment between two points is not finite."""
    checks.point('start', start, 3)
    checks.point('goal', goal, 3)
    return ValueError('the segment from start to goal is longer than the largest double')
