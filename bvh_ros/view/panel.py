# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The controls and figures beside the picture."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Hashable, Mapping
from html import escape
from typing import Any

import numpy as np
import viser

from bvh_ros.ros.conversions.outlines import edges
from bvh_ros.tree.access import BLOCKED_COLOUR, FREE_COLOUR
from bvh_ros.view.drawing import COLOURS, Dots, Lines, Placing, Shown
from bvh_ros.view.worlds import NO_LINES, NO_POINTS, Answer, Floats, Recording, ShownWorld

# ---- The probe: a segment or box between two handles, and its hits


NOTHING, SEGMENT, BOX = 'nothing', 'a segment', 'a box'
CHOICES = (SEGMENT, BOX, NOTHING)
AHEAD = 0.1  # of the world's length: that far outside it the first segment begins
SHOWN = 5  # names of a longer answer


class Probe:
    """Asks again whenever a handle or the world has moved."""

    def __init__(self, server: viser.ViserServer, placing: Placing) -> None:
        self._server, self._placing = server, placing
        self._lines = Lines(server, placing, '/ask/lines', 4.0)
        self._spots = Dots(server, placing, '/ask/hits', BLOCKED_COLOUR)
        self._handles: list[viser.TransformControlsHandle] = []
        self._label = Shown(server, server.scene.add_label, '/ask/answer', anchor='bottom-center')
        self._query: Hashable = None
        self.kind = NOTHING
        self.answer, self.milliseconds = '', 0.0

    def choose(self, kind: str, lo: Floats, hi: Floats, size: float) -> None:
        """Begin with two handles in the world between two corners, or end; all as on the page.

        A segment goes through the middle, lengthwise.
        """
        self.kind, self._query = kind, None
        self.answer, self.milliseconds = '', 0.0
        for handle in self._handles:
            handle.remove()
        self._handles.clear()
        if kind == NOTHING:
            self._show(NO_LINES, NO_POINTS, '', 1.0)
            return
        middle, reach = 0.5 * lo + 0.5 * hi, np.array((0.25, 0.12, 0.02)) * size
        if kind == SEGMENT:
            along = np.arange(3) == np.argmax((hi - lo)[:2])
            reach = np.where(along, (0.5 + AHEAD) * (hi - lo), 0.0)
        for name, place in (('a', middle - reach), ('b', middle + reach)):
            handle = self._server.scene.add_transform_controls(
                f'/ask/{name}', scale=0.09 * size, disable_rotations=True, position=place,
                translation_limits=((-1e9, 1e9),) * 3, depth_test=False,
            )  # fmt: skip
            self._handles.append(handle)

    def place(self, one: Floats, other: Floats) -> None:
        """Put the handles at two places (3,) of the world, m."""
        for handle, place in zip(self._handles, (one, other), strict=True):
            handle.position = self._placing.shown(place)

    def ends(self) -> tuple[Floats, Floats]:
        """Where the handles are in the world, two of (3,), m."""
        one, other = (
            self._placing.in_world(np.array(handle.position, np.float64))
            for handle in self._handles
        )
        return one, other

    def update(self, world: ShownWorld, version: Hashable, size: float) -> None:
        """Ask, if anything has moved."""
        if self.kind == NOTHING:
            return
        one, other = self.ends()
        query = (*one.tolist(), *other.tolist(), version)
        if query == self._query:
            return
        self._query = query
        try:
            answer = (world.raycast if self.kind == SEGMENT else world.overlap)(one, other)
        except (RuntimeError, ValueError) as error:
            self.answer = escape(f'no answer: {error}')
            return
        self.answer, self.milliseconds = in_words(answer), 1e-3 * answer.microseconds
        spots = np.array([hit.point for hit in answer.hits]).reshape(-1, 3)
        lines = np.stack((one, other))[None]
        if self.kind == BOX:
            lines = edges(np.minimum(one, other)[None], np.maximum(one, other)[None])
        elif len(spots):
            lines = np.array([(one, spots[0])])
        lines = np.concatenate((lines, answer.edges))
        names = ', '.join(hit.name for hit in answer.hits[:SHOWN])
        self._show(lines, spots, names or 'free', size)

    def _show(self, lines: Floats, spots: Floats, text: str, size: float) -> None:
        colour = BLOCKED_COLOUR if len(spots) else FREE_COLOUR
        self._lines.draw(lines, np.tile(colour, (len(lines), 1)))
        self._spots.draw(spots, 0.01 * size)
        if not text:
            self._label.clear()
            return
        place = spots[0] if len(spots) else lines.mean(axis=(0, 1))
        self._label.draw(text=text, position=self._placing.shown(place))


