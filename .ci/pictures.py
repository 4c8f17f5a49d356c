# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Draw every picture that the README and docs/ show.

Run: python .ci/pictures.py [FOLDER] [--quick]. Without a folder those in resource/ are replaced.
--quick draws small scenes, which shows that each can still be drawn. A picture that needs what is
missing here (a browser, a recording) is left out, and named.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TRACKS = ROOT.parent / 'shared' / 'data' / 'commonroad_ngsim' / 'USA_US101-4_1_T-1.csv'


def draw_error(file: Path, quick: bool) -> str:
    """Error against run time of rays at corners, edges and faces."""
    from bvh_ros.report.error import worlds
    from bvh_ros.report.page import Page

    with tempfile.TemporaryDirectory() as folder:
        page = Page(Path(folder))
        page.begin('Error', '')
        worlds.adversarial_scene(page, quick)
        shutil.copy(Path(folder) / 'error_adversarial.png', file)
    return ''


def draw_prediction(file: Path, quick: bool) -> str:
    """What prediction is worth among recorded traffic."""
    if quick:
        return 'test/test_examples.py draws it'
    if not TRACKS.is_file():
        return f'there is no {TRACKS}'
    script = ROOT / 'examples' / 'predicted_traffic.py'
    subprocess.run([sys.executable, script, TRACKS, '--plot', file], check=True)
    return ''


def draw_edges(file: Path, quick: bool) -> str:
    """Error against run time of edges between poses."""
    from bvh_ros.report import edges
    from bvh_ros.report.page import Page

    with tempfile.TemporaryDirectory() as folder:
        page = Page(Path(folder))
        page.begin('Edges', '')
        edges.resolutions(page, quick)
        shutil.copy(Path(folder) / 'edge_resolutions.png', file)
    return ''


def draw_door(file: Path, quick: bool) -> str:
    """A long load through a doorway, checked at the poses and between them."""
    if quick:
        return 'test/test_examples.py draws it'
    script = ROOT / 'examples' / 'load_through_a_door.py'
    subprocess.run([sys.executable, script, '--picture', file], check=True)
    return ''


def draw_view(file: Path, quick: bool) -> str:
    """The warehouse of the demo in a browser, with a segment along the aisle."""
    sys.path.insert(0, str(ROOT / 'test'))
    from view import chromium, pages

    if chromium.find() is None:
        return 'there is no chromium and chromedriver'
    from bvh_ros import scenarios
    from bvh_ros.view.page import Page
    from bvh_ros.view.recorded import Tracks
    from bvh_ros.view.stage import LocalServer

    world = Tracks('warehouse', list(scenarios.warehouse()))
    server, ended = LocalServer('127.0.0.1', 8300), threading.Event()
    page, browser = Page(server, world), chromium.open_browser(1200, 860)
    thread = threading.Thread(target=page.run, args=(ended.is_set,))
    thread.start()
    try:
        pages.visit(browser, page, 8)
        page.todo.put(lambda: setattr(world, 'playing', False))
        page.todo.put(lambda: world.seek(3.0))
        page.todo.put(lambda: setattr(page.panel.ask, 'value', 'a segment'))
        page.todo.put(page.ask)
        page.todo.put(lambda: page.probe.place((0.0, 0.0, 1.0), (16.0, 0.0, 1.0)))
        pages.until(lambda: 'forklift/0 at' in pages.text_of(browser), 'no answer')
        forklift = pages.pixel_of(page, pages.canvas_of(browser), (13.0, -2.0, 2.0))

        def named() -> bool:
            pages.click(browser, forklift)
            return 'forklift/1 at' in pages.text_of(browser)

        pages.until(named, 'no obstacle was clicked')
        browser.save_screenshot(str(file))
    finally:
        ended.set()
        thread.join()
        browser.quit()
        server.stop()
    return ''


DRAWN = {
    'door.png': draw_door,
    'edge_resolutions.png': draw_edges,
    'error_adversarial.png': draw_error,
    'prediction.png': draw_prediction,
    'view.png': draw_view,
}


def main() -> int:
    """Draw; fail if a page shows a picture that is not drawn here."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('folder', type=Path, nargs='?', default=ROOT / 'resource')
    parser.add_argument('--quick', action='store_true')
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    texts = [page.read_text('utf-8') for page in (ROOT / 'README.md', *ROOT.glob('docs/*.md'))]
    shown = {name for text in texts for name in re.findall(r'\]\([./]*resource/([^)]+)\)', text)}
    if shown != set(DRAWN):
        print(f'shown, or drawn, but not both: {", ".join(sorted(shown ^ set(DRAWN)))}')
        return 1
    for name, draw in DRAWN.items():
        absent = draw(options.folder / name, options.quick)
        print(f'{name} is left out: {absent}' if absent else f'drawn: {options.folder / name}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
