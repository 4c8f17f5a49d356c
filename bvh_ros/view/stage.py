# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What surrounds the obstacles: camera, light, grid and frames."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
import viser

from bvh_ros.view.drawing import Placing
from bvh_ros.view.panel import Panel
from bvh_ros.view.worlds import Floats, ShownWorld

# ---- The server of viser


class LocalServer(viser.ViserServer):
    """A server for this machine alone: viser's tunnel to the outside stays shut."""

    def __init__(self, host: str, port: int) -> None:
        with contextlib.redirect_stdout(io.StringIO()):  # viser prints a box of its own
            super().__init__(host=host, port=port, label='bvh_view', verbose=False)
        self.gui.main_panel.dock_right()  # beside the picture: nothing is hidden behind it
        self.theme(dark=False)

    def theme(self, *, dark: bool) -> None:
        """Light or dark."""
        self.gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False)

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refuse: no data leaves the machine."""
        del verbose
        return None


# ---- Camera, light, grid and frames


LIGHT, DARK = ((215, 215, 215), (170, 170, 170)), ((62, 66, 72), (88, 92, 98))
GROWN = 1.5  # times its last size: then the grid is made anew
NEAR, FAR = 1e-3, 30.0  # what a camera sees, in sizes of the world
AWAY, FOV = 1.7, 0.76  # where it stands at first, in sizes of the world; rad, from top to bottom


class Stage:
    """Keeps camera, light, grid and frames about as large as the world.

    Parameters
    ----------
    placing : Placing
        Chosen when the first obstacle appears.
    """

    def __init__(
        self, server: LocalServer, panel: Panel, world: ShownWorld, placing: Placing
    ) -> None:
        self.size = 10.0  # of the world, on the page
        self._server, self._panel, self._world, self._placing = server, panel, world, placing
        self._bounds: tuple[Floats, Floats] | None = None  # on the page
        self.set_theme()
        self.draw_frames()

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Two corners of the world, on the page."""
        return self._bounds or (np.zeros(3), np.ones(3))

    def fit(self, bounds: Sequence[tuple[Floats, Floats]]) -> bool:
        """Be as large as boxes (lo, hi), m. Look at the first ones; return whether these are."""
        if not bounds:
            return False
        lo = np.min([one for one, _ in bounds], axis=0)
        hi = np.max([one for _, one in bounds], axis=0)
        first = self._bounds is None
        if first:
            self._placing.fit(lo, hi)
        lo, hi = self._placing.shown(lo), self._placing.shown(hi)
        self._bounds = lo, hi
        size = max(float((hi - lo).max()), 1e-3)
        if first or size > GROWN * self.size:
            self.size = size
            self._set_reach()
            self.set_theme()
            self.draw_frames()
        if first:
            self.look_at_all()
        return first

    def look_at_all(self) -> None:
        """Have all cameras see the whole world."""
        if self._bounds is None:
            return
        lo, hi = self._bounds
        self.size = max(float((hi - lo).max()), 1e-3)
        self._set_reach()
        middle = 0.5 * lo + 0.5 * hi
        middle[2] = lo[2]
        away = (0.0, -0.02, 1.0) if self._world.scene.planar else (-0.57, -0.64, 0.52)
        place = middle + AWAY * self.size * np.array(away)
        for camera in self._cameras():
            camera.position, camera.look_at, camera.fov = place, middle, FOV

    def _set_reach(self) -> None:
        """What is nearer or farther than that, no camera sees."""
        for camera in self._cameras():
            camera.near, camera.far = NEAR * self.size, FAR * self.size

    def _cameras(self) -> list[Any]:
        """Those of later visitors, and of all present ones."""
        clients = self._server.get_clients().values()
        return [self._server.initial_camera, *(client.camera for client in clients)]

    def set_theme(self) -> None:
        """Light or dark, with the grid and shadows that the panel says."""
        dark = self._panel.dark.value
        self._server.theme(dark=dark)
        self._light(self._panel.shadows.value)
        cells, sections = DARK if dark else LIGHT
        cell = 10.0 ** np.floor(np.log10(self.size / 5.0))
        ground = self._placing.shown(np.zeros(3))[2]
        if self._bounds is not None:
            lowest = float(self._bounds[0][2])
            ground = ground if abs(ground - lowest) < self.size and ground < lowest else lowest
        self._server.scene.add_grid(
            '/grid', infinite_grid=True, cell_size=cell, section_size=5.0 * cell,
            cell_color=cells, section_color=sections, fade_distance=6.0 * self.size,
            shadow_opacity=0.2, position=(0.0, 0.0, ground), visible=self._panel.grid.value,
        )  # fmt: skip

    def _light(self, shadows: bool) -> None:
        """Viser's own lights bleach the colours that tell sources apart, and light from all
        around by a picture takes a third of the time where there is no graphics card.
        """
        scene = self._server.scene
        scene.configure_default_lights(enabled=False, cast_shadow=False)
        scene.configure_environment_map(None)
        scene.add_light_ambient('/lights/all_round', intensity=0.5)
        scene.add_light_hemisphere('/lights/sky', intensity=1.1, ground_color=(150, 150, 165))
        scene.add_light_directional(
            '/lights/sun', intensity=2.3, position=(1.2, -2.2, 3.2), cast_shadow=shadows
        )

    def draw_frames(self) -> None:
        """Draw all frames, by numbers: a slash in a name would make it a part of another."""
        scene, length = self._server.scene, 0.05 * self.size
        visible = self._panel.frames.value
        scene.world_axes.visible = False
        own = self._world.frame_id or 'world'
        places = [(own, np.zeros(3), np.array((0.0, 0.0, 0.0, 1.0))), *self._world.frames()]
        for number, (name, position, orientation) in enumerate(places):
            scene.add_frame(
                f'/frames/{number}', axes_length=length, axes_radius=0.05 * length,
                wxyz=orientation[[3, 0, 1, 2]], position=self._placing.shown(position),
                visible=visible,
            )  # fmt: skip
            scene.add_label(f'/frames/{number}/name', name, anchor='top-left', visible=visible)
