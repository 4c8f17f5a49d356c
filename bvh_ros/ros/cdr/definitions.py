# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether a message is defined here as a decoder expects it."""

from __future__ import annotations

import importlib
import re
from collections.abc import Mapping
from typing import Any

Definition = Mapping[str, Mapping[str, str]]  # type name -> field -> type


def of(message_type: Any) -> Definition:
    """Return the fields of a message class and of all that are nested in it."""
    found: dict[str, dict[str, str]] = {}
    name = f'{message_type.__module__.partition(".")[0]}/{message_type.__name__}'
    waiting = [(name, message_type)]
    while waiting:
        name, message = waiting.pop()
        if name in found:
            continue
        found[name] = dict(message.get_fields_and_field_types())
        for field in found[name].values():
            for package, nested in re.findall(r'(\w+)/(\w+)', field):
                module = importlib.import_module(f'{package}.msg')
                waiting.append((f'{package}/{nested}', getattr(module, nested)))
    return found


def difference(message_type: Any, expected: Definition) -> str:
    """Name the first type that is defined otherwise, or return an empty text.

    The order of the fields counts: it is that of the bytes.
    """
    here = of(message_type)
    for name in sorted({*here, *expected}):
        if list(here.get(name, {}).items()) != list(expected.get(name, {}).items()):
            return name
    return ''
