# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Draw every picture that the README and docs/ show.

Run: PYTHONPATH=test python .ci/pictures.py [FOLDER] [--quick] [--only NAME...]. Without a folder
those of this repository are replaced. --quick draws small scenes, which shows that each can still
be drawn. A picture that needs what is missing (a browser, a recording) is left out, and named.
"""

import argparse
import contextlib
import io
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from query_pictures import PICTURES, Picture
from view import chromium, pages

from bvh_ros import scenarios
from bvh_ros.report import planner
from bvh_ros.report.error import worlds
from bvh_ros.report.page import Page
from bvh_ros.view import page as view
from bvh_ros.view.recorded import Tracks
from bvh_ros.view.stage import LocalServer

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = ROOT / 'examples'
TRACKS = ROOT.parent / 'shared' / 'data' / 'commonroad_ngsim' / 'USA_US101-4_1_T-1.csv'
NO_BROWSER = 'there is no chromium and chromedriver'
SIZE = 1000, 760  # pixels of the browser's window
STEP, SETTLE = 0.15, 0.4  # s: from frame to frame of the animation; until WebGL has drawn one
LARGEST = 2_000_000  # bytes of the animation
Draw = Callable[[Path, bool], str]  # writes a file, quickly or well; why not, or nothing


def of_report(name: str, sections: Callable[[Page, bool], object]) -> Draw:
    """The picture `name` of a section of the report."""

    def draw(file: Path, quick: bool) -> str:
        with tempfile.TemporaryDirectory() as folder:
            page = Page(Path(folder))
            page.begin(name, '')
            sections(page, quick)
            shutil.copy(Path(folder) / f'{name}.png', file)
        return ''

    return draw


def of_example(*command: str | Path) -> Draw:
    """The picture that an example writes to the file after its last argument."""

    def draw(file: Path, quick: bool) -> str:
        if quick:
            return 'test/test_examples.py draws it'
        if TRACKS in command and not TRACKS.is_file():
            return f'there is no {TRACKS}'
        subprocess.run([sys.executable, *command, file], check=True)
        return ''

    return draw


# ---- The demo in a browser


@contextlib.contextmanager
def warehouse(width: int, height: int) -> Iterator[tuple[Any, Any]]:
    """The demo's warehouse, paused, and a browser that shows it."""
    world = Tracks('warehouse', list(scenarios.warehouse()))
    world.playing = False
    server, ended = LocalServer('127.0.0.1', 0), threading.Event()
    page, browser = view.Page(server, world), chromium.open_browser(width, height)
    thread = threading.Thread(target=page.run, args=(ended.is_set,))
    thread.start()
    try:
        pages.visit(browser, page, len(world.scene))
        yield page, browser
    finally:
        ended.set()
        thread.join()
        browser.quit()
        server.stop()


def show(page: Any, browser: Any, t: float) -> None:
    """Have the browser show a time, s, with the answer of that time."""
    shown = page.sent
    page.todo.put(lambda: page.world.seek(t))
    pages.until(lambda: page.sent > shown, 'nothing is drawn')
    asked = threading.Event()
    page.todo.put(asked.set)  # is done before the next picture: by then that one is answered
    pages.until(asked.is_set, 'nothing is asked')
    answer = re.sub('<[^>]*>', '', page.probe.answer)
    pages.until(lambda: answer in pages.text_of(browser), 'another answer is shown')


def draw_view(file: Path, quick: bool) -> str:
    """The warehouse, with a clicked obstacle."""
    del quick
    if chromium.find() is None:
        return NO_BROWSER
    with warehouse(1280, 1000) as (page, browser):
        show(page, browser, 3.0)
        forklift = pages.pixel_of(page, pages.canvas_of(browser), (13.0, -2.0, 2.0))

        def named() -> bool:
            pages.click(browser, forklift)
            return 'forklift/1 at' in pages.text_of(browser)

        pages.until(named, 'no obstacle was clicked')
        browser.save_screenshot(str(file))
    return ''


def of_query(picture: Callable[[], Picture]) -> Draw:
    """The picture of a query."""

    def draw(file: Path, quick: bool) -> str:
        picture().save(file)
        return ''

    return draw


def draw_demo(file: Path, quick: bool) -> str:
    """The warehouse as it moves."""
    if chromium.find() is None:
        return NO_BROWSER
    frames = []
    with warehouse(*SIZE) as (page, browser):
        for t in np.arange(0.5, 1.0 if quick else 9.0, STEP).tolist():
            show(page, browser, t)
            time.sleep(SETTLE)
            picture = Image.open(io.BytesIO(browser.get_screenshot_as_png()))
            frames.append(picture.convert('RGB'))
    how = {'duration': round(1000 * STEP), 'loop': 0, 'quality': 70, 'method': 6}
    frames[0].save(file, save_all=True, append_images=frames[1:], **how)
    size = file.stat().st_size
    if size > LARGEST:
        raise RuntimeError(f'{file} has {size:,} bytes')
    return ''


DRAWN = {
    'resource/demo.webp': draw_demo,
    'resource/door.png': of_example(EXAMPLES / 'load_through_a_door.py', '--picture'),
    'resource/edge_resolutions.png': of_report('edge_resolutions', planner.resolutions),
    'resource/error_adversarial.png': of_report('error_adversarial', worlds.adversarial_scene),
    'resource/prediction.png': of_example(EXAMPLES / 'predicted_traffic.py', TRACKS, '--plot'),
    'resource/view.png': draw_view,
    **{f'docs/pictures/{each.__name__}.svg': of_query(each) for each in PICTURES},
}
SHOWN = re.compile(r'\]\(([^)#]+\.(?:png|svg|webp))\)')


def shown() -> set[str]:
    """The pictures that pages show, as paths from the root."""
    paths = [
        (page.parent / name).resolve()
        for page in (ROOT / 'README.md', *ROOT.glob('docs/*.md'))
        for name in SHOWN.findall(page.read_text('utf-8'))
    ]
    return {path.relative_to(ROOT).as_posix() for path in paths}


def main() -> int:
    """Draw; fail if a page shows a picture that is not drawn here."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('folder', type=Path, nargs='?', default=ROOT)
    parser.add_argument('--quick', action='store_true')
    parser.add_argument('--only', nargs='+', choices=DRAWN, default=[*DRAWN], metavar='NAME')
    options = parser.parse_args()
    if differ := shown() ^ set(DRAWN):
        print(f'shown, or drawn, but not both: {", ".join(sorted(differ))}')
        return 1
    for name in options.only:
        file = options.folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        absent = DRAWN[name](file, options.quick)
        print(f'{name} is left out: {absent}' if absent else f'drawn: {file}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
