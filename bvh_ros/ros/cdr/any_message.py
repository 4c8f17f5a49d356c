# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The bytes of a message of any type as columns of those fields that are wanted.

rclpy makes Python objects of all that a message holds, while nothing else is answered. Here a
plan is made once of the message's definition: a list of steps, each of which goes past a field. A
kernel takes the steps and notes where the wanted fields are. That is 1 to 2 us a row. A kernel for
one type of message takes a tenth: `marker_array` and `path` are for those of thousands of rows.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.cdr import definitions, reading
from bvh_ros.ros.cdr.reading import sequence, skip, text, visible_text
from bvh_ros.tree.compiler import lean_kernel, stack_array

NUMBERS = {'boolean': 'u1', 'octet': 'u1', 'char': 'u1', 'float': 'f4', 'double': 'f8'}
NUMBERS |= {f'int{8 * size}': f'i{size}' for size in (1, 2, 4, 8)}
NUMBERS |= {f'uint{8 * size}': f'u{size}' for size in (1, 2, 4, 8)}

# Kinds of steps. A loop is over the elements of a sequence; its body ends with a step of its own.
PIECE, TEXT, ELEMENTS, LOOP, END = range(5)
DEEPEST = 8  # loops in loops
UNWANTED = -1  # instead of a column
FEW = 256  # notes for which there is room at first


class Plan(NamedTuple):
    """How to go through a message, and what is wanted of it."""

    steps: NDArray[np.int64]  # (n, 4): kind; bytes or steps; alignment; column, or UNWANTED
    fields: list[str]  # (n,) what each step goes past, for errors
    columns: dict[str, int]  # of the wanted fields, by their paths
    numbers: dict[str, tuple[str, int]]  # of fields that are numbers: their type, how many


@functools.cache
def plan_of(message_type: Any, wanted: tuple[str, ...]) -> Plan:
    """Return the plan for a message class.

    Parameters
    ----------
    wanted : tuple of str
        Paths of fields, such as 'detections.bbox'; a field that has no column of its own stands
        for all in it.

    Raises
    ------
    ValueError
        If the class has no such field, as it is defined here.
    """
    planner = _Planner(definitions.of(message_type), wanted)
    planner.add(f'{message_type.__module__.partition(".")[0]}/{message_type.__name__}', '')
    for path in wanted:
        if not any(_is_within(column, path) for column in planner.columns):
            raise ValueError(f"{message_type.__name__} is defined here without '{path}'")
    steps = np.array(planner.steps, np.int64)
    return Plan(steps, planner.fields, planner.columns, planner.numbers)


def _is_within(path: str, other: str) -> bool:
    return path == other or path.startswith(f'{other}.')


class _Planner:
    """Makes the steps of a plan."""

    def __init__(self, definition: definitions.Definition, wanted: Sequence[str]) -> None:
        self.steps: list[list[int]] = []
        self.fields: list[str] = []
        self.columns: dict[str, int] = {}
        self.numbers: dict[str, tuple[str, int]] = {}
        self._definition = definition
        self._wanted = wanted

    def add(self, name: str, path: str) -> None:
        """Add the steps past a field of this type."""
        several = re.fullmatch(r'sequence<([^,]+)(?:, \d+)?>', name)
        element = several[1] if several else name
        if numbers := self._numbers_in(element):
            kind, count = numbers
            width = int(kind[1])
            self._step(ELEMENTS if several else PIECE, count * width, width, path)
            if path in self.columns:
                self.numbers[path] = numbers
        elif several:
            begin, loop = len(self.steps), self._step(LOOP, 0, 1, path)
            self.add(element, f'{path}.' if element.startswith('string') else path)
            self._step(END, 0, 1, '')
            loop[1] = len(self.steps) - begin
        elif element.startswith('string'):
            self._step(TEXT, 0, 1, path)
        elif element in self._definition:
            for field, its_type in self._definition[element].items():
                self.add(its_type, f'{path}.{field}' if path else field)
        else:
            raise ValueError(f"fields of type '{name}' cannot be read")

    def _step(self, kind: int, size: int, alignment: int, path: str) -> list[int]:
        column = UNWANTED
        if any(_is_within(path, other) for other in self._wanted):
            column = self.columns[path] = len(self.columns)
        step = [kind, size, alignment, column]
        self.steps.append(step)
        self.fields.append(path)
        return step

    def _numbers_in(self, name: str) -> tuple[str, int] | None:
        """The type of the numbers, and how many, if all of this type are of one."""
        if name in NUMBERS:
            return NUMBERS[name], 1
        if array := re.fullmatch(r'(.+)\[(\d+)\]', name):
            inner = self._numbers_in(array[1])
            return inner and (inner[0], inner[1] * int(array[2]))
        parts = [self._numbers_in(field) for field in self._definition.get(name, {}).values()]
        found = {part and part[0] for part in parts}
        if len(found) != 1 or None in found:
            return None
        return found.pop() or '', sum(part[1] for part in parts if part)


