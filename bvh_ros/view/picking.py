# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The clicked obstacle: named, marked, and followed by the cameras."""

from __future__ import annotations

from collections import deque
from html import escape

import numpy as np
import viser

from bvh_ros.ros.conversions.outlines import edges
from bvh_ros.scene.shapes.shape import rotations
from bvh_ros.view.drawing import Lines, Placing
from bvh_ros.view.panel import Panel, in_digits, in_words, write
from bvh_ros.view.stage import LocalServer, Stage
from bvh_ros.view.worlds import Floats, ShownWorld

# ---- Cameras that follow an obstacle while the user moves them, too


REMEMBERED = 200  # steps, ten seconds of them: no report of a browser is later than that
SAME = 1e-6  # of the distance that a camera looks: hands move it farther, rounding does not


class Following:
    """Moves all cameras along with an obstacle, and loses no step of it.

    A browser reports its camera, and a late report overwrites newer commands. So the commanded
    targets of each camera are remembered. A camera that reports one of them still has to move on
    to the last one. A camera with another target was moved by the user; turning and zooming keep
    the target.
    """

    def __init__(self, server: LocalServer) -> None:
        self._server = server
        self.aims: dict[int, Floats] = {}  # of each client, where to look, on the page
        self._targets: dict[int, deque[Floats]] = {}

    def begin(self) -> None:
        """Let cameras go on from where they look now."""
        self.aims, self._targets = {}, {}

    def go(self, step: Floats) -> None:
        """Move all cameras, in units of the page."""
        for number, client in self._server.get_clients().items():
            place, target = view_of(client.camera)
            targets = self._targets.setdefault(number, deque([target], REMEMBERED))
            reach = SAME * np.linalg.norm(target - place)
            if np.linalg.norm(np.array(targets) - target, axis=1).min() > reach:
                self.aims[number] = target  # where a hand has moved it
            aim = self.aims[number] = self.aims.get(number, target) + step
            owed = aim - target
            if np.allclose(aim, target) or np.allclose(place + owed, place):
                continue  # viser would not tell the browser: with the next steps
            with client.atomic():
                client.camera.position = place + owed  # and what it looks at, as far
            targets.append(aim)


def view_of(camera: viser.CameraHandle) -> tuple[Floats, Floats]:
    """Where a camera is, and where it looks, both of one report."""
    while True:
        target, place = camera.look_at, camera.position
        if camera.look_at is target:
            return place, target


# ---- The clicked obstacle


REACH = 10.0  # of a click, in sizes of the world


class Picking:
    """Lets the world answer a click, and stays with whom it named."""

    def __init__(
        self, server: LocalServer, panel: Panel, world: ShownWorld, stage: Stage, placing: Placing
    ) -> None:
        self._panel, self._world, self._stage, self._placing = panel, world, stage, placing
        self.following = Following(server)
        self._mark = Lines(server, placing, '/clicked', 4.0)
        self._picked, self._at, self._distance = '', np.zeros(3), 0.0
        self.answered, self._followed = 'Click an obstacle.', np.zeros(3)

    def pick(self, origin: object, direction: object) -> None:
        """Cast a ray from the camera, and mark the obstacle that it hits."""
        eye, ahead = np.array(origin, np.float64), np.array(direction, np.float64)
        start = self._placing.in_world(eye)
        reach = self._placing.unit * (REACH * self._stage.size + float(np.linalg.norm(eye)))
        self._picked = ''
        try:
            answer = self._world.pick(start, ahead, reach)
        except (RuntimeError, ValueError) as error:
            self.answered = escape(f'no answer: {error}')
        else:
            self.answered = 'Nothing is there.'
            if answer.hits:
                hit = answer.hits[0]
                self._picked, self._at = hit.name, np.array(hit.point)
                self._distance = float(np.linalg.norm(self._at - start))
                self.answered = in_words(answer._replace(hits=answer.hits[:1]))
        known = self._picked in self._world.scene
        self._panel.follow.disabled = not known
        if known:
            self._followed = self._world.scene.get(self._picked).position
        self._place_mark()
        self.tell()

    def tell(self) -> None:
        """Show the name and the present state of the obstacle."""
        lines = [self.answered]
        if self._picked:
            lines.append(f'distance {in_digits(self._distance)} m')
        if self._picked in self._world.scene:
            known = self._world.scene.get(self._picked)
            size = ' x '.join(f'{edge:.3g}' for edge in known.size)
            lines.append(f'{known.kind.name.lower()}, {size} m, of source {escape(known.source)}')
            if self._world.now() and known.stamp:
                age = 1e-9 * (self._world.now() - known.stamp)
                lines.append(f'stamp {1e-9 * known.stamp:.3f} s, age {age:.2f} s')
        elif self._picked:
            lines.append('not heard here: source and shape are known to the node only')
        write(self._panel.picked, *lines)

    def go_on(self) -> None:
        """Keep the mark on whom was clicked, and the cameras with him."""
        self._place_mark()
        if self._picked not in self._world.scene:
            return
        now = self._world.scene.get(self._picked).position
        moved, self._followed = now - self._followed, now
        if not self._panel.follow.value:
            self.following.begin()
        elif moved.any():
            self.following.go(moved / self._placing.unit)

    def _place_mark(self) -> None:
        scene = self._world.scene
        if self._picked not in scene:
            self._mark.clear()
            return
        middle, orientation, size = scene.own_box(self._picked)
        turn = rotations(orientation[None])[0]
        colour = (1.0, 1.0, 1.0) if self._panel.dark.value else (0.1, 0.1, 0.1)
        half = 0.51 * size[None]  # not hidden in its sides
        self._mark.draw(edges(-half, half) @ turn.T + middle, np.array([colour] * 12))
