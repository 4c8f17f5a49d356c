# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures of boxes, rays and hits with matplotlib, which is imported when one is drawn."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import checks

Floats = NDArray[np.float64]
Levels = int | tuple[int, int] | None

# Colours that colour-blind people can tell apart (Okabe and Ito 2008; the last one is ours).
# Rays have two other colours.
PALETTE = np.array(
    [
        (0.34, 0.71, 0.91),
        (0.90, 0.62, 0.00),
        (0.00, 0.45, 0.70),
        (0.80, 0.47, 0.65),
        (0.94, 0.89, 0.26),
        (0.45, 0.33, 0.68),
    ]
)
FREE_COLOUR, BLOCKED_COLOUR = np.array((0.00, 0.62, 0.45)), np.array((0.84, 0.37, 0.00))
MOST_BOXES = 10**9  # of the tree's levels: all
MOST_IN_LEGEND = 12
ROOM = 0.03  # around what is drawn, a share of its size

# Corner k of a box has the upper coordinate on axis a where bit a of k is set.
CORNERS = np.array([[k >> axis & 1 for axis in range(3)] for k in range(8)], np.float64)
EDGES = np.array([(k, k | 1 << axis) for axis in range(3) for k in range(8) if not k >> axis & 1])
# Corners of each side, counter-clockwise seen from outside.
SIDES = np.array(
    [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]
)
RING = np.array((0, 1, 3, 2))  # the corners of a flat box, in turn


class World(NamedTuple):
    """What a picture shows."""

    ndim: int
    bounds: tuple[Floats, Floats] | None  # two corners (ndim,); None: it is empty
    # By name, polygons (k, ndim); in space counter-clockwise seen from outside.
    faces: Mapping[str, Any]
    # lo, hi and depth of the tree's boxes from one depth to another, so many at most.
    levels: Callable[[int, int, int], tuple[Floats, Floats, NDArray[np.int64]]]
    # Takes starts and goals (n, ndim); returns t (n,) of the first hits, 1 at the goal; inf: free;
    # and the edges (m, 2, ndim) of the triangles that are met.
    cast: Callable[[Floats, Floats], tuple[Floats, Floats]]


