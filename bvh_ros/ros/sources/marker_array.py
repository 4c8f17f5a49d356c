# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles from a MarkerArray topic."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

from visualization_msgs.msg import MarkerArray

from bvh_ros.ros.cdr import definitions, marker_array
from bvh_ros.ros.compile_jobs import Job
from bvh_ros.ros.conversions import markers
from bvh_ros.ros.conversions.placing import numbered
from bvh_ros.ros.parameters import ConfigurationError
from bvh_ros.ros.sources.source import Applying, Source
from bvh_ros.scene import Families, Part
from bvh_ros.scene.names import as_families

if TYPE_CHECKING:
    from bvh_ros.ros.sources.mesh_resources import MeshFiles


class MarkerArraySource(Source):
    """Keeps one obstacle for each marker, and one for each element of a list marker."""

    message_type = MarkerArray
    raw = True

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._files: MeshFiles | None = None
        self._lists: dict[str, int] = {}  # list markers, and how many elements each has at most
        if other := definitions.difference(MarkerArray, marker_array.DEFINITION):
            raise ConfigurationError(
                f"source '{self.name}': {other} is defined here otherwise than in ROS 2 Jazzy"
            )
        self.together = self.follow is None

    def to_compile(self) -> Iterable[Job]:
        """Return the decoder."""
        decode = partial(marker_array.read, marker_array.EMPTY)
        return [Job('decode markers', 'decode markers', 2.0, decode, early=True)]

    def apply(self, message: Any, now: int) -> Applying:
        """Remove what the markers remove, then add and modify."""
        try:
            return (yield from self._apply(message, now))
        finally:
            if self._files is not None:
                self._files.loading = ''

    def _apply(self, message: Any, now: int) -> Applying:
        columns = marker_array.read(*message)
        change = yield from markers.change(
            columns,
            now=now,
            into_node=self.frames.into_node,
            latest=self._latest(now),
            prefix=self.settings.prefix,
            planar=self.scene.planar,
            meshes=self.settings.options['meshes'],
            files=self._find_files,
        )
        self.is_whole = change.clears
        part = Part(change.names, change.shapes, change.stamp, change.expires)
        part = part._replace(velocities=self.follow)
        removed = self._with_elements(change.removed)
        leaving = self.scene.find(self.name, removed, change.namespaces)
        self._forget_lists(change)
        for name, size in change.lists.items():  # before: should anything go wrong on the way
            self._lists[name] = max(size, self._lists.get(name, 0))
        refused = yield from self._change(part, leaving, clears=change.clears)
        count, refusals = len(change.names), change.refusals
        refusals.extend(refused)
        yield from self._settle_lists(change)
        return len(columns.id) + count - len(change.singles), refusals

    def forget(self) -> None:
        """Start over."""
        super().forget()
        self._lists.clear()
        self._files = None  # what could not be read is tried again

    def _find_files(self) -> MeshFiles | None:
        if self._files is None and self.mesh_files is not None:
            self._files = self.mesh_files()
        return self._files

    def _loading(self) -> str:
        return '' if self._files is None else self._files.loading

    def _with_elements(self, names: Families) -> Families:
        """These names, and the elements of those that are lists."""
        lists = self._lists_among(names)
        return self._elements({name: (0, self._lists[name]) for name in lists}, names)

    def _forget_lists(self, change: markers.Change) -> None:
        if change.clears:
            self._lists.clear()
        for name in self._lists_among(change.removed):
            del self._lists[name]
        if change.namespaces and self._lists:
            spaces = set(change.namespaces)
            for name in [n for n in self._lists if n.rpartition('/')[0] in spaces]:
                del self._lists[name]

    def _settle_lists(self, change: markers.Change) -> Iterator[None]:
        """Remove what lists no longer have, and what changed between a list and a single one."""
        ended = self._lists_among(change.singles).difference(change.lists)
        # A refused update keeps the list.
        ended = {name for name in ended if len(self.scene.find(self.name, [name]))}
        left = {name: (0, self._lists.pop(name)) for name in ended}
        for name, size in change.lists.items():
            left[name] = size, self._lists[name]
            self._lists[name] = size
        if left:
            leaving = self._elements(left, as_families(list(change.lists)))
            yield from self.scene.discard_in_slices(
                self.scene.find(self.name, leaving), besides=[]
            )

    def _lists_among(self, names: Families) -> set[str]:
        return self._lists.keys() & names.texts() if self._lists else set()

    @staticmethod
    def _elements(lists: dict[str, tuple[int, int]], names: Families) -> Families:
        """Elements of lists from one number to another, after other names."""
        spans = {f'{name}#': range(begin, end) for name, (begin, end) in lists.items()}
        return numbered(spans, after=names)
