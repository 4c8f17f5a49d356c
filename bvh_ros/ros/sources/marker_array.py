# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles from a MarkerArray topic."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from visualization_msgs.msg import MarkerArray

from bvh_ros.ros.conversions import markers
from bvh_ros.ros.sources.source import Source
from bvh_ros.scene import Numbered, Refusal


class MarkerArraySource(Source):
    """Keeps one obstacle for each marker, and one for each element of a list marker."""

    message_type = MarkerArray

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._lists: set[str] = set()  # markers that are kept as lists of elements

    def apply(self, message: Any, now: int) -> tuple[int, Sequence[Refusal]]:
        """Follow the markers in order."""
        steps, refusals = markers.steps(
            message.markers, now=now, into_node=self.frames.into_node, prefix=self.settings.prefix
        )
        items = len(message.markers)
        for step in steps:
            if isinstance(step, markers.Update):
                refusals += self._update(step)
            elif isinstance(step, markers.ReplaceList):
                items += len(step.shapes.kind)
                refusals += self._replace_list(step)
            elif isinstance(step, markers.Delete):
                self.scene.remove(self.name, step.names)
                self._remove_lists(self._lists.intersection(step.names))
            else:
                self._remove_namespace(step.namespace)
        return items, refusals

    def forget(self) -> None:
        """Start over."""
        super().forget()
        self._lists.clear()

    def _update(self, step: markers.Update) -> list[Refusal]:
        refusals = self.scene.update(
            self.name, step.names, step.shapes, stamp=step.stamp, expires=step.expires
        )
        # A list marker that became a single one; a refused update keeps the list.
        changed = self._lists.intersection(step.names)
        self._remove_lists(changed.difference(refusal.name for refusal in refusals))
        return refusals

    def _replace_list(self, step: markers.ReplaceList) -> list[Refusal]:
        n = len(step.shapes.kind)
        refusals = self.scene.replace(
            self.name,
            step.name,
            Numbered(step.name + '#', np.arange(n)),
            step.shapes,
            stamp=step.stamp,
            expires=step.expires,
        )
        if step.name not in self._lists:
            self._lists.add(step.name)
            self.scene.remove(self.name, [step.name])
        return refusals

    def _remove_lists(self, names: set[str]) -> None:
        for name in names:
            self.scene.remove_group(self.name, name)
        self._lists -= names

    def _remove_namespace(self, namespace: str | None) -> None:
        if namespace is None:
            self.scene.remove_group(self.name, '')
            self._lists.clear()
            return
        self.scene.remove_namespace(self.name, namespace)
        self._lists = {name for name in self._lists if name.rpartition('/')[0] != namespace}
