# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A segment or a box that is drawn by two handles, and what it meets."""

from __future__ import annotations

from collections.abc import Hashable
from html import escape

import numpy as np
import viser

from bvh_ros.ros.conversions.outlines import edges
from bvh_ros.tree.access import BLOCKED_WAY, FREE_WAY
from bvh_ros.view.drawing import Dots, Lines
from bvh_ros.view.placing import Placing
from bvh_ros.view.worlds import NO_POINTS, Answer, Floats, ShownWorld

NOTHING, SEGMENT, BOX = 'nothing', 'a segment', 'a box'
CHOICES = (NOTHING, SEGMENT, BOX)
SHOWN = 5  # names of a longer answer


class Probe:
    """Asks again whenever a handle or the world has moved."""

    def __init__(self, server: viser.ViserServer, placing: Placing) -> None:
        self._server, self._placing = server, placing
        self._lines = Lines(server, placing, '/ask/lines', 4.0)
        self._spots = Dots(server, placing, '/ask/hits', BLOCKED_WAY)
        self._handles: list[viser.TransformControlsHandle] = []
        self._label: viser.LabelHandle | None = None
        self._asked: Hashable = None
        self.kind = NOTHING
        self.answer = ''

    def choose(self, kind: str, middle: Floats, size: float) -> None:
        """Begin with two handles about the middle of the world, or end; both as on the page."""
        self.kind, self._asked, self.answer = kind, None, ''
        for handle in self._handles:
            handle.remove()
        self._handles.clear()
        if kind == NOTHING:
            self._show(np.empty((0, 2, 3)), NO_POINTS, '', 1.0)
            return
        reach = np.array((0.25, 0.12, 0.02)) * size
        for name, place in (('a', middle - reach), ('b', middle + reach)):
            handle = self._server.scene.add_transform_controls(
                f'/ask/{name}', scale=0.09 * size, disable_rotations=True, position=place,
                translation_limits=((-1e9, 1e9),) * 3, depth_test=False,
            )  # fmt: skip
            self._handles.append(handle)

    def place(self, one: Floats, other: Floats) -> None:
        """Put the handles at two places (3,) of the world, m."""
        for handle, place in zip(self._handles, (one, other), strict=True):
            handle.position = self._placing.shown(place)

    def ends(self) -> tuple[Floats, Floats]:
        """Where the handles are in the world, two of (3,), m."""
        one, other = (
            self._placing.meant(np.array(handle.position, np.float64)) for handle in self._handles
        )
        return one, other

    def update(self, world: ShownWorld, version: Hashable, size: float) -> None:
        """Ask, if anything has moved."""
        if self.kind == NOTHING:
            return
        one, other = self.ends()
        asked = (*one.tolist(), *other.tolist(), version)
        if asked == self._asked:
            return
        self._asked = asked
        try:
            answer = (world.raycast if self.kind == SEGMENT else world.overlap)(one, other)
        except (RuntimeError, ValueError) as error:
            self.answer = escape(f'no answer: {error}')
            return
        self.answer = in_words(answer)
        spots = np.array([hit.point for hit in answer.hits]).reshape(-1, 3)
        lines = np.stack((one, other))[None]
        if self.kind == BOX:
            lines = edges(np.minimum(one, other)[None], np.maximum(one, other)[None])
        elif len(spots):
            lines = np.array([(one, spots[0])])
        names = ', '.join(hit.name for hit in answer.hits[:SHOWN])
        self._show(lines, spots, names or 'free', size)

    def _show(self, lines: Floats, spots: Floats, text: str, size: float) -> None:
        colour = BLOCKED_WAY if len(spots) else FREE_WAY
        self._lines.draw(lines, np.tile(colour, (len(lines), 1)))
        self._spots.draw(spots, 0.01 * size)
        if self._label is not None:
            self._label.remove()
            self._label = None
        if text:
            place = spots[0] if len(spots) else lines.mean(axis=(0, 1))
            self._label = self._server.scene.add_label(
                '/ask/answer', text, position=self._placing.shown(place), anchor='bottom-center'
            )


def in_words(answer: Answer) -> str:
    """Who was met, where, and how long it took, as HTML."""
    took = f'{answer.microseconds:,.0f} us'
    if not answer.hits:
        return f'<b>free</b> · {took}'
    names = ', '.join(f'<b>{escape(hit.name)}</b>' for hit in answer.hits[:SHOWN])
    rest = len(answer.hits) - SHOWN
    more = f' and {rest} more' if rest > 0 else ''
    return f'{names}{more} at ({in_digits(*answer.hits[0].point)}) m · {took}'


def in_digits(*metres: float) -> str:
    """Millimetres where the largest needs no more and no fewer."""
    largest = max(abs(one) for one in metres)
    if largest == 0.0 or 0.01 <= largest < 1e7:
        return ', '.join(f'{round(one, 3) + 0.0:.3f}' for one in metres)  # no -0.000
    return ', '.join(f'{one:.6g}' for one in metres)
