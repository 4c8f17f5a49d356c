# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A real Chromium without a window, and what its page counts."""

from __future__ import annotations

import shutil
from typing import Any

FLAGS = (
    '--headless=new',
    '--no-sandbox',  # CI runs as root
    '--use-gl=angle',
    '--use-angle=swiftshader',  # WebGL without a graphics card
    '--enable-unsafe-swiftshader',
    '--disable-background-networking',
    '--disable-dev-shm-usage',
    '--force-device-scale-factor=1',
)
START_TIMEOUT = 120  # seconds
TIMEOUT = 600  # seconds, for what it is asked: a loaded machine is slow

# Runs before the page's own program. A picture is a frame of the browser in which something was
# drawn; an update is one before which places of obstacles went to the graphics card.
COUNTERS = """
window.counted = {frames: 0, pictures: 0, updates: 0};
let drawn = false, sent = false;
const spy = (name, note) => {
  const real = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...given) {
    note(...given);
    return real.apply(this, given);
  };
};
for (const name of ['drawElements', 'drawElementsInstanced', 'drawArrays', 'drawArraysInstanced'])
  spy(name, () => { drawn = true; });
spy('texSubImage2D', (target, level, x, y, width) => { sent = sent || width >= 16; });
const count = () => {
  window.counted.frames += 1;
  window.counted.pictures += drawn;
  window.counted.updates += drawn && sent;
  drawn = sent = false;
  requestAnimationFrame(count);
};
requestAnimationFrame(count);
"""


def find() -> tuple[str, str] | None:
    """Paths of the browser and of its driver, if this machine has them."""
    browser = shutil.which('chromium') or shutil.which('chromium-browser')
    driver = shutil.which('chromedriver')
    return None if browser is None or driver is None else (browser, driver)


def open_browser(width: int, height: int) -> Any:
    """A selenium driver; what the page asks of the network is logged."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    found = find()
    assert found is not None, 'no chromium and chromedriver here (Debian: chromium-driver)'
    options = webdriver.ChromeOptions()
    options.binary_location = found[0]
    for flag in (*FLAGS, f'--window-size={width},{height}'):
        options.add_argument(flag)
    options.add_experimental_option('browserStartupTimeout', 1000 * START_TIMEOUT)
    options.set_capability('goog:loggingPrefs', {'browser': 'ALL', 'performance': 'ALL'})
    opened = webdriver.Chrome(options=options, service=Service(found[1]))
    opened.command_executor.client_config.timeout = TIMEOUT
    opened.set_page_load_timeout(TIMEOUT)
    opened.set_script_timeout(TIMEOUT)
    opened.execute_cdp_cmd('Page.addScriptToEvaluateOnNewDocument', {'source': COUNTERS})
    return opened
