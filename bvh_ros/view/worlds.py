# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The worlds that can be shown: a scene, its overlays, and the source of answers."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros.scene import NodeScene, Numbered, SceneHit, Shapes
from bvh_ros.tree import DynamicBVH
from bvh_ros.tree.access import PALETTE, plotting

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
MOST_BOXES = 20_000  # of the tree, in the browser
NO_POINTS, NO_LINES = np.empty((0, 3)), np.empty((0, 2, 3))
THIN = 0.01  # height of what has none, a share of the world's width


class NamedPoint(NamedTuple):
    """An obstacle that a query hit, the point of the hit, m, and the triangle of a mesh."""

    name: str
    point: Floats
    triangle: int = -1  # -1 without one


class Answer(NamedTuple):
    """The hits of a query, nearest first, its time, and the edges of the triangles that it met."""

    hits: list[NamedPoint]
    microseconds: float
    edges: Floats = NO_LINES


def answer(hits: Iterable[Any], began: float) -> Answer:
    """Of hits of a scene or a client, and when the query began (time.perf_counter)."""
    took = 1e6 * (time.perf_counter() - began)
    return Answer([NamedPoint(hit.name, np.array(hit.point)) for hit in hits], took)


def answer_of_ray(scene: NodeScene, hit: SceneHit | None, began: float) -> Answer:
    """Of a ray in a scene that has not changed since, with the triangle of a mesh."""
    if hit is None:
        return answer([], began)
    found = answer([hit], began)
    triangles = scene.triangles_met([(hit.handle, hit.triangle, hit.uv, hit.point)])
    hits = [found.hits[0]._replace(triangle=hit.triangle)]
    return found._replace(hits=hits, edges=plotting.around(triangles))


class Group(NamedTuple):
    """The obstacles of one source."""

    source: str
    shapes: Shapes
    handles: Integers


class Overlay(NamedTuple):
    """What is drawn over the obstacles."""

    lines: Floats = NO_LINES
    colours: Floats = np.empty((0, 3))  # one a line
    spots: Floats = NO_POINTS  # hits
    scan: Floats = NO_POINTS


class Frame(NamedTuple):
    """A coordinate frame within the world's."""

    name: str
    position: Floats
    orientation: Floats  # quaternion x, y, z, w


class Wanted(NamedTuple):
    """What the page shows; the rest is not computed."""

    tree: bool = False
    queries: bool = False
    scan: bool = False


class ShownWorld:
    """A scene that does not change, and answers itself.

    Parameters
    ----------
    title : str
        What is shown, in words.
    """

    frame_id = 'world'
    has_queries = False  # whether others ask, and their questions can be shown
    has_scan = False

    def __init__(self, title: str, scene: NodeScene) -> None:
        self.title = title
        self.scene = scene

    def prepare(self) -> None:
        """Compile what questions need: the first answer is to be as fast as the others."""
        nowhere = np.zeros(3)
        self.raycast(nowhere, nowhere)
        self.overlap(nowhere, nowhere)

    def advance(self, until: float) -> None:
        """Let the world go on until then (time.monotonic)."""
        time.sleep(max(0.0, until - time.monotonic()))

    def want(self, wanted: Wanted) -> None:
        """Bring what the page shows, and nothing else."""

    def version(self) -> Hashable:
        """Another one after each change of the obstacles."""
        return self.scene.population, self.scene.newest

    def groups(self) -> list[Group]:
        """All obstacles, by source."""
        most = max(1, len(self.scene))
        return [
            Group(name, self.scene.shapes_of(name, most), self.scene.handles_of(name, most))
            for name in self.scene.sources()
        ]

    def levels(self, first: int, last: int) -> tuple[Floats, Floats, Integers]:
        """Boxes of the tree from one depth to another: lo, hi, depth."""
        return self.scene.tree_levels(first, last, MOST_BOXES)

    @property
    def height(self) -> int:
        """The greatest depth there is to show."""
        return int(self.scene.stats()['height'])

    def overlay(self) -> Overlay:
        """Return what is to be drawn over the obstacles."""
        return Overlay()

    def frames(self) -> list[Frame]:
        """Return the frames that are known, without the world's own."""
        return []

    def now(self) -> int:
        """Return the time on the clock that stamps are of, ns; 0 if there is none."""
        return 0

    def figures(self) -> dict[str, str]:
        """Tell how it goes."""
        stats = self.scene.stats()
        return {'height of the tree': str(stats['height']), 'cost': f'{stats["cost"]:.4g}'}

    def raycast(self, start: Floats, goal: Floats) -> Answer:
        """Ask for the first obstacle on a segment."""
        began = time.perf_counter()
        return answer_of_ray(self.scene, self.scene.raycast(start, goal), began)

    def overlap(self, lo: Floats, hi: Floats) -> Answer:
        """Ask for all obstacles that touch a box."""
        began = time.perf_counter()
        return answer(self.scene.overlap(lo, hi), began)

    def pick(self, start: Floats, direction: Floats, reach: float) -> Answer:
        """Cast a ray from a camera; in a planar world, look up the ground point."""
        if not self.scene.planar:
            return self.raycast(start, start + direction * reach)
        down = -start[2] / direction[2] if direction[2] else 0.0
        foot = start + direction * max(down, 0.0)
        return self.overlap(foot, foot)

    def close(self) -> None:
        """Leave nothing open."""


