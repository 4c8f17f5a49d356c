# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A browser, where the machine has one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from view import chromium


@pytest.fixture(scope='module')
def browser() -> Iterator[Any]:
    """A real Chromium without a window."""
    pytest.importorskip('selenium', reason='selenium is not installed')
    if chromium.find() is None:
        pytest.skip('no chromium and chromedriver here (Debian: apt install chromium-driver)')
    opened = chromium.open_browser(900, 480)
    yield opened
    opened.quit()
