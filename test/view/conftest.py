# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A real Chromium without a window, where the machine has one (Debian: chromium-driver)."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from typing import Any

import pytest

FLAGS = (
    '--headless=new',
    '--no-sandbox',  # CI runs as root
    '--use-gl=angle',
    '--use-angle=swiftshader',  # WebGL without a graphics card
    '--enable-unsafe-swiftshader',
    '--disable-background-networking',
    '--disable-dev-shm-usage',
    '--force-device-scale-factor=1',
    '--window-size=900,480',
)
START_TIMEOUT = 120


@pytest.fixture(scope='module')
def browser() -> Iterator[Any]:
    """A selenium driver; what the page asks of the network is logged."""
    webdriver = pytest.importorskip('selenium.webdriver', reason='selenium is not installed')
    chromium = shutil.which('chromium') or shutil.which('chromium-browser')
    driver = shutil.which('chromedriver')
    if chromium is None or driver is None:
        pytest.skip('no chromium and chromedriver here (Debian: apt install chromium-driver)')
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for flag in FLAGS:
        options.add_argument(flag)
    options.set_capability('goog:loggingPrefs', {'browser': 'ALL', 'performance': 'ALL'})
    opened = webdriver.Chrome(options=options, service=Service(driver))
    opened.set_page_load_timeout(START_TIMEOUT)
    yield opened
    opened.quit()