class SavedTree(ShownWorld):
    """The file of a tree. Questions go to the tree itself, to its last bit.

    Parameters
    ----------
    path : Path
        What `DynamicBVH.save` wrote.

    Raises
    ------
    ValueError
        If the file holds no tree, or boxes too large to be drawn.
    """

    def __init__(self, path: Path) -> None:
        self.tree = tree = DynamicBVH.load(path)
        ids = tree.ids()
        lo, hi = (_upright(corner) for corner in tree.boxes(ids))
        if tree.ndim == 2 and len(ids):
            hi[:, 2] = THIN * float((hi - lo).max(axis=0).max())
        scene = NodeScene(planar=tree.ndim == 2, max_obstacles=max(1, len(ids)))
        shapes = Shapes.boxes(0.5 * lo + 0.5 * hi, hi - lo)
        for refusal in scene.update(path.name, Numbered('box/', ids), shapes, stamp=0):
            raise ValueError(f'{path}: {refusal}')
        super().__init__(f'{path.name}, {tree.ndim}D', scene)

    def levels(self, first: int, last: int) -> tuple[Floats, Floats, Integers]:
        """Boxes of the saved tree, not of a new one."""
        return self.tree.levels(first, last, MOST_BOXES)

    @property
    def height(self) -> int:
        """Of the saved tree."""
        return self.tree.height

    def figures(self) -> dict[str, str]:
        """Tell the saved tree's height and cost."""
        return {'height of the tree': str(self.height), 'cost': f'{self.tree.cost():.4g}'}

    def raycast(self, start: Floats, goal: Floats) -> Answer:
        """Ask the saved tree for the first box on a segment."""
        began = time.perf_counter()
        ndim = self.tree.ndim
        hit = self.tree.raycast(start[:ndim], (goal - start)[:ndim], 1.0)
        if hit is None:
            return answer([], began)
        point = np.append(hit.point, start[ndim:])
        return answer([NamedPoint(f'box/{hit.id}', point)], began)

    def overlap(self, lo: Floats, hi: Floats) -> Answer:
        """Ask the saved tree for all boxes that touch a box, nearest to its middle first."""
        began = time.perf_counter()
        ndim = self.tree.ndim
        lo, hi = np.minimum(lo, hi), np.maximum(lo, hi)
        ids = self.tree.overlap(lo[:ndim], hi[:ndim])
        middle = 0.5 * lo + 0.5 * hi
        points = np.tile(middle, (len(ids), 1))
        points[:, :ndim] = np.clip(middle[:ndim], *self.tree.boxes(ids))
        order = np.argsort(np.linalg.norm(points - middle, axis=1), kind='stable')
        return answer(
            [NamedPoint(f'box/{ids[row]}', points[row]) for row in order.tolist()], began
        )


def _upright(corners: Floats) -> Floats:
    """Corners (n, 3), those of a planar tree at z = 0."""
    return np.pad(corners, ((0, 0), (0, 3 - corners.shape[1])))


# ---- Groups of obstacles by the beginning of their names


