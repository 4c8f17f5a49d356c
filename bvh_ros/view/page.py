# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page: a world in a browser, drawn anew up to twenty times a second."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Hashable
from functools import partial
from queue import SimpleQueue

import numpy as np
import viser

from bvh_ros.ros.conversions.outlines import edges
from bvh_ros.scene import Shapes
from bvh_ros.tree.access import PALETTE
from bvh_ros.view.drawing import Lines, Obstacles, Overlays, Placing
from bvh_ros.view.panel import Panel, Probe, write
from bvh_ros.view.picking import Picking
from bvh_ros.view.stage import LocalServer, Stage
from bvh_ros.view.worlds import Floats, Namespaces, ShownWorld, Wanted

RATE = 20.0  # pictures a second
FIGURES_EVERY = 0.5  # seconds
TREE_EVERY = 0.5


class Page:
    """Shows a world until it is stopped."""

    def __init__(self, server: LocalServer, world: ShownWorld) -> None:
        self.server, self.world = server, world
        self.sent = 0  # pictures in which obstacles had changed
        self.todo: SimpleQueue[Callable[[], object]] = SimpleQueue()
        self.placing = placing = Placing()
        self.panel = Panel(server, world, self.todo.put)
        self.stage = Stage(server, self.panel, world, placing)
        self.probe = Probe(server, placing)
        self.picking = Picking(server, self.panel, world, self.stage, placing)
        self._obstacles = Obstacles(server, placing)
        self._overlays = Overlays(server, placing)
        self._tree = Lines(server, placing, '/tree', 1.5)
        self.numbers: dict[str, int] = {}  # of colours, by namespace or source
        self._namespaces = Namespaces()
        self._scene = world.scene
        self._shown: Hashable = None
        self._tree_shown: Hashable = None
        self._told_at = self._tree_at = 0.0
        world.prepare()
        self._connect()

    def _connect(self) -> None:
        panel = self.panel
        for control in (panel.dark, panel.grid, panel.shadows):
            panel.on(control, self.stage.set_theme)
        panel.on(panel.dark, self.picking.go_on)
        panel.on(panel.frames, self.stage.draw_frames)
        panel.on(panel.ask, self.ask)
        panel.on_click(panel.all, self.stage.look_at_all)

        @self.server.scene.on_click()
        def _(event: viser.SceneClickEvent) -> None:
            self.todo.put(partial(self.picking.pick, event.ray_origin, event.ray_direction))

    def run(self, ended: Callable[[], bool]) -> None:
        """Show, and let the world go on, until `ended`."""
        while not ended():
            due = time.monotonic() + 1.0 / RATE
            self.show()
            self.world.advance(due)

    def show(self) -> None:
        """Do what was asked for in the browser, and draw what is new."""
        while not self.todo.empty():
            self.todo.get()()
        panel, now = self.panel, time.monotonic()
        self.world.want(Wanted(panel.tree.value, panel.queries.value, panel.scan.value))
        version = self.world.version()
        if version != self._shown:
            self._shown = version
            self._draw_obstacles()
            self.sent += 1
        self._overlays.draw(self.world.overlay(), self.stage.size)
        self.probe.update(self.world, version, self.stage.size)
        write(panel.answer, self.probe.answer)
        if now - self._tree_at >= TREE_EVERY:
            self._tree_at = now
            self._draw_tree(version)
        if now - self._told_at >= FIGURES_EVERY:
            self._told_at = now
            panel.tell(
                self.world.title, self._obstacles.count, self.probe.milliseconds,
                self.world.figures(),
            )  # fmt: skip
            self.picking.tell()

    def ask(self) -> None:
        """Begin with what the panel says is to be asked."""
        self.probe.choose(self.panel.ask.value, *self.stage.bounds, self.stage.size)

    def _draw_obstacles(self) -> None:
        if self.world.scene is not self._scene:  # a node that came back has another
            self._scene, self._namespaces = self.world.scene, Namespaces()
            self.stage.draw_frames()
        groups = self.world.groups()
        some = [group.shapes for group in groups if len(group.shapes.kind)]
        if self.stage.fit([_around(shapes) for shapes in some]):
            self.ask()
        named = self._namespaces.split(self.world.scene, groups)
        legend: Counter[str] = Counter()
        for name, shapes in named:
            legend[name] += len(shapes.kind)
        for name in legend:  # each keeps its colour
            self.numbers.setdefault(name, len(self.numbers))
        self._obstacles.draw([(self.numbers[name], shapes) for name, shapes in named])
        shown = [name for name in self.numbers if legend[name]]
        self.panel.tell_legend({name: (self.numbers[name], legend[name]) for name in shown})
        self.picking.go_on()

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


def _around(shapes: Shapes) -> tuple[Floats, Floats]:
    """Corners of a box around shapes, as if none was turned."""
    half = 0.5 * shapes.size
    return (shapes.position - half).min(axis=0), (shapes.position + half).max(axis=0)
