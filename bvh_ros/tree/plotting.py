# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures of boxes, rays and hits with matplotlib, which is imported when one is drawn."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import checks

Floats = NDArray[np.float64]
Levels = int | tuple[int, int] | None

# Colours that colour-blind people can tell apart (Okabe and Ito 2008).
PALETTE = np.array(
    [
        (0.34, 0.71, 0.91),
        (0.90, 0.62, 0.00),
        (0.00, 0.62, 0.45),
        (0.80, 0.47, 0.65),
        (0.94, 0.89, 0.26),
        (0.00, 0.45, 0.70),
        (0.84, 0.37, 0.00),
    ]
)
FREE_WAY, BLOCKED_WAY = PALETTE[2], PALETTE[6]
MOST_BOXES = 10**9  # of the tree's levels: all
ROOM = 0.03  # around what is drawn, a share of its size

# Corner k of a box has the upper coordinate on axis a where bit a of k is set.
CORNERS = np.array([[k >> axis & 1 for axis in range(3)] for k in range(8)], np.float64)
EDGES = np.array([(k, k | 1 << axis) for axis in range(3) for k in range(8) if not k >> axis & 1])
# Corners of each side, counter-clockwise seen from outside.
SIDES = np.array(
    [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]
)
RING = np.array((0, 1, 3, 2))  # the corners of a flat box, in turn


def picture(
    axes: Any, bounds: tuple[Floats, Floats] | None, ndim: int, rays: Any, hits: Any
) -> Any:
    """Axes that show all of the world, drawn with rays and hits; new ones if `axes` is None.

    `bounds` is the box around the world, `rays` (n, 2, ndim) their two ends, `hits` (m, ndim).
    """
    segments = _points('rays', rays, (2, ndim))
    spots = _points('hits', hits, (ndim,))
    if axes is None:
        axes = _new_axes(ndim)
    elif hasattr(axes, 'set_zlim') != (ndim == 3):
        raise ValueError(f'axes must have {ndim} dimensions, as what is drawn has')
    places = [*(bounds or ()), *segments.reshape(-1, ndim), *spots]
    if places:
        _show_all(axes, np.min(places, axis=0), np.max(places, axis=0))
    if len(segments):
        _add_lines(axes, segments, [BLOCKED_WAY if len(spots) else FREE_WAY], 1.6)
    if len(spots):
        axes.plot(
            *spots.T, 'o', color=BLOCKED_WAY, markeredgecolor='white', zorder=9, **_whole(ndim)
        )
    return axes


def add_boxes(axes: Any, lo: Floats, hi: Floats, colour: ArrayLike) -> None:
    """Draw boxes (n, ndim) by their sides."""
    corners = corners_of(lo, hi)
    rings = corners[:, RING] if lo.shape[1] == 2 else corners[:, SIDES].reshape(-1, 4, 3)
    add_faces(axes, rings, colour)


def add_faces(axes: Any, faces: Any, colours: ArrayLike) -> None:
    """Draw polygons, each (k, 2) in the plane or (k, 3), counter-clockwise seen from outside, in
    one colour or each in its own.
    """
    if not len(faces):
        return
    if hasattr(axes, 'set_zlim'):
        from matplotlib.colors import LightSource
        from mpl_toolkits.mplot3d.art3d import Poly3DCollection

        light = LightSource(azdeg=250.0, altdeg=55.0)
        lit = Poly3DCollection(
            faces, facecolors=colours, shade=True, lightsource=light, **_whole(3)
        )
        axes.add_collection3d(lit, autolim=False)
        return
    from matplotlib.collections import PolyCollection

    axes.add_collection(PolyCollection(faces, facecolors=colours, edgecolors='white', alpha=0.9))


def add_levels(axes: Any, lo: Floats, hi: Floats, depths: NDArray[np.int64]) -> None:
    """Draw the tree's boxes by their edges, each depth in a colour of its own."""
    segments = edges(lo, hi)
    each = len(segments) // max(len(lo), 1)
    colours = np.repeat(PALETTE[depths % len(PALETTE)], each, axis=0)
    _add_lines(axes, segments, colours, 0.9)


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

    figure = pyplot.figure(figsize=(9, 6))
    axes = figure.add_subplot(projection='3d' if ndim == 3 else None)
    axes.set_xlabel('x [m]', labelpad=12 if ndim == 3 else None)
    axes.set_ylabel('y [m]')
    if ndim == 3:
        axes.set_zlabel('z [m]')
        axes.zaxis.set_major_locator(pyplot.MaxNLocator(3))
        axes.view_init(elev=40.0, azim=-65.0)
        axes.computed_zorder = False  # rays and hits are seen through what is in front of them
        figure.subplots_adjust(0.0, 0.0, 0.97, 0.94)
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