def in_words(answer: Answer) -> str:
    """The obstacles hit, where, and the time of the query, as HTML."""
    took = f'<span style="white-space:nowrap">· {answer.microseconds:,.0f} us</span>'
    if not answer.hits:
        return f'<b>free</b> {took}'
    names = ', '.join(f'<b>{escape(hit.name)}</b>' for hit in answer.hits[:SHOWN])
    rest = len(answer.hits) - SHOWN
    more = f' and {rest} more' if rest > 0 else ''
    first = answer.hits[0]
    row = f', triangle {first.triangle}' if first.triangle >= 0 else ''
    return f'{names}{more} at ({in_digits(*first.point)}) m{row} {took}'


def in_digits(*metres: float) -> str:
    """Millimetres where the largest needs no more and no fewer."""
    largest = max(abs(one) for one in metres)
    if largest == 0.0 or 0.01 <= largest < 1e7:
        return ', '.join(f'{round(one, 3) + 0.0:.3f}' for one in metres)  # no -0.000
    return ', '.join(f'{one:.6g}' for one in metres)


# ---- The controls and figures beside the picture


MOST_IN_LEGEND = 12
SPEEDS = ('0.1', '0.25', '0.5', '1', '2', '5', '10')
KEPT = 240  # points of the time line: two minutes
Do = Callable[[Callable[[], object]], None]


class Panel:
    """Everything that can be read and set.

    What a control does is not done in viser's threads, but handed to `do`, as is what the page
    does by itself: nothing happens twice at a time.
    """

    def __init__(self, server: viser.ViserServer, world: ShownWorld, do: Do) -> None:
        self._gui, self._do = server.gui, do
        self._recording: Recording | None = None
        self._title = self._gui.add_html('')
        write(self._title, f'<b>{escape(world.title)}</b>')
        self.legend = self._gui.add_html('')
        if isinstance(world, Recording):
            self._add_player(world)
        with self._gui.add_folder('Ask'):
            self.ask = self._gui.add_dropdown('with', CHOICES)
            self.answer = self._gui.add_html('')
        with self._gui.add_folder('Clicked'):
            self.picked = self._gui.add_html('')
            self.follow = self._gui.add_checkbox('follow', False, disabled=True)
        with self._gui.add_folder('Time line'):
            self._line = TimeLine(self._gui)
        with self._gui.add_folder('Tree'):
            self.tree = self._gui.add_checkbox('boxes', False)
            deepest = max(1, world.height)
            self.depths = self._gui.add_multi_slider('depths', 0, deepest, 1, (0, min(3, deepest)))
        with self._gui.add_folder('Show'):
            self.all = self._gui.add_button('Look at all')
            self.queries = self._gui.add_checkbox('queries and hits', world.has_queries)
            self.queries.visible = world.has_queries
            self.scan = self._gui.add_checkbox('virtual scan', world.has_scan)
            self.scan.visible = world.has_scan
            self.grid = self._gui.add_checkbox('grid', True)
            self.frames = self._gui.add_checkbox('frames', True)
            self.shadows = self._gui.add_checkbox('shadows', True)
            self.dark = self._gui.add_checkbox('dark', False)
        with self._gui.add_folder('Statistics', expand_by_default=False):
            self._figures = self._gui.add_html('')

    def _add_player(self, recording: Recording) -> None:
        self._recording = recording
        with self._gui.add_folder('Recording'):
            self._time = self._gui.add_slider(
                'time [s]', 0.0, max(recording.seconds, 0.01), 0.01, 0
            )
            buttons = self._gui.add_button_group('', ('Play', 'Pause', 'Step'))
            speed = self._gui.add_dropdown('speed', SPEEDS, initial_value='1')
        self.on(self._time, lambda: self._seek(recording))
        self.on_click(buttons, lambda: self._press(recording, buttons.value))
        self.on(speed, lambda: setattr(recording, 'speed', float(speed.value)))

    def _seek(self, recording: Recording) -> None:
        if abs(self._time.value - recording.t) > 0.02:  # else the view itself moved the slider
            recording.playing = False
            recording.seek(self._time.value)

    def _press(self, recording: Recording, button: str) -> None:
        if button == 'Step':
            recording.step()
        else:
            recording.playing = button == 'Play'

    def on(self, control: Any, act: Callable[[], object]) -> None:
        """Call `act` when a control is set in a browser."""
        control.on_update(lambda event: self._do(act) if event.client is not None else None)

    def on_click(self, button: Any, act: Callable[[], object]) -> None:
        """Have something done when a button is clicked."""
        button.on_click(lambda _event: self._do(act))

    def tell(
        self, title: str, count: int, milliseconds: float, figures: Mapping[str, str]
    ) -> None:
        """Write how many obstacles there are, how long the last answer took, the figures, and
        where a recording is.
        """
        write(self._title, f'<b>{count:,} obstacles</b> · {escape(title)}')
        write(self._figures, *(_row(escape(key), escape(value)) for key, value in figures.items()))
        self._line.add(count, milliseconds)
        if self._recording is not None:
            self._time.value = round(min(self._recording.t, self._recording.seconds), 2)

    def tell_legend(self, legend: Mapping[str, tuple[int, int]]) -> None:
        """Write which colour stands for what; `legend` gives a colour's number and a count."""
        lines = []
        for name, (number, count) in list(legend.items())[:MOST_IN_LEGEND]:
            square = f'width:.8em;height:.8em;border-radius:2px;background:{_css(number)}'
            lines.append(_row(escape(name), f'{count:,}', f'<span style="{square}"></span>'))
        if len(legend) > MOST_IN_LEGEND:
            lines.append(f'<div>and {len(legend) - MOST_IN_LEGEND} more</div>')
        write(self.legend, *lines)


