# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page: a world in a browser, drawn anew up to twenty times a second."""

from __future__ import annotations

import contextlib
import io
import time
from collections import Counter
from collections.abc import Callable, Hashable
from functools import partial
from queue import SimpleQueue

import numpy as np
import viser

from bvh_ros.scene.geometry.shapes import rotations
from bvh_ros.tree.plotting import PALETTE
from bvh_ros.view.drawing import Lines, Obstacles, Overlays, edges, edges_of
from bvh_ros.view.grouping import Namespaces
from bvh_ros.view.panel import BY_NAMESPACE, Panel
from bvh_ros.view.probe import Probe, in_words
from bvh_ros.view.worlds import Floats, Group, ShownWorld, Wanted

RATE = 20.0  # pictures a second
FIGURES_EVERY = 0.5  # seconds
TREE_EVERY = 0.5
LIGHT, DARK = ((215, 215, 215), (170, 170, 170)), ((62, 66, 72), (88, 92, 98))


class LocalServer(viser.ViserServer):
    """A server that tells nobody else: viser's tunnel to the outside stays shut."""

    def __init__(self, host: str, port: int) -> None:
        with contextlib.redirect_stdout(io.StringIO()):  # viser prints a box of its own
            super().__init__(host=host, port=port, label='bvh_view', verbose=False)
        self.theme(dark=False)

    def theme(self, *, dark: bool) -> None:
        """Light or dark."""
        self.gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False)

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse: no data leaves the machine."""
        del verbose
        return None


class Page:
    """Shows a world until told to end.

    Parameters
    ----------
    server : LocalServer
    world : ShownWorld
    """

    def __init__(self, server: LocalServer, world: ShownWorld) -> None:
        self.server, self.world = server, world
        self.sent = 0  # pictures in which obstacles had changed
        self._todo: SimpleQueue[Callable[[], object]] = SimpleQueue()
        self.panel = Panel(server, world, self._todo.put)
        self.probe = Probe(server)
        self._obstacles = Obstacles(server)
        self._overlays = Overlays(server)
        self._tree = Lines(server, '/tree', 1.5)
        self._mark = Lines(server, '/clicked', 4.0)
        self._namespaces = Namespaces()
        self._shown: Hashable = None
        self._tree_shown: Hashable = None
        self._told_at = self._tree_at = 0.0
        self._bounds: tuple[Floats, Floats] | None = None
        self._picked, self._at, self._distance = '', np.zeros(3), 0.0
        self._answered, self._followed = '', np.zeros(3)
        world.prepare()
        self._frames()
        self._set_theme()
        self._connect()

    def _connect(self) -> None:
        panel = self.panel
        for control in (panel.dark, panel.grid, panel.shadows):
            panel.on(control, self._set_theme)
        panel.on(panel.frames, self._frames)
        panel.on(panel.ask, self._choose)

        @self.server.scene.on_click()
        def _(event: viser.SceneClickEvent) -> None:
            self._todo.put(partial(self.pick, event.ray_origin, event.ray_direction))

    def run(self, ended: Callable[[], bool]) -> None:
        """Show, and let the world go on, until `ended`."""
        while not ended():
            due = time.monotonic() + 1.0 / RATE
            self.show()
            self.world.advance(due)

    def show(self) -> None:
        """Do what was asked for in the browser, and draw what is new."""
        while not self._todo.empty():
            self._todo.get()()
        panel, now = self.panel, time.monotonic()
        self.world.want(Wanted(panel.tree.value, panel.queries.value, panel.scan.value))
        version = (self.world.version(), panel.colour.value)
        if version != self._shown:
            self._shown = version
            self._draw_obstacles()
            self.sent += 1
        self._overlays.draw(self.world.overlay(), self.size)
        self.probe.update(self.world, version, self.size)
        if panel.answer.content != self.probe.answer:
            panel.answer.content = self.probe.answer
        if now - self._tree_at >= TREE_EVERY:
            self._tree_at = now
            self._draw_tree(version)
        if now - self._told_at >= FIGURES_EVERY:
            self._told_at = now
            panel.tell(self.world.title, self._obstacles.count, self.world.figures())
            self._tell_picked()

    # ---- obstacles and tree

    def _draw_obstacles(self) -> None:
        groups = self.world.groups()
        legend: Counter[str] = Counter()
        if self.panel.colour.value == BY_NAMESPACE:
            named = self._namespaces.split(self.world.scene, groups)
        else:
            named = [(group.source, group.shapes) for group in groups]
        for name, shapes in named:
            legend[name] += len(shapes.kind)
        numbers = {name: number for number, name in enumerate(legend)}
        self._obstacles.draw([(numbers[name], shapes) for name, shapes in named])
        self.panel.tell_legend({name: (numbers[name], count) for name, count in legend.items()})
        self._fit(groups)
        self._follow()

    def _draw_tree(self, version: Hashable) -> None:
        if not self.panel.tree.value:
            self._tree.clear()
            self._tree_shown = None
            return
        first, last = (int(depth) for depth in self.panel.depths.value)
        lo, hi, depths = self.world.levels(first, last)
        shown = (version, first, last, len(lo))
        if shown != self._tree_shown:
            self._tree_shown = shown
            segments = edges(lo, hi)
            each = len(segments) // max(1, len(lo))
            colours = PALETTE[depths % len(PALETTE)]
            self._tree.draw(segments, np.repeat(colours, each, axis=0))

    # ---- camera and theme

    @property
    def size(self) -> float:
        """Of the world as first seen, m."""
        if self._bounds is None:
            return 10.0
        return max(float((self._bounds[1] - self._bounds[0]).max()), 1e-3)

    def _fit(self, groups: list[Group]) -> None:
        """Look at everything, once there is something."""
        some = [group.shapes for group in groups if len(group.shapes.kind)]
        if self._bounds is not None or not some:
            return
        lo = np.min([(one.position - 0.5 * one.size).min(axis=0) for one in some], axis=0)
        hi = np.max([(one.position + 0.5 * one.size).max(axis=0) for one in some], axis=0)
        self._bounds = lo, hi
        middle, size = 0.5 * lo + 0.5 * hi, self.size
        middle[2] = lo[2]
        away = np.array((0.0, -0.02, 1.0) if self.world.scene.planar else (-0.42, -0.72, 0.52))
        camera = self.server.initial_camera
        camera.position, camera.look_at = middle + 1.05 * size * away, middle
        camera.near, camera.far = 1e-3 * size, 30.0 * size
        for client in self.server.get_clients().values():
            client.camera.position, client.camera.look_at = camera.position, camera.look_at
            client.camera.near, client.camera.far = camera.near, camera.far
        self._set_theme()
        self._frames()

    def _set_theme(self) -> None:
        dark, size = self.panel.dark.value, self.size
        self.server.theme(dark=dark)
        self._light(self.panel.shadows.value)
        cells, sections = DARK if dark else LIGHT
        cell = 10.0 ** np.floor(np.log10(size / 5.0))
        ground = 0.0 if self._bounds is None else min(0.0, float(self._bounds[0][2]))
        self.server.scene.add_grid(
            '/grid', infinite_grid=True, cell_size=cell, section_size=5.0 * cell,
            cell_color=cells, section_color=sections, fade_distance=6.0 * size,
            shadow_opacity=0.2, position=(0.0, 0.0, ground), visible=self.panel.grid.value,
        )  # fmt: skip

    def _light(self, shadows: bool) -> None:
        """Viser's own lights bleach the colours that tell sources apart."""
        scene = self.server.scene
        scene.configure_default_lights(enabled=False, cast_shadow=False)
        scene.configure_environment_map('warehouse', environment_intensity=0.35)
        scene.add_light_ambient('/lights/all_round', intensity=0.9)
        scene.add_light_directional(
            '/lights/sun', intensity=2.2, position=(-1.0, -2.0, 3.0), cast_shadow=shadows
        )

    def _frames(self) -> None:
        scene, length = self.server.scene, 0.05 * self.size
        seen = self.panel.frames.value
        scene.world_axes.visible = False
        places = [(self.world.frame_id or 'world', np.zeros(3), np.array((0.0, 0.0, 0.0, 1.0)))]
        for name, position, orientation in (*places, *self.world.frames()):
            scene.add_frame(
                f'/frames/{name}', axes_length=length, axes_radius=0.05 * length,
                wxyz=orientation[[3, 0, 1, 2]], position=position, visible=seen,
            )  # fmt: skip
            scene.add_label(f'/frames/{name}/name', name, anchor='top-left', visible=seen)

    # ---- questions

    def _choose(self) -> None:
        lo, hi = self._bounds or (np.zeros(3), np.ones(3))
        self.probe.choose(self.panel.ask.value, 0.5 * lo + 0.5 * hi, self.size)

    def pick(self, origin: object, direction: object) -> None:
        """Ask who is seen on a ray from the camera, and mark him."""
        start, way = np.array(origin, np.float64), np.array(direction, np.float64)
        reach = 10.0 * self.size + float(np.linalg.norm(start))
        try:
            answer = self.world.pick(start, way, reach)
        except (RuntimeError, ValueError) as error:
            self.panel.picked.content = f'no answer: {error}'
            return
        self._picked, self._answered = '', 'Nothing is there.'
        if answer.hits:
            hit = answer.hits[0]
            self._picked, self._at = hit.name, np.array(hit.point)
            self._distance = float(np.linalg.norm(self._at - start))
            self._answered = in_words(answer._replace(hits=answer.hits[:1]))
        known = self._picked in self.world.scene
        self.panel.follow.disabled = not known
        if known:
            self._followed = self.world.scene.get(self._picked).position
        self._place_mark()
        self._tell_picked()

    def _tell_picked(self) -> None:
        text = self._answered or 'Click an obstacle.'
        if self._picked:
            text += f'\n\ndistance {self._distance:.3f} m'
        if self._picked in self.world.scene:
            known = self.world.scene.get(self._picked)
            size = ' x '.join(f'{edge:.3g}' for edge in known.size)
            text += f'\n\n{known.kind.name.lower()}, {size} m, of source {known.source}'
            if self.world.now() and known.stamp:
                age = 1e-9 * (self.world.now() - known.stamp)
                text += f'\n\nstamp {1e-9 * known.stamp:.3f} s, age {age:.2f} s'
        elif self._picked:
            text += '\n\nnot heard here: source and shape are known to the node only'
        if self.panel.picked.content != text:
            self.panel.picked.content = text

    def _place_mark(self) -> None:
        scene = self.world.scene
        if self._picked not in scene:
            self._mark.clear()
            return
        known = scene.get(self._picked)
        turn = rotations(known.orientation[None])[0]
        colour = (1.0, 1.0, 1.0) if self.panel.dark.value else (0.1, 0.1, 0.1)
        self._mark.draw(edges_of(known.position, turn, 1.02 * known.size), np.array([colour] * 12))

    def _follow(self) -> None:
        """Keep the mark on whom was clicked, and the camera with him."""
        if self._picked not in self.world.scene:
            self._mark.clear()
            return
        self._place_mark()
        now = self.world.scene.get(self._picked).position
        moved, self._followed = now - self._followed, now
        if self.panel.follow.value and moved.any():
            for client in self.server.get_clients().values():
                camera = client.camera
                with client.atomic():
                    look_at = camera.look_at + moved
                    camera.position = camera.position + moved
                    camera.look_at = look_at