@lean_kernel
def walk(data, big_endian, steps, notes):
    """Go through a message; return where that ends, or why it cannot be gone on, the step that is
    to blame, and how many notes there are. Those that there is room for are written down: column,
    place and count.
    """
    first, left = stack_array(DEEPEST, np.int64), stack_array(DEEPEST, np.int64)
    at = step = noted = depth = np.int64(0)
    while step < steps.shape[0]:
        kind, size, alignment = steps[step, 0], steps[step, 1], steps[step, 2]
        column = steps[step, 3]
        begin, count, end = at, np.int64(1), at
        if kind == PIECE:
            end = skip(data, at, size, alignment)
            begin = end - size
        elif kind == TEXT and column == UNWANTED:
            begin, count, end = text(data, at, big_endian)
        elif kind == TEXT:
            begin, count, end = visible_text(data, at, big_endian)
        elif kind == ELEMENTS:
            begin, count, end = sequence(data, at, size, alignment, big_endian)
        elif kind == LOOP:  # no element is shorter than a byte
            begin, count, end = sequence(data, at, 1, 1, big_endian)
            end = begin if end >= 0 else end
        if end < 0:
            return end, step, noted
        if column != UNWANTED:
            if noted < notes.shape[0]:
                notes[noted, 0], notes[noted, 1], notes[noted, 2] = column, begin, count
            noted += 1
        at = end
        if kind == LOOP and count == 0:
            step += size
        elif kind == LOOP:
            first[depth], left[depth] = step + 1, count
            depth, step = depth + 1, step + 1
        elif kind == END and left[depth - 1] > 1:
            left[depth - 1] -= 1
            step = first[depth - 1]
        else:
            depth -= kind == END
            step += 1
    return at, step, noted


@lean_kernel
def gather(data, begins, sizes, found):
    """Copy pieces of so many bytes one after another."""
    at = 0
    for row in range(begins.shape[0]):
        for place in range(begins[row], begins[row] + sizes[row]):
            found[at] = data[place]
            at += 1


class Columns:
    """The wanted fields of one message. A row is one occurrence of a field, in order.

    Parameters
    ----------
    message : bytes
        As rclpy receives it with `raw`.

    Raises
    ------
    ValueError
        If it is none that the plan is for: truncated, or with lengths that contradict its size.
    """

    def __init__(self, message: bytes, plan: Plan) -> None:
        self._data, self._order = reading.body_of(message)
        self._plan = plan
        notes = np.empty((FEW, 3), np.int64)
        while True:
            given = self._data, self._order == '>', plan.steps, notes
            end, step, noted = walk(*given)
            if end < 0:
                raise ValueError(f"the field '{plan.fields[step]}' {reading.REASONS[end]}")
            if noted <= len(notes):
                break
            notes = np.empty((noted, 3), np.int64)
        notes = notes[:noted]
        notes = notes[np.argsort(notes[:, 0], kind='stable')]
        ends = np.searchsorted(notes[:, 0], np.arange(len(plan.columns)), side='right')
        self._notes = np.split(notes[:, 1:], ends[:-1])

    def counts(self, path: str) -> NDArray[np.int64]:
        """How many elements each row of a sequence has."""
        counts: NDArray[np.int64] = self._notes[self._plan.columns[path]][:, 1]
        return counts

    def numbers(self, path: str) -> NDArray[Any]:
        """The numbers (n, k) of all rows, one after another; k is how many an element has."""
        begins, counts = self._notes[self._plan.columns[path]].T
        kind, width = self._plan.numbers[path]
        dtype = np.dtype(kind).newbyteorder(self._order)  # type: ignore[arg-type]
        size = width * dtype.itemsize
        found = np.empty(int(counts.sum()) * size, np.uint8)
        gather(self._data, np.ascontiguousarray(begins), counts * size, found)
        return found.view(dtype).reshape(-1, width).astype(kind, copy=False)

    def texts(self, path: str) -> list[str]:
        """The text of each row."""
        rows = self._notes[self._plan.columns[path]].tolist()
        data = self._data.data
        return [bytes(data[at : at + size]).decode('utf-8', 'replace') for at, size in rows]

    def stamps(self, path: str) -> NDArray[np.int64]:
        """Times in ns, one a row."""
        seconds, rest = (self.numbers(f'{path}.{field}')[:, 0] for field in ('sec', 'nanosec'))
        return seconds.astype(np.int64) * 1_000_000_000 + rest


def exercise() -> None:
    """Call the kernels as messages do."""
    plan = Plan(np.array([[PIECE, 4, 4, 0]]), ['number'], {'number': 0}, {'number': ('u4', 1)})
    Columns(b'\0\1\0\0' + bytes(4), plan).numbers('number')