def picture(axes: Any, world: World, levels: Levels, rays: Any, hits: Any) -> Any:
    """Axes with the world, rays to their first hits, more hits, and a legend; new axes if None.

    `rays` are the two ends (n, 2, ndim) of each, `hits` points (m, ndim).
    """
    ndim = world.ndim
    segments, spots = _points('rays', rays, (2, ndim)), _points('hits', hits, (ndim,))
    depths = None if levels is None else first_and_last(levels)
    if axes is None:
        axes = _new_axes(ndim)
    elif hasattr(axes, 'set_zlim') != (ndim == 3):
        raise ValueError(f'axes must have {ndim} dimensions, as what is drawn has')
    places = [*(world.bounds or ()), *segments.reshape(-1, ndim), *spots]
    if places:
        _show_all(axes, np.min(places, axis=0), np.max(places, axis=0))
    key = {name: PALETTE[k % len(PALETTE)] for k, name in enumerate(world.faces)}
    faces = [(face, key[name]) for name, several in world.faces.items() for face in several]
    _add_faces(axes, faces)
    lines = {}
    if depths is not None:
        lo, hi, depth = world.levels(*depths, MOST_BOXES)
        colours, sides = PALETTE[-1 - depth % len(PALETTE)], edges(lo, hi)
        _add_lines(axes, sides, np.repeat(colours, len(sides) // max(1, len(lo)), axis=0), 0.9)
        lines = {f'depth {k}': PALETTE[-1 - k % len(PALETTE)] for k in np.unique(depth).tolist()}
    t, outlined = np.empty(0), np.empty((0, 2, ndim))
    if len(segments):
        t, outlined = world.cast(segments[:, 0], segments[:, 1])
    blocked, steps = np.isfinite(t), segments[:, 1] - segments[:, 0]
    ends = segments[:, 0] + np.where(blocked, t, 1.0)[:, None] * steps
    if len(segments):
        rays = np.stack((segments[:, 0], ends), axis=1)
        _add_lines(axes, rays, np.where(blocked[:, None], BLOCKED_COLOUR, FREE_COLOUR), 1.8)
        if len(outlined):
            _add_lines(axes, outlined, BLOCKED_COLOUR, 1.2)
        lines |= {'free ray': FREE_COLOUR} if not blocked.all() else {}
        lines |= {'ray to its hit': BLOCKED_COLOUR} if blocked.any() else {}
    spots = np.concatenate((spots, ends[blocked]))
    if len(spots):
        dots = {'marker': 'o', 'ls': '', 'color': BLOCKED_COLOUR, 'mec': 'white', 'zorder': 9}
        axes.plot(*spots.T, label='hit', **dots, **_whole(ndim))
    _add_legend(axes, key, lines)
    return axes


def _add_legend(axes: Any, faces: Mapping[str, ArrayLike], lines: Mapping[str, ArrayLike]) -> None:
    """Name the colours of faces and lines, and what has a label."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [Patch(color=colour, label=name) for name, colour in faces.items()]
    handles += [Line2D([], [], color=colour, label=name) for name, colour in lines.items()]
    handles = handles[:MOST_IN_LEGEND] + axes.get_legend_handles_labels()[0]
    if handles:
        axes.legend(handles=handles, loc='upper left', bbox_to_anchor=(1.0, 1.0), frameon=False)


def box_faces(lo: Floats, hi: Floats) -> Floats:
    """The sides of boxes (n, 3), or the boxes (n, 2) themselves, as polygons (m, 4, ndim)."""
    corners = corners_of(lo, hi)
    return corners[:, RING] if lo.shape[1] == 2 else corners[:, SIDES].reshape(-1, 4, 3)


def _add_faces(axes: Any, faces: list[tuple[Any, Any]]) -> None:
    """Draw polygons, each in its colour."""
    if not faces:
        return
    polygons, colours = zip(*faces, strict=True)
    if hasattr(axes, 'set_zlim'):
        from matplotlib.colors import LightSource
        from mpl_toolkits.mplot3d.art3d import Poly3DCollection

        light = LightSource(azdeg=250.0, altdeg=55.0)
        lit = Poly3DCollection(
            polygons, facecolors=colours, shade=True, lightsource=light, **_whole(3)
        )
        axes.add_collection3d(lit, autolim=False)
        return
    from matplotlib.collections import PolyCollection

    flat = PolyCollection(polygons, facecolors=colours, edgecolors='white', alpha=0.9)
    axes.add_collection(flat)


def first_and_last(levels: Levels) -> tuple[int, int]:
    """Depths that `levels` means: one, or from one to another."""
    first, last = levels if isinstance(levels, tuple) else (levels, levels)
    return checks.whole('levels', first, 0), checks.whole('levels', last, 0)


def corners_of(lo: Floats, hi: Floats) -> Floats:
    """Corners (n, 2 ** ndim, ndim) of boxes, in the order of CORNERS."""
    ndim = lo.shape[1]
    corners: Floats = lo[:, None] + CORNERS[: 2**ndim, :ndim] * (hi - lo)[:, None]
    return corners


def edges(lo: Floats, hi: Floats) -> Floats:
    """Edges (n * 12, 2, 3) of boxes (n, 3), or (n * 4, 2, 2) of flat ones (n, 2)."""
    ndim = lo.shape[1]
    around = EDGES[(2**ndim > EDGES).all(axis=1)]
    return corners_of(lo, hi)[:, around].reshape(-1, 2, ndim)


def around(polygons: Floats) -> Floats:
    """Edges (m * k, 2, ndim) of polygons (m, k, ndim)."""
    following = np.roll(polygons, -1, axis=1)
    return np.stack((polygons, following), axis=2).reshape(-1, 2, polygons.shape[2])


def _points(name: str, given: Any, shape: tuple[int, ...]) -> Floats:
    points = checks.floats(name, np.empty((0, *shape)) if given is None else given)
    if points.shape[1:] != shape or points.ndim != 1 + len(shape):
        raise ValueError(f'{name} must have shape (n, {", ".join(map(str, shape))})')
    if not np.isfinite(points).all():
        raise ValueError(f'{name} must be finite')
    return points


def _whole(ndim: int) -> dict[str, bool]:
    """Axes of three dimensions show more than their own square, to which matplotlib would cut."""
    return {'clip_on': False} if ndim == 3 else {}


def _new_axes(ndim: int) -> Any:
    from matplotlib import pyplot

    figure = pyplot.figure(figsize=(9, 6), layout='constrained' if ndim == 2 else None)
    axes = figure.add_subplot(projection='3d' if ndim == 3 else None)
    axes.set_xlabel('x [m]', labelpad=12 if ndim == 3 else None)
    axes.set_ylabel('y [m]')
    if ndim == 3:
        axes.set_zlabel('z [m]')
        axes.zaxis.set_major_locator(pyplot.MaxNLocator(3))
        axes.view_init(elev=40.0, azim=-65.0)
        axes.computed_zorder = False  # rays and hits are seen through what is in front of them
        figure.subplots_adjust(0.02, 0.0, 0.82, 0.93)  # room for a title and the legend
    return axes


def _show_all(axes: Any, lo: Floats, hi: Floats) -> None:
    """One scale on all axes."""
    room = float((hi - lo).max()) * ROOM or 1e-9
    axes.set_xlim(lo[0] - room, hi[0] + room)
    axes.set_ylim(lo[1] - room, hi[1] + room)
    if len(lo) == 3:
        axes.set_zlim(lo[2], hi[2] + room)
        axes.set_box_aspect(hi - lo + room, zoom=1.1)
    else:
        axes.set_aspect('equal')


def _add_lines(axes: Any, segments: Any, colours: ArrayLike, width: float) -> None:
    if segments.shape[2] == 3:
        from mpl_toolkits.mplot3d.art3d import Line3DCollection

        lines = Line3DCollection(segments, colors=colours, linewidths=width, zorder=8, **_whole(3))
        axes.add_collection3d(lines, autolim=False)
        return
    from matplotlib.collections import LineCollection

    axes.add_collection(LineCollection(segments, colors=colours, linewidths=width, zorder=8))
