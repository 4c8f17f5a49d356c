# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a hand does on the page: handles are dragged, a recording is played, somebody followed."""

import re
from copy import copy

import numpy as np
import pytest

pytest.importorskip('viser', reason='viser is not installed')
pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

from view import pages
from view.pages import press, text_of, until

from bvh_ros import scenarios

pytestmark = pytest.mark.slow

MANY = 200  # steps: no report of a browser comes later than after so many
MET = re.compile(r'(\S+) at \(([-.\d]+), ([-.\d]+), ([-.\d]+)\) m · [\d,]+ us')


@pytest.fixture(scope='module')
def page():
    with pages.shown_warehouse(at=3.0) as shown:
        yield shown


@pytest.fixture(scope='module')
def opened(browser, page):
    pages.visit(browser, page, len(page.world.scene))
    return browser


def done(page, act):
    """Have the page do something, and wait for it."""
    ended = []
    page.todo.put(lambda: ended.append(act()))
    until(lambda: ended, 'the page does nothing')


def test_the_answer_follows_a_handle_that_is_dragged(opened, page):
    from selenium.webdriver import ActionChains

    ends = np.array(((0.5, 0.0, 1.0), (14.0, 0.0, 1.0)))
    done(page, lambda: setattr(page.panel.ask, 'value', 'a segment'))
    done(page, page.ask)
    done(page, lambda: page.probe.place(*ends))
    until(lambda: MET.search(text_of(opened)), 'no answer')
    pages.wait_for_pictures(opened)  # a hand takes hold of what is drawn
    first = page.probe.ends()
    # The middle of the arrow along y: a hand takes hold of it there.
    length = 0.09 * page.stage.size
    arrow = ends[1] + (0.0, 0.6 * length, 0.0)
    canvas = pages.canvas_of(opened)
    there = arrow + np.array((0.0, 2.0, 0.0))
    at, to = (np.array(pages.pixel_of(page, canvas, place)) for place in (arrow, there))
    chain = ActionChains(opened, duration=50)
    chain.move_to_element_with_offset(canvas, *(round(one) for one in at)).pause(0.5)
    chain.click_and_hold().pause(0.5).perform()
    answers = {page.probe.answer}
    way = [round(one) for one in (to - at) / 8]
    for _ in range(4):  # the button of the mouse is down all the time
        for _ in range(2):
            ActionChains(opened, duration=50).move_by_offset(*way).pause(0.3).perform()
        until(lambda: page.probe.answer not in answers, 'no other answer')
        answers.add(page.probe.answer)
    until(lambda: page.probe.ends()[1][1] > first[1][1] + 0.5, 'it is not dragged so far')
    last = page.probe.ends()
    ActionChains(opened).release().perform()
    np.testing.assert_array_equal(last[0], first[0])
    moved = last[1] - first[1]
    assert moved[1] < 4.0
    np.testing.assert_allclose(moved[[0, 2]], 0.0, atol=1e-6)

    def told():
        """What is told is the answer for the last place, which may come late."""
        hit = page.world.scene.raycast(*page.probe.ends())
        place = '({:.3f}, {:.3f}, {:.3f})'.format(*hit.point)
        return f'{hit.name} at {place} m · ' in text_of(opened)

    until(told, 'another answer')
    done(page, lambda: setattr(page.panel.ask, 'value', 'nothing'))
    done(page, page.ask)


def test_a_recording_is_played_paused_and_stepped(opened, page):
    before = page.world.t
    press(opened, 'Step')
    until(lambda: page.world.t == pytest.approx(before + 1.0 / scenarios.RATE), 'no step')
    press(opened, 'Play')
    until(lambda: page.world.playing and page.world.t > before + 0.3, 'it does not play')
    until(lambda: 'Pause' in text_of(opened), 'the button is another')
    press(opened, 'Pause')
    until(lambda: not page.world.playing, 'it does not pause')


def test_the_camera_goes_with_whom_it_follows(opened, page):
    done(page, lambda: page.world.seek(3.0))
    place = page.world.scene.get('forklift/0').position
    until(lambda: page.sent and page.world.t == 3.0, 'not shown')

    def named():
        pages.click(opened, pages.pixel_of(page, pages.canvas_of(opened), place))
        return 'forklift/0 at' in text_of(opened)

    until(named, 'not named')
    camera = np.array(pages.camera_of(page).position)
    press(opened, 'follow')
    until(lambda: page.panel.follow.value, 'nobody is followed')
    for number in range(1, 6):
        press(opened, 'Step')
        until(lambda t=3.0 + 0.1 * number: page.world.t == pytest.approx(t), 'no step')
    moved = page.world.scene.get('forklift/0').position - place
    assert moved[0] == pytest.approx(0.5)

    def went():
        return np.allclose(pages.camera_of(page).position - camera, moved, atol=1e-3)

    until(went, 'the camera stays')


def test_no_step_is_lost_by_a_late_report_or_because_it_is_small(opened, page):
    """What a browser reports overwrites what it was told meanwhile; viser tells no browser of a
    step that is 1e-5 of its coordinates.
    """
    assert page.panel.follow.value
    place, camera = page.world.scene.get('forklift/0').position, pages.camera_of(page)
    began = pages.camera_due(page)
    for number in range(1, 6):
        late, sent = copy(camera._state), page.sent
        done(page, lambda t=3.5 + 0.1 * number: page.world.seek(t))
        until(lambda before=sent: page.sent > before, 'no picture')
        camera._state = late
    done(page, lambda: page.world.seek(4.2))
    moved = page.world.scene.get('forklift/0').position - place
    assert moved[0] == pytest.approx(0.7)
    until(lambda: np.allclose(camera.position - began, moved, atol=5e-4), 'a step is lost')

    def creep():
        for _ in range(MANY):
            page.picking.following.go(np.array((0.0, 1e-5, 0.0)))

    began = began + moved  # not what the camera says: a late report may stand there for a moment
    done(page, creep)
    crept = (0.0, 1e-5 * MANY, 0.0)
    until(lambda: np.allclose(camera.position - began, crept, atol=5e-4), 'it stays behind')


def test_a_name_of_any_length_stays_in_the_panel(opened, page):
    name = 'x' * 500
    done(page, lambda: setattr(page.picking, 'answered', name))
    until(lambda: name in text_of(opened), 'not told')
    found = """
        const all = [...document.querySelectorAll('div')]
        const told = all.filter(e => e.textContent == arguments[0])
        return told.length > 0 && told.every(e => e.scrollWidth <= e.clientWidth)
    """
    assert opened.execute_script(found, name)


def test_dark_and_light(opened, page):
    def is_dark():
        """Sky at the left, and the panel at the right."""
        picture = pages.picture_of(opened)
        sky, panel = picture[3:30, 3:200], picture[60:300, -280:-10]
        return np.median(sky) < 0.3 and np.median(panel) < 0.3

    assert not is_dark()
    press(opened, 'dark')
    until(is_dark, 'it stays light')
    press(opened, 'dark')
    until(lambda: not is_dark(), 'it stays dark')
