# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles from a MarkerArray topic."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np
from visualization_msgs.msg import MarkerArray

from bvh_ros.ros.cdr import definitions
from bvh_ros.ros.cdr import marker_array as decoder
from bvh_ros.ros.conversions import markers
from bvh_ros.ros.conversions.marker_table import table
from bvh_ros.ros.sources.source import Applying, Slices, Source
from bvh_ros.ros.warm_up import Step
from bvh_ros.scene import Families, Numbered, Part


class MarkerArraySource(Source):
    """Keeps one obstacle for each marker, and one for each element of a list marker."""

    message_type = MarkerArray

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._lists: set[str] = set()  # markers that are kept as lists of elements
        other = definitions.difference(MarkerArray, decoder.DEFINITION)
        self.raw = not other
        if other:
            self._node.get_logger().warning(
                f"source '{self.name}': {other} is not defined here as the decoder knows it; "
                'messages are read by rclpy, which takes several times as long'
            )

    def to_compile(self) -> Iterable[Step]:
        """Return the decoder, where it is used."""
        return [('decode markers', partial(decoder.read, decoder.EMPTY))] if self.raw else []

    def apply(self, message: Any, now: int) -> Applying:
        """Follow the markers in order."""
        columns = decoder.read(message) if self.raw else table(message.markers)
        steps, refusals = markers.steps(
            columns, now=now, into_node=self.frames.into_node, prefix=self.settings.prefix
        )
        items = len(columns.id)
        for step in steps:
            if isinstance(step, markers.Update):
                refusals += yield from self._update(step)
            elif isinstance(step, markers.ReplaceList):
                items += len(step.shapes.kind)
                refusals += yield from self._replace_list(step)
            elif isinstance(step, markers.Delete):
                self.scene.remove(self.name, step.names)
                self._remove_lists(self._lists_among(step.names))
            else:
                self._remove_namespace(step.namespace)
        return items, refusals

    def forget(self) -> None:
        """Start over."""
        super().forget()
        self._lists.clear()

    def _update(self, step: markers.Update) -> Slices:
        part = Part(step.names, step.shapes, step.stamp, step.expires)
        refusals = yield from self._in_slices('', len(step.names), part.cut, whole=False)
        # A list marker that became a single one; a refused update keeps the list.
        changed = self._lists_among(step.names)
        self._remove_lists(changed.difference(refusal.name for refusal in refusals))
        return refusals

    def _replace_list(self, step: markers.ReplaceList) -> Slices:
        n = len(step.shapes.kind)
        names = Numbered(step.name + '#', np.arange(n))
        part = Part(names, step.shapes, step.stamp, step.expires)
        refusals = yield from self._in_slices(step.name, n, part.cut, whole=True)
        if step.name not in self._lists:
            self._lists.add(step.name)
            self.scene.remove(self.name, [step.name])
        return refusals

    def _lists_among(self, names: Families) -> set[str]:
        return self._lists.intersection(names.texts()) if self._lists else set()

    def _remove_lists(self, names: set[str]) -> None:
        for name in names:
            self.scene.remove_group(self.name, name)
        self._lists -= names

    def _remove_namespace(self, namespace: str | None) -> None:
        if namespace is None:
            self.tells_all = True
            self.scene.remove_group(self.name, '')
            self._lists.clear()
            return
        self.scene.remove_namespace(self.name, namespace)
        self._lists = {name for name in self._lists if name.rpartition('/')[0] != namespace}