MOST_NAMESPACES = len(PALETTE)  # of a source; of more, colours would repeat


class Namespaces:
    """Splits sources into namespaces; only new handles are looked at.

    An obstacle without a namespace goes by its source, as do all of a source that has too many
    namespaces, or whose handles are not known.
    """

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}
        self._handles = np.empty(0, np.int64)  # ascending
        self._of = np.empty(0, np.int64)  # their namespaces' numbers

    def split(self, scene: NodeScene, groups: Sequence[Group]) -> list[tuple[str, Shapes]]:
        """Return the parts of all groups, each with the name of its namespace or source."""
        self._learn(scene)
        found = []
        names = list(self._numbers)
        for source, shapes, handles in groups:
            numbers = self._of[np.searchsorted(self._handles, handles)]
            present = np.unique(numbers).tolist()
            if len(handles) != len(shapes.kind) or len(present) > MOST_NAMESPACES:
                found.append((source, shapes))
                continue
            for number in present:
                found.append((names[number] or source, shapes.take(numbers == number)))
        return found

    def _learn(self, scene: NodeScene) -> None:
        present = np.isin(self._handles, scene.handles())
        self._handles, self._of = self._handles[present], self._of[present]
        new = scene.names(int(self._handles[-1]) if len(self._handles) else 0)
        numbers = [
            self._numbers.setdefault(namespace_of(name), len(self._numbers)) for _, name in new
        ]
        handles = np.array([handle for handle, _ in new], np.int64)
        self._handles = np.concatenate((self._handles, handles))
        self._of = np.concatenate((self._of, np.array(numbers, np.int64)))


def namespace_of(name: str) -> str:
    """`ns` of `ns/id` and of `ns/id#k`; empty without one."""
    return name.partition('#')[0].rpartition('/')[0]


# ---- A recording with its own clock: play, pause and step


SECOND = 1_000_000_000  # ns
MOST_PASSED = 0.5  # seconds: what takes longer to show is not caught up with

Moment = tuple[float, Callable[[int], object]]  # s, and what happens then; takes that time in ns


class Recording(ShownWorld):
    """A world that goes on as it was recorded, by its own clock.

    Attributes
    ----------
    t : float
        Seconds since the beginning.
    seconds : float
        How long it is.
    playing : bool
        At the end it begins anew.
    speed : float
        Times real time.
    """

    def __init__(self, title: str, scene: NodeScene, seconds: float) -> None:
        super().__init__(title, scene)
        self.t, self.seconds = 0.0, seconds
        self.playing, self.speed = True, 1.0
        self._happened = 0  # moments
        self._began = 0  # times
        self._shown_at = time.monotonic()
        self._next: Moment | None = None
        self._moments: Iterator[Moment] = iter(())

    @abstractmethod
    def moments(self) -> Iterator[Moment]:
        """Yield what happens, from the beginning, when the world is empty."""

    @abstractmethod
    def clear(self) -> None:
        """Empty the world."""

    def restart(self) -> None:
        """Go to the first moment."""
        self.clear()
        self._began += 1
        self.t, self._moments = 0.0, self.moments()
        self._next = next(self._moments, None)
        self.seek(0.0)

    def seek(self, t: float) -> None:
        """Go to a time; backwards means from the beginning."""
        if t < self.t:
            self.restart()
        self.t = t
        while self._next is not None and self._next[0] <= t:
            when, happen = self._next
            happen(round(when * SECOND))
            self._happened += 1
            self._next = next(self._moments, None)
        self.scene.expire(round(t * SECOND))

    def step(self) -> None:
        """Pause, and go to the next moment, from the last to the first."""
        self.playing = False
        if self._next is None:
            self.restart()
        else:
            self.seek(self._next[0])

    def advance(self, until: float) -> None:
        """Play on."""
        super().advance(until)
        passed, self._shown_at = time.monotonic() - self._shown_at, time.monotonic()
        if self.playing and self._next is None:
            self.restart()
        elif self.playing:
            self.seek(self.t + self.speed * min(passed, MOST_PASSED))

    def version(self) -> Hashable:
        """Another one after each moment."""
        return self._began, self._happened, self.scene.expired

    def now(self) -> int:
        """Return the time in the recording."""
        return round(self.t * SECOND)
