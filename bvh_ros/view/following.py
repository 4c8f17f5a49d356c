# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Cameras that go with somebody who moves, while hands move them, too."""

from __future__ import annotations

from collections import deque

import numpy as np
import viser

from bvh_ros.view.server import LocalServer
from bvh_ros.view.worlds import Floats

REMEMBERED = 200  # steps, ten seconds of them: no report of a browser is later than that
SAME = 1e-6  # of the distance that a camera looks: hands move it farther, rounding does not


class Following:
    """Moves all cameras as somebody moves, and loses no step of it.

    A browser tells where its camera is, and its report overwrites what was told to it meanwhile.
    So what counts is where each camera was told to look: whoever reports one of these places
    has yet to go on from there to the last one, however late the report is. Only who looks
    elsewhere was moved aside by a hand; who turns or zooms looks at the same place.
    """

    def __init__(self, server: LocalServer) -> None:
        self._server = server
        self._aims: dict[int, Floats] = {}  # of each client, where to look, on the page
        self._told: dict[int, deque[Floats]] = {}

    def begin(self) -> None:
        """Let cameras go on from where they look now."""
        self._aims, self._told = {}, {}

    def go(self, way: Floats) -> None:
        """Move all cameras, in units of the page."""
        for number, client in self._server.get_clients().items():
            place, target = _seen(client.camera)
            told = self._told.setdefault(number, deque([target], REMEMBERED))
            reach = SAME * np.linalg.norm(target - place)
            if np.linalg.norm(np.array(told) - target, axis=1).min() > reach:
                self._aims[number] = target  # where a hand has moved it
            aim = self._aims[number] = self._aims.get(number, target) + way
            owed = aim - target
            if np.allclose(aim, target) or np.allclose(place + owed, place):
                continue  # viser would not tell the browser: with the next steps
            with client.atomic():
                client.camera.position = place + owed  # and what it looks at, as far
            told.append(aim)


def _seen(camera: viser.CameraHandle) -> tuple[Floats, Floats]:
    """Where a camera is, and where it looks, both of one report."""
    while True:
        target, place = camera.look_at, camera.position
        if camera.look_at is target:
            return place, target
