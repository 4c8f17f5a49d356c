# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser: what is seen, counted, clicked and asked is what the scene holds."""

import colorsys
import io
import json
import threading
import time

import numpy as np
import pytest

pytest.importorskip('viser', reason='viser is not installed')

from bvh_ros.scene import Scene, ShapeKind, Shapes
from bvh_ros.scene.geometry.shapes import rotations
from bvh_ros.tree.plotting import PALETTE
from bvh_ros.view.page import LocalServer, Page
from bvh_ros.view.probe import SEGMENT
from bvh_ros.view.worlds import ShownWorld

TIMEOUT = 90.0  # seconds: WebGL without a graphics card is slow
PLACES = {'crates/1': (0.0, 0.0, 0.5), 'posts/1': (3.0, 3.0, 0.5), 'balls/1': (-2.0, 3.0, 0.5)}
KINDS = (ShapeKind.BOX, ShapeKind.CYLINDER, ShapeKind.SPHERE)


def until(condition, what):
    deadline = time.monotonic() + TIMEOUT
    while not (found := condition()):
        assert time.monotonic() < deadline, what
        time.sleep(0.05)
    return found


@pytest.fixture(scope='module')
def page():
    """A page about three obstacles, each of a source, kind and colour of its own."""
    scene = Scene()
    for (name, place), kind in zip(PLACES.items(), KINDS, strict=True):
        shape = Shapes.boxes([place], 1.0)._replace(kind=np.array([kind], np.uint8))
        scene.update(name.partition('/')[0], [name], shape, stamp=0)
    server = LocalServer('127.0.0.1', 8200)
    shown = Page(server, ShownWorld('three', scene))
    shown.panel.shadows.value = shown.panel.grid.value = False
    shown._set_theme()
    ended = threading.Event()
    thread = threading.Thread(target=shown.run, args=(ended.is_set,))
    thread.start()
    yield shown
    ended.set()
    thread.join()
    server.stop()


@pytest.fixture(scope='module')
def opened(browser, page):
    """The browser, once it shows the page."""
    browser.get(f'http://127.0.0.1:{page.server.get_port()}/')
    browser.text = lambda: browser.execute_script('return document.body.innerText')
    until(lambda: '3 obstacles' in browser.text(), 'the page does not count')
    until(page.server.get_clients, 'no client')
    return browser


def pixel_of(page, canvas, point):
    """Where a point is seen, in pixels from the middle of the canvas, right and down."""
    (client,) = page.server.get_clients().values()
    camera = client.camera
    turn = rotations(np.array(camera.wxyz)[None, [1, 2, 3, 0]])[0]
    right, down, ahead = turn.T @ (np.array(point) - camera.position)
    scale = 0.5 * canvas.size['height'] / np.tan(0.5 * camera.fov)
    return scale * right / ahead, scale * down / ahead


def click(browser, canvas, at):
    from selenium.webdriver import ActionChains

    chain = ActionChains(browser, duration=0)
    chain.move_to_element_with_offset(canvas, *(round(one) for one in at)).click().perform()


def canvas_of(browser):
    from selenium.webdriver.common.by import By

    return browser.find_element(By.TAG_NAME, 'canvas')


@pytest.mark.parametrize('name', PLACES)
def test_a_click_names_the_obstacle(opened, page, name):
    kind = KINDS[[*PLACES].index(name)].name.lower()
    told = f'{kind}, 1 x 1 x 1 m, of source {name.partition("/")[0]}'

    def named():
        click(opened, canvas := canvas_of(opened), pixel_of(page, canvas, PLACES[name]))
        time.sleep(1.0)
        return told in (text := opened.text()) and f'{name} at' in text

    until(named, f'{name} is not named')


def test_each_obstacle_is_seen_in_the_colour_of_its_source(opened, page):
    from PIL import Image

    canvas = canvas_of(opened)

    middle = np.array((canvas.size['width'], canvas.size['height'])) / 2
    wanted = [colorsys.rgb_to_hls(*colour)[0] for colour in PALETTE[:3]]

    def seen():
        picture = Image.open(io.BytesIO(opened.get_screenshot_as_png())).convert('RGB')
        at = [np.rint(middle + pixel_of(page, canvas, point)) for point in PLACES.values()]
        colours = [np.array(picture.getpixel((int(x), int(y)))) / 255 for x, y in at]
        hues = [colorsys.rgb_to_hls(*colour)[0] for colour in colours]
        return all(abs(hue - want) < 0.06 for hue, want in zip(hues, wanted, strict=True))

    until(seen, 'the colours are others')


def test_a_segment_is_answered_as_its_handle_moves(opened, page):
    page._todo.put(lambda: setattr(page.panel.ask, 'value', SEGMENT))
    page._todo.put(page._choose)
    page._todo.put(lambda: page.probe.place(np.array((-4.0, 0.0, 0.5)), np.array((4.0, 0.0, 0.5))))
    until(lambda: 'crates/1 at (-0.500, 0.000, 0.500) m' in opened.text(), 'no answer')
    page._todo.put(lambda: page.probe.place(np.array((-4.0, 0.0, 2.5)), np.array((4.0, 0.0, 2.5))))
    until(lambda: 'free ·' in opened.text(), 'it is not free')


def test_nothing_is_asked_of_others_and_nothing_goes_wrong(opened):
    wrong = [entry for entry in opened.get_log('browser') if entry['level'] == 'SEVERE']
    assert wrong == []
    asked = set()
    for entry in opened.get_log('performance'):
        said = json.loads(entry['message'])['message']
        if said['method'] in ('Network.requestWillBeSent', 'Network.webSocketCreated'):
            asked.add(said['params'].get('request', said['params'])['url'])
    begins = ('http://127.0.0.1:', 'ws://127.0.0.1:', 'data:', 'blob:http://127.0.0.1:')
    assert [url for url in asked if not url.startswith(begins)] == []
    assert any(url.startswith('http://127.0.0.1:') for url in asked)


def test_the_tunnel_of_viser_stays_shut(page):
    assert page.server.request_share_url() is None
    assert page.server._share_tunnel is None