class TimeLine:
    """The number of obstacles, and how long answers took, over the last minutes."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._began = time.monotonic()
        self._rows = deque[tuple[float, int, float]]((), KEPT)
        axis = {'font': '10px sans-serif', 'size': 34, 'gap': 2, 'ticks': {'show': False}}
        lines, none, up = {'stroke': '#8884', 'width': 1}, {'show': False}, {'soft': 0, 'mode': 1}
        scale = {'range': {'min': up, 'max': {'pad': 0.1, 'soft': 0, 'mode': 0}}}
        count, took = _css(2), _css(1)
        self._plot = gui.add_uplot(
            self._columns(),
            (
                {'label': 's'},
                {'label': 'obstacles', 'scale': 'count', 'stroke': count, 'width': 2},
                {'label': 'answer [ms]', 'scale': 'ms', 'stroke': took, 'width': 2},
            ),
            scales={'x': {'time': False}, 'count': scale, 'ms': scale},
            axes=(
                {**axis, 'size': 24, 'stroke': '#888', 'grid': none},
                {**axis, 'scale': 'count', 'stroke': count, 'grid': lines},
                {**axis, 'scale': 'ms', 'side': 1, 'stroke': took, 'grid': none},
            ),
            padding=(8, 0, 0, 0),
            aspect=1.9,
        )

    def add(self, count: int, milliseconds: float) -> None:
        """Add a point at this time."""
        self._rows.append((time.monotonic() - self._began, count, milliseconds))
        self._plot.data = self._columns()

    def _columns(self) -> tuple[Floats, ...]:
        return tuple(np.array(self._rows, np.float64).reshape(-1, 3).T.copy())


def _css(number: int) -> str:
    return 'rgb({},{},{})'.format(*COLOURS[number % len(COLOURS)])


def _row(left: str, right: str, before: str = '') -> str:
    """A line of HTML with something at either end."""
    return (
        f'<div style="display:flex;gap:.5em;align-items:center;padding-right:.7em">{before}'
        f'<span style="flex:1">{left}</span><span>{right}</span></div>'
    )


def write(handle: Any, *lines: str) -> None:
    """Write lines of HTML, in which all that came from outside is escaped.

    Viser's Markdown would draw HTML and pictures that stand in an obstacle's name. Only changes
    are written: each is sent to every browser.
    """
    each = ''.join(f'<div>{line}</div>' for line in lines)
    style = 'padding:.1em .5em .5em .8em;font-size:.82em;line-height:1.55;overflow-wrap:anywhere'
    text = f'<div style="{style}">{each}</div>'
    if handle.content != text:
        handle.content = text
