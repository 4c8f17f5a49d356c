# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Named obstacles with shape, pose, lifetime and category, on top of one tree."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, Any, Concatenate, NoReturn, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..tree.access import checks, plotting
from .distance.distances import Distances
from .distance_queries import DistanceQueries
from .inspection import Inspection
from .names import UNKNOWN
from .overlap_queries import OverlapQueries
from .ray_queries import RayQueries
from .shapes.shape import Floats
from .store import Obstacles, in_seconds
from .sweep_queries import SweepQueries
from .timed_queries import TimedQueries
from .updates import Categorise, Removals, Updates, as_region

if TYPE_CHECKING:
    from typing_extensions import Self


P = ParamSpec('P')
R = TypeVar('R')


def method_of(
    part: str, method: Callable[Concatenate[Any, P], R]
) -> Callable[Concatenate[Any, P], R]:
    """A part's method as one of the whole; `part` is the attribute that holds the part. Signature
    and docstring are the part's own.

    While a change is unfinished it raises a RuntimeError; so every method does that needs what the
    scene holds.
    """

    @wraps(method)
    def ask(whole: Any, /, *arguments: P.args, **named: P.kwargs) -> R:
        whole._store.change.require_none()
        return method(getattr(whole, part), *arguments, **named)

    return ask


FOR_EVER = 1e290  # s: beyond, a time in ns would leave the doubles


