# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page in a real browser: what is seen, counted, clicked and asked is what the scene holds."""

import json
import time

import numpy as np
import pytest

pytest.importorskip('viser', reason='viser is not installed')

from view import pages
from view.pages import text_of, until

from bvh_ros.scene import Mesh, NodeScene, ShapeKind, Shapes

pytestmark = pytest.mark.slow

EVIL = '<img src="http://127.0.0.1:9/" onerror="document.title = 1">![](http://127.0.0.1:9/)**'
KINDS = {
    'crate': (ShapeKind.BOX, (0.0, 0.0, 0.5), (1.0, 2.0, 1.0), (0.0, 0.0, 0.38, 0.92)),
    'post': (ShapeKind.CYLINDER, (3.0, 3.0, 0.5), (1.0, 1.0, 1.0), (0.2, 0.1, 0.0, 0.97)),
    'ball': (ShapeKind.SPHERE, (-2.0, 3.0, 0.5), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0, 1.0)),
    EVIL: (ShapeKind.CAPSULE, (-3.0, -1.0, 1.0), (0.8, 0.8, 3.0), (0.5, 0.2, 0.0, 0.84)),
}
CORNERS = np.array([(-1.0, -1.0, -0.5), (1.0, -1.0, -0.5), (0.0, 1.0, -0.5), (0.0, 0.0, 1.0)])
FARAWAY = [  # metres, and where
    (1.0, (0.0, 0.0, 0.0)),
    (1.0, (5e6, 4e5, 120.0)),  # a map in UTM coordinates
    (1e12, (0.0, 0.0, 0.0)),
    (1e-12, (0.0, 0.0, 0.0)),
]


def five(unit=1.0, at=(0.0, 0.0, 0.0)):
    """One of each shape, each of a source of its own."""
    scene = NodeScene()
    for name, (kind, place, size, turn) in KINDS.items():
        shape = Shapes([kind], [at + unit * np.array(place)], turn, unit * np.array(size))
        assert scene.update(name, [name], shape, stamp=0) == []
    mesh = Mesh([unit * np.delete(CORNERS, corner, axis=0) for corner in range(4)])
    shape = Shapes.of_meshes([mesh], [at + unit * np.array((3.0, -1.0, 0.5))])
    assert scene.update('mesh', ['mesh'], shape, stamp=0) == []
    return scene


@pytest.fixture(scope='module')
def page():
    with pages.shown_scene('five', five()) as shown:
        yield shown


@pytest.fixture(scope='module')
def opened(browser, page):
    """The browser, once it shows the page."""
    pages.visit(browser, page, 5)
    return browser


def test_every_pixel_shows_what_an_exact_ray_meets(opened, page):
    def right():
        compared, obstacles, differ = pages.differences(opened, page)
        return compared > 1000 and obstacles > 100 and differ == 0

    until(right, 'something else is seen')
    page.todo.put(page.world.scene.clear)  # the comparison can fail
    until(lambda: '0 obstacles' in text_of(opened), 'the page does not count')
    page.world.scene = five()
    until(lambda: '5 obstacles' in text_of(opened), 'the page does not count')


def test_a_click_names_the_obstacle(opened, page):
    for name, (kind, place, *_) in KINDS.items():
        told = f'{kind.name.lower()}, '

        def named(name=name, place=place, told=told):
            pages.click(opened, pages.pixel_of(page, pages.canvas_of(opened), place))
            time.sleep(1.0)
            return told in (text := text_of(opened)) and f'{name} at' in text

        until(named, f'{name} is not named')


def test_a_segment_is_answered_as_its_handle_moves(opened, page):
    segment, higher = np.array(((-4.0, 0.0, 0.5), (4.0, 0.0, 0.5))), np.array((0.0, 0.0, 5.0))
    page.todo.put(lambda: setattr(page.panel.ask, 'value', 'a segment'))
    page.todo.put(page.ask)
    page.todo.put(lambda: page.probe.place(*segment))
    hit = page.world.scene.raycast(*segment)
    told = '{} at ({:.3f}, {:.3f}, {:.3f}) m · '.format(hit.name, *hit.point)
    until(lambda: told in text_of(opened), 'no answer')
    page.todo.put(lambda: page.probe.place(*(segment + higher)))
    until(lambda: 'free · ' in text_of(opened), 'it is not free')


def test_two_browsers_see_the_same(opened, page):
    first = opened.current_window_handle
    opened.switch_to.new_window('window')
    pages.visit(opened, page, 5)
    until(lambda: len(page.server.get_clients()) == 2, 'there are not two')
    page.todo.put(lambda: page.world.scene.remove('ball', ['ball']))
    for window in (opened.current_window_handle, first):
        opened.switch_to.window(window)
        until(lambda: '4 obstacles' in text_of(opened), 'the page does not count')


def test_nothing_is_asked_of_others_and_nothing_goes_wrong(opened, page):
    """Whatever stands in a name: no picture was fetched, and no program run."""
    assert 'onerror' in text_of(opened)
    assert opened.title != '1'
    wrong = [entry for entry in opened.get_log('browser') if entry['level'] == 'SEVERE']
    assert wrong == []
    asked = set()
    for entry in opened.get_log('performance'):
        said = json.loads(entry['message'])['message']
        if said['method'] in ('Network.requestWillBeSent', 'Network.webSocketCreated'):
            asked.add(said['params'].get('request', said['params'])['url'])
    here = f'127.0.0.1:{page.server.get_port()}'
    begins = (f'http://{here}', f'ws://{here}', 'data:', f'blob:http://{here}')
    assert [url for url in asked if not url.startswith(begins)] == []
    assert any(url.startswith(f'http://{here}') for url in asked)


def test_the_tunnel_of_viser_stays_shut(page):
    assert page.server.request_share_url() is None
    assert page.server._share_tunnel is None


@pytest.mark.parametrize(('unit', 'at'), FARAWAY[1:])
def test_far_from_the_origin_huge_and_tiny(browser, unit, at):
    with pages.shown_scene('five', five(unit, at)) as page:
        pages.visit(browser, page, 5)
        until(lambda: pages.differences(browser, page)[1:] > (100, 0), 'nothing is seen')
        until(lambda: pages.differences(browser, page)[2] == 0, 'something else is seen')


def test_a_world_that_is_empty_and_grows(browser):
    scene = NodeScene()
    with pages.shown_scene('grows', scene) as page:
        pages.visit(browser, page, 0)

        def put(name, x, size):
            scene.update(name, [name], Shapes.boxes([(x, 0.0, 0.0)], size), stamp=0)

        for count, (x, size) in enumerate(((0.0, 0.1), (40.0, 30.0)), 1):
            page.todo.put(lambda count=count, x=x, size=size: put(str(count), x, size))
            until(lambda count=count: f'{count} obstacle' in text_of(browser), 'not counted')
        pages.press(browser, 'Look at all')

        def right():
            _, obstacles, differ = pages.differences(browser, page)
            return obstacles > 100 and differ == 0

        until(right, 'something else is seen')
