# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a scene tells about itself."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree.access import Ids, checks
from ..tree.access import plotting as boxes
from . import plotting
from .geometry.polygon import Polygon
from .geometry.shapes import Floats, ShapeKind, Shapes, shapes_of
from .results import LAST_NODE_HANDLE, Obstacle
from .store.beside import beside
from .store.obstacles import Obstacles
from .store.updating import text


class Inspection:
    """Names, sizes and soundness of a scene."""

    def __init__(self, held: Obstacles) -> None:
        self._held = held

    def get(self, name: str) -> Obstacle:
        """What is known of one obstacle. KeyError if there is none of this name."""
        slot = self._held.slot(name)
        columns = self._held.columns
        geometry = columns.geometry[slot]
        group = self._held.groups.group(int(columns.group[slot]))
        return Obstacle(
            name,
            int(columns.node_handle[slot]),
            ShapeKind(int(geometry['kind'])),
            geometry['position'].copy(),
            geometry['orientation'].copy(),
            geometry['half'] * 2.0,
            int(columns.stamp[slot]),
            int(columns.expires[slot]),
            group.source,
            group.name,
        )

    def handles(self) -> NDArray[np.int64]:
        """Node handles of all obstacles, ascending."""
        handles = self._held.columns.node_handle
        return np.sort(handles[(handles > 0) & ~self._held.columns.shadow])

    def names(self, after: int = 0) -> list[tuple[int, str]]:
        """(node handle, name) of the obstacles with a handle above `after`, by handle."""
        return list(self.names_of(*self.newcomers(after)))

    def newcomers(self, after: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Node handles above `after`, ascending, and a number for each that `names_of` takes."""
        slots = self._held.columns.used()
        slots = slots[~self._held.columns.shadow[slots]]
        handles = self._held.columns.node_handle[slots]
        first = int(np.searchsorted(handles, checks.whole('after', after, 0), side='right'))
        return handles[first:], slots[first:]

    def names_of(
        self, handles: NDArray[np.int64], slots: NDArray[np.int64]
    ) -> Iterator[tuple[int, str]]:
        """(node handle, name) of those newcomers that are still there."""
        there = self._held.columns.node_handle[slots] == handles
        for handle, slot in zip(handles[there].tolist(), slots[there].tolist(), strict=True):
            yield handle, self._held.registry.name(slot)

    def name_of(self, handle: int) -> str:
        """Name of the obstacle with this node handle. KeyError if there is none (any more)."""
        handle = checks.whole('handle', handle, 0)
        slots = np.flatnonzero(self._held.columns.node_handle == handle)
        if handle <= 0 or not len(slots):
            raise KeyError(f'no obstacle has the node handle {handle}')
        return self._held.registry.name(int(slots[0]))

    def sources(self) -> list[str]:
        """The sources that ever had an obstacle."""
        return list(self._held.groups.by_source())

    def shapes_of(self, source: str, most: int) -> Shapes:
        """Canonical shapes of the first obstacles of a source, by handle: a mesh has the position
        of the middle of its box.
        """
        slots = self._slots_of(source, most)
        geometry = self._held.columns.geometry[slots]
        kind, mesh = geometry['kind'], None
        if (kind == ShapeKind.MESH).any():
            mesh = np.empty(len(slots), object)
            for row in np.flatnonzero(kind == ShapeKind.MESH).tolist():
                held = self._held.columns.meshes[int(geometry['mesh'][row])]
                mesh[row] = held.mesh if isinstance(held, Polygon) else held
        return shapes_of(geometry)._replace(mesh=mesh)

    def handles_of(self, source: str, most: int) -> NDArray[np.int64]:
        """Node handles of a source's obstacles, row for row those of `shapes_of`."""
        return self._held.columns.node_handle[self._slots_of(source, most)]

    def _slots_of(self, source: str, most: int) -> NDArray[np.int64]:
        """Slots of the first obstacles of a source, by node handle."""
        most = checks.whole('most', most, 0)
        number = self._held.groups.source(text('source', source))
        mine = np.flatnonzero(self._held.columns.source == number)
        handles = self._held.columns.node_handle[mine]
        if len(mine) > most:
            first = np.argpartition(handles, most)[:most]
            mine, handles = mine[first], handles[first]
        return mine[np.argsort(handles, kind='stable')]

    def plot(
        self,
        axes: Any = None,
        *,
        levels: boxes.Levels = None,
        rays: ArrayLike | None = None,
        hits: ArrayLike | None = None,
    ) -> Any:
        """Draw the obstacles with matplotlib, a colour a source; a planar scene from above.

        Parameters, and what is returned, as in `DynamicBVH.plot`.
        """
        ndim = self._held.tree.ndim
        axes = boxes.picture(axes, self._held.tree.bounds, ndim, rays, hits)
        faces: list[Floats] = []
        colours: list[Floats] = []
        for number, source in enumerate(self.sources()):
            shapes = self.shapes_of(source, len(self._held.columns.source))
            drawn = plotting.outlines(shapes) if ndim == 2 else plotting.faces(shapes)
            faces += drawn
            colours += [boxes.PALETTE[number % len(boxes.PALETTE)]] * len(drawn)
        boxes.add_faces(axes, faces, colours)
        if levels is not None:
            depths = boxes.first_and_last(levels)
            boxes.add_levels(axes, *self.tree_levels(*depths, boxes.MOST_BOXES))
        return axes

    def tree_levels(self, first: int, last: int, most: int) -> tuple[Floats, Floats, Ids]:
        """lo, hi and depth of the tree's boxes from depth `first` to `last`; the root's is 0."""
        return self._held.tree.levels(first, last, most)

    def stats(self) -> dict[str, Any]:
        """Sizes, the tree's shape, and which parts this scene uses."""
        tree = self._held.tree.stats()
        return {
            'boxes': len(self._held),
            'planar': self._held.planar,
            'margin': tree['margin'],
            'height': tree['height'],
            'cost': tree['cost'],
            'sources': self._held.groups.by_source(),
            'shaped': self._held.columns.shaped,
            'bytes': self._held.columns.nbytes + self._held.columns.meshes.nbytes,
            'meshes': len(self._held.columns.meshes),
            'mortal': int(np.count_nonzero(self._held.columns.expires)),
            'node_handles_left': LAST_NODE_HANDLE - self._held.next_node_handle + 1,
            'narrow_phase': self._held.columns.shaped > 0,
            'pairs_compared': self._held.columns.pairs_compared,
            'pairs_in_more_digits': self._held.columns.pairs_in_more_digits,
            'tree': tree,
        }

    def count(self, mask: int) -> int:
        """Number of obstacles that a query with this mask can see."""
        seen = (self._held.columns.categories & checks.mask(mask)) != 0
        return int(np.count_nonzero(seen & ~self._held.columns.shadow))

    def validate(self) -> None:
        """Raise RuntimeError, saying what is broken, unless tree, names and columns agree."""
        self._held.tree.validate()
        self._validate_names()

    def validate_in_turns(self) -> Iterator[None]:
        """`validate` with pauses; the tree is looked at in another thread, as it was at first."""
        tree = self._held.tree
        room = yield from beside(tree.room_for_copy)
        copy = tree.copied(room)
        yield
        yield from beside(tree.validate_copy, copy)
        self._validate_names()

    def _validate_names(self) -> None:
        slots = self._held.columns.used()
        handles = self._held.columns.tree_handle
        if not np.array_equal(np.sort(handles[slots]), self._held.tree.ids()):
            raise RuntimeError('the tree and the columns hold different obstacles')
        slots = slots[~self._held.columns.shadow[slots]]
        if (np.diff(handles[slots]) <= 0).any():
            raise RuntimeError('node handles do not ascend with those of the tree')
        if len(self._held.registry) != len(slots):
            raise RuntimeError(f'{len(self._held.registry)} names for {len(slots)} obstacles')
        astray = slots[self._held.registry.leads_to(slots) != slots]
        if len(astray):
            name = self._held.registry.name(int(astray[0]))
            raise RuntimeError(f'the name {name!r} leads to another obstacle')
        if sum(self._held.groups.by_source().values()) != len(slots):
            raise RuntimeError('the groups count other than the obstacles there are')
