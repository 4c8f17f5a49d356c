# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pages in a browser: opened, clicked, and compared with what must be seen."""

from __future__ import annotations

import colorsys
import contextlib
import io
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from bvh_ros.scene import NodeScene
from bvh_ros.scene.shapes.shape import rotations
from bvh_ros.tree.access import PALETTE
from bvh_ros.view.page import Page
from bvh_ros.view.picking import view_of
from bvh_ros.view.stage import LocalServer
from bvh_ros.view.worlds import ShownWorld, namespace_of

TIMEOUT = 600.0  # seconds: WebGL without a graphics card is slow, on a loaded machine above all
HUE = 0.06  # of the whole circle: shading changes hues a little
GREY = 0.25  # saturation below which a pixel is background, grid or text


def until(condition: Callable[[], Any], what: str) -> Any:
    deadline = time.monotonic() + TIMEOUT
    while not (found := condition()):
        assert time.monotonic() < deadline, what
        time.sleep(0.05)
    return found


def page_of(name: str, scene: NodeScene, port: int) -> Page:
    """A page of a scene, served from now on."""
    return Page(LocalServer('127.0.0.1', port), ShownWorld(name, scene))


def shown_scene(name: str, scene: NodeScene) -> contextlib.AbstractContextManager[Page]:
    return shown(ShownWorld(name, scene))


def shown_warehouse(at: float) -> contextlib.AbstractContextManager[Page]:
    """The recorded one, at so many seconds."""
    from bvh_ros.view.recorded import open_recording

    recording = open_recording(None)
    recording.playing = False
    recording.seek(at)
    return shown(recording)


@contextlib.contextmanager
def shown(world: ShownWorld) -> Iterator[Page]:
    """A page that is served until the end, without question, shadows, grid and frames."""
    # A port that none had before: a page of another server would come back to its number.
    server = LocalServer('127.0.0.1', 0)
    page = Page(server, world)
    page.panel.ask.value = 'nothing'
    for control in (page.panel.shadows, page.panel.grid, page.panel.frames):
        control.value = False
    page.stage.set_theme()
    page.stage.draw_frames()
    ended = threading.Event()
    thread = threading.Thread(target=page.run, args=(ended.is_set,))
    thread.start()
    try:
        yield page
    finally:
        ended.set()
        thread.join()
        server.stop()


def visit(browser: Any, page: Page, count: int) -> None:
    """Open a page, and wait until it tells of so many obstacles."""
    before = {*page.server.get_clients()}
    browser.get(f'http://127.0.0.1:{page.server.get_port()}/')
    until(lambda: f'{count:,} obstacles' in text_of(browser), 'the page does not count')
    until(lambda: {*page.server.get_clients()} - before, 'no client')
    close = (
        'document.querySelectorAll(".mantine-Notification-closeButton").forEach(x => x.click())'
    )
    browser.execute_script(close)  # it tells that there is no graphics card


def wait_for_pictures(browser: Any) -> None:
    """Wait until the browser has drawn all that it has been told."""
    script = 'return window.counted.frames'
    before = browser.execute_script(script)
    until(lambda: browser.execute_script(script) > before + 2, 'nothing is drawn')


def text_of(browser: Any) -> str:
    text: str = browser.execute_script('return document.body.innerText')
    return text


def canvas_of(browser: Any) -> Any:
    return browser.find_element('tag name', 'canvas')


def press(browser: Any, label: str) -> None:
    """Click the button, or the box, that a label stands on or beside."""
    path = (
        f'//button[normalize-space()="{label}"] | '
        f'//label[normalize-space()="{label}"]/following::input[@type="checkbox"][1]'
    )
    button = until(lambda: browser.find_elements('xpath', path), f'no {label}')[0]
    browser.execute_script('arguments[0].scrollIntoView(); arguments[0].click()', button)


def camera_of(page: Page) -> Any:
    return [*page.server.get_clients().values()][-1].camera


def camera_due(page: Page) -> Any:
    """Where a camera will be when the browser has carried out every command.

    Its reports come late on a busy machine, so the camera may stand elsewhere for a moment.
    """
    number, client = [*page.server.get_clients().items()][-1]
    place, target = view_of(client.camera)
    return place + page.picking.following.aims.get(number, target) - target


def pixel_of(page: Page, canvas: Any, point: Any) -> tuple[float, float]:
    """Where a point of the world is seen, in pixels from the middle of the canvas, right, down."""
    camera = camera_of(page)
    turn = rotations(np.array(camera.wxyz)[None, [1, 2, 3, 0]])[0]
    place = page.placing.shown(np.array(point, np.float64))
    right, down, ahead = turn.T @ (place - camera.position)
    scale = 0.5 * canvas.size['height'] / np.tan(0.5 * camera.fov)
    return scale * right / ahead, scale * down / ahead


def click(browser: Any, at: tuple[float, float]) -> None:
    """Click so many pixels from the middle of the canvas."""
    from selenium.webdriver import ActionChains

    chain = ActionChains(browser, duration=0)
    chain.move_to_element_with_offset(canvas_of(browser), *(round(one) for one in at))
    chain.click().perform()


def picture_of(browser: Any) -> Any:
    """What is seen, (height, width, 3) from 0 to 1."""
    from PIL import Image

    picture = Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert('RGB')
    return np.asarray(picture) / 255.0


def differences(browser: Any, page: Page, every: int = 5) -> tuple[int, int, int]:
    """Compare a picture, pixel by pixel, with what exact rays meet.

    Returns how many pixels were compared, how many of them have to show an obstacle, and how many
    differ. Left out is where a neighbour has to show something else: an edge is blurred.
    """
    picture, canvas, camera = picture_of(browser), canvas_of(browser), camera_of(page)
    height, width = canvas.size['height'], canvas.size['width']
    turn = rotations(np.array(camera.wxyz)[None, [1, 2, 3, 0]])[0]
    down, right = np.mgrid[every : height - every : every, every : width - every : every]
    scale = 2.0 * np.tan(0.5 * camera.fov) / height
    ahead = np.stack(
        ((right + 0.5 - width / 2) * scale, (down + 0.5 - height / 2) * scale, 0.0 * right + 1.0),
        axis=2,
    )
    ends = camera.position + 20.0 * page.stage.size * (ahead @ turn.T)
    scene, start = page.world.scene, page.placing.in_world(np.array(camera.position))
    wanted = np.full(right.shape, -1)
    for at in np.ndindex(*right.shape):
        hit = scene.raycast(start, page.placing.in_world(ends[at]))
        if hit is not None:
            name = namespace_of(hit.name) or scene.get(hit.name).source
            wanted[at] = page.numbers[name] % len(PALETTE)
    inner = wanted[1:-1, 1:-1]
    sure = np.ones(inner.shape, bool)
    for side in (wanted[:-2, 1:-1], wanted[2:, 1:-1], wanted[1:-1, :-2], wanted[1:-1, 2:]):
        sure &= side == inner
    colours = picture[down[1:-1, 1:-1][sure], right[1:-1, 1:-1][sure]]
    differ = sum(not _is(*one) for one in zip(inner[sure], colours, strict=True))
    return int(sure.sum()), int((inner[sure] >= 0).sum()), differ


def _is(wanted: int, colour: Any) -> bool:
    hue, _, _ = colorsys.rgb_to_hls(*colour)
    saturation = float(colour.max() - colour.min())
    if wanted < 0:
        return saturation < GREY
    should, _, _ = colorsys.rgb_to_hls(*PALETTE[wanted])
    away = abs(hue - should)
    return saturation >= 0.5 * GREY and min(away, 1.0 - away) < HUE