class Scene(RayQueries, OverlapQueries, DistanceQueries, SweepQueries):
    """Obstacles that come and go, and the questions about them.

    The caller passes all times in; the scene reads no clock. A time (`stamp`, `expires`, `at`,
    `until`, `now`) is an int in nanoseconds or a float in seconds, as of `time.time_ns()` and
    `time.time()`. Positions are in metres, all in one frame. Any number of threads may query the
    scene while none changes it: that is up to the caller. A query within a change, or after one
    that was interrupted, is a RuntimeError.

    Parameters
    ----------
    planar : bool
        The world seen from above: a 2D tree of footprints. z is ignored in obstacles and queries;
        points get the start's z.
    margin : float
        Fat boxes in the tree, m: small moves cost nothing. Answers do not depend on it.
    max_obstacles : int
        New obstacles beyond this number are refused.
    categorise : callable, optional
        Gives names their 32-bit masks. Asked once for each new obstacle whose update does not
        bring its categories along; without it they are 1.
    meshes : bool
        Expect meshes: else the first one makes the kernels of the queries compile anew.
    any_mesh : bool
        The same of meshes that are not convex.
    region : (lo, hi), optional
        Corners of a box, shape (2,) or (3,) as the scene is planar or not; may be infinite. Only
        obstacles whose bounds touch it are kept: one that leaves it is removed. An obstacle with
        a velocity is kept if its bounds may touch it within `max_prediction` of its stamp.
    max_prediction : float
        An obstacle with a velocity moves for so many seconds after its stamp, to the nearest
        nanosecond, and then stays there.
    uncertainty : float
        An obstacle with a velocity other than zero is, at another time than its stamp, so much
        larger all round (m) for each second between. In a planar scene only vx and vy count.
        Rays and swept balls meet it as large as it is at the end of their way, rounded corners and
        all: sooner than it may be there, never later. Its points and distances are those of the
        grown shape.

    Examples
    --------
    >>> from bvh_ros.scene import Scene, Shapes
    >>> scene = Scene()
    >>> crates = Shapes.boxes([[2, 0, 0], [5, 0, 0]], [1, 1, 1])
    >>> scene.update('camera', ['near', 'far'], crates, stamp=0)
    []
    >>> hit = scene.raycast([0, 0, 0], [10, 0, 0])
    >>> hit.name, hit.t, hit.point.tolist(), hit.normal.tolist()
    ('near', 0.15, [1.5, 0.0, 0.0], [-1.0, 0.0, 0.0])
    >>> [hit.name for hit in scene.overlap([4, -1, -1], [9, 1, 1])]
    ['far']
    """

    def __init__(
        self,
        *,
        planar: bool = False,
        margin: float = 0.0,
        max_obstacles: int = 1_000_000,
        categorise: Categorise | None = None,
        meshes: bool = False,
        any_mesh: bool = False,
        region: tuple[ArrayLike, ArrayLike] | None = None,
        max_prediction: float = math.inf,
        uncertainty: float = 0.0,
    ) -> None:
        given: Any = categorise
        if not (given is None or callable(given)):
            shown = checks.shown_short(given)
            raise ValueError(f'categorise must be callable or None, not {shown}')
        flat, meshes = checks.flag('planar', planar), checks.flag('meshes', meshes)
        any_mesh = checks.flag('any_mesh', any_mesh)
        store = Obstacles(flat, margin, meshes or any_mesh, max_obstacles, any_mesh)
        going = checks.limit('max_prediction', max_prediction)
        store.max_prediction = in_seconds(round(going * 1e9)) if going < FOR_EVER else math.inf
        store.uncertainty = checks.limit('uncertainty', uncertainty)
        if math.isinf(store.uncertainty):
            raise ValueError('uncertainty must be finite')
        self._begin(store, Updates(store, categorise, as_region(region, flat)))

    def _begin(self, store: Obstacles, updates: Updates) -> None:
        self._store, self._timed = store, TimedQueries(store)
        self._distances = Distances(store)
        self._updates = updates
        self._removals = Removals(store)
        self._inspection = Inspection(store)

    def copy(self) -> Self:
        """Return a scene that holds what this one does, and goes its own way from now on."""
        self._store.change.require_none()
        other = object.__new__(type(self))
        store = copy.deepcopy(self._store)
        other._begin(store, self._updates.of(store))
        return other

    def __deepcopy__(self, memo: object) -> Self:
        return self.copy()

    def __reduce_ex__(self, protocol: object) -> NoReturn:
        raise TypeError('a Scene is neither pickled nor shared: copy() makes an independent one')

    # ---- changes

    update = method_of('_updates', Updates.update)
    replace = method_of('_updates', Updates.replace)
    remove = method_of('_removals', Removals.remove)
    remove_group = method_of('_removals', Removals.remove_group)
    remove_namespace = method_of('_removals', Removals.remove_namespace)
    expire = method_of('_removals', Removals.expire)
    shift_expiries = method_of('_removals', Removals.shift_expiries)

    def clear(self) -> int:
        """Remove all obstacles; return how many there were.

        Also what a change left that was interrupted: then the scene begins anew.
        """
        return self._store.clear()

    def rebuild(self) -> None:
        """Build the tree anew."""
        self._store.change.require_none()
        self._store.tree.rebuild()

    # ---- what there is

    get = method_of('_inspection', Inspection.get)
    handles = method_of('_inspection', Inspection.handles)
    names = method_of('_inspection', Inspection.names)
    name_of = method_of('_inspection', Inspection.name_of)
    names_of = method_of('_inspection', Inspection.names_of)
    sources = method_of('_inspection', Inspection.sources)
    stats = method_of('_inspection', Inspection.stats)
    count = method_of('_inspection', Inspection.count)
    validate = method_of('_inspection', Inspection.validate)

    def plot(
        self,
        axes: Any = None,
        *,
        levels: plotting.Levels = None,
        rays: ArrayLike | None = None,
        hits: ArrayLike | None = None,
    ) -> Any:
        """Draw the obstacles with matplotlib, a colour a source; a planar scene from above.

        Parameters, and what is returned, as in `DynamicBVH.plot`. Where a ray meets a mesh, the
        triangle is outlined.
        """
        ndim, inspection = 2 if self.planar else 3, self._inspection

        def cast(starts: Floats, goals: Floats) -> tuple[Floats, Floats]:
            level = ((0, 0), (0, 3 - ndim))
            hits = self.sweep_many(np.pad(starts, level), np.pad(goals, level))
            columns = hits.handles.tolist(), hits.triangles.tolist(), hits.uv, hits.points
            triangles = inspection.triangles_met(zip(*columns, strict=True))
            return hits.t, plotting.around(triangles[..., :ndim])

        world = plotting.World(ndim, self.bounds, inspection.faces(), inspection.tree_levels, cast)
        return plotting.picture(axes, world, levels, rays, hits)

    def __repr__(self) -> str:
        kind = 'planar' if self.planar else '3D'
        count, sources = len(self), len(self._store.groups.by_source())
        return (
            f'{type(self).__name__}({kind}, {count:,} obstacle{"s" * (count != 1)} of {sources:,} '
            f'source{"s" * (sources != 1)})'
        )

    def __len__(self) -> int:
        return len(self._store)

    def __contains__(self, name: object) -> bool:
        self._store.change.require_none()
        return isinstance(name, str) and self._store.registry.slot(name) != UNKNOWN

    @property
    def planar(self) -> bool:
        """Whether the world is seen from above."""
        return self._store.planar

    @property
    def max_obstacles(self) -> int:
        """New obstacles beyond this number are refused."""
        return self._store.most

    @property
    def max_prediction(self) -> float:
        """How long obstacles with velocities move on, s."""
        return self._store.max_prediction

    @property
    def newest(self) -> int:
        """Stamp of the newest update included, ns; 0 if there is none."""
        return self._store.newest

    @newest.setter
    def newest(self, stamp: int) -> None:
        self._store.newest = stamp

    @property
    def expired(self) -> int:
        """How many obstacles `expire` has removed so far."""
        return self._removals.expired

    @property
    def interrupted(self) -> bool:
        """Whether a change was interrupted, by Ctrl-C or want of memory (or is under way in
        another thread): until `clear` every query and change raises a RuntimeError.
        """
        return self._store.change.unfinished

    @property
    def bounds(self) -> tuple[Floats, Floats] | None:
        """Smallest box around all obstacles, as (lo, hi); None if there is none."""
        return self._store.tree.bounds
