# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Viser's server, as this package uses it."""

from __future__ import annotations

import contextlib
import io

import viser


class LocalServer(viser.ViserServer):
    """A server that tells nobody else: viser's tunnel to the outside stays shut."""

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
