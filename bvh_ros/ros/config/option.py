# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One parameter: declared with a descriptor and a range, read and checked."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterValueException

from bvh_ros.ros.texts import shortened

if TYPE_CHECKING:
    from rclpy.node import Node

FARTHEST = 1e9  # m, of lengths: what is told in doubles is exact to a tenth of a micrometre there
Value = bool | int | float | str | list[str] | list[float]


class ConfigurationError(ValueError):
    """A parameter has a value that the node cannot work with; the text says which and why."""


@dataclass(frozen=True)
class Option:
    """One parameter: its default (whose type it keeps), meaning and range."""

    name: str
    default: Value
    description: str
    minimum: float = -sys.float_info.max
    maximum: float = sys.float_info.max
    choices: tuple[str, ...] = ()


def read(node: Node, prefix: str, option: Option) -> Any:
    """Return the value of a parameter; declare it, unless an earlier life of the node did."""
    name = prefix + option.name
    if node.has_parameter(name):
        return _checked(name, option, node.get_parameter(name).value)
    descriptor = ParameterDescriptor(
        description=option.description, read_only=True, dynamic_typing=True
    )
    if option.choices:
        descriptor.additional_constraints = 'One of: ' + ', '.join(option.choices)
    low, high = option.minimum, option.maximum
    if isinstance(option.default, float):
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    elif isinstance(option.default, int) and not isinstance(option.default, bool):
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    try:
        value = node.declare_parameter(name, option.default, descriptor).value
    except InvalidParameterValueException as error:
        raise _out_of_range(name, option) from error
    return _checked(name, option, value)


def _checked(name: str, option: Option, value: Any) -> Any:
    """Return the value in its option's type or raise ConfigurationError."""
    default = option.default
    if isinstance(default, list):
        return _checked_list(name, default, value)
    if isinstance(default, bool):
        good, wanted = isinstance(value, bool), 'true or false'
    elif isinstance(default, float):
        good, wanted = _is_number(value, (int, float)), 'a number'
        value = float(value) if good else value
    elif isinstance(default, int):
        good, wanted = _is_number(value, (int,)), 'a whole number'
    else:
        good, wanted = isinstance(value, str), 'a string'
    if not good:
        raise ConfigurationError(f"parameter '{name}' must be {wanted}, not {_shown(value)}")
    if option.choices and value not in option.choices:
        choices = ', '.join(option.choices)
        raise ConfigurationError(
            f"parameter '{name}' must be one of {choices}, not {_shown(value)}"
        )
    # An integer given for a double escapes rclpy's own range check, and so does NaN.
    if _is_number(value, (int, float)) and not option.minimum <= value <= option.maximum:
        raise _out_of_range(name, option)
    return value


def _checked_list(name: str, default: Sequence[object], value: Any) -> list[Any]:
    items = [] if value is None else list(value) if _is_list(value) else None
    if isinstance(default[0], float):
        unlimited = not all(_is_finite(item) for item in default)
        good = _is_limit if unlimited else _is_finite
        if items is not None and all(good(item) for item in items):
            return [float(item) for item in items]
        wanted = 'numbers' if unlimited else 'finite numbers'
        raise ConfigurationError(f"parameter '{name}' must be {wanted}, not {_shown(value)}")
    if items is not None and all(isinstance(item, str) for item in items):
        # YAML cannot say "an empty list of strings" other than ['']
        return [item for item in items if item]
    raise ConfigurationError(f"parameter '{name}' must be a list of strings, not {_shown(value)}")


def _shown(value: Any) -> str:
    return shortened(repr(value))


def _out_of_range(name: str, option: Option) -> ConfigurationError:
    unlimited = sys.float_info.max
    low = f'at least {option.minimum:.10g}' if option.minimum > -unlimited else ''
    high = f'at most {option.maximum:.10g}' if option.maximum < unlimited else ''
    limits = ' and '.join(limit for limit in (low, high or 'finite') if limit)
    return ConfigurationError(f"parameter '{name}' must be {limits}")


def _is_number(value: Any, types: tuple[type, ...]) -> bool:
    return isinstance(value, types) and not isinstance(value, bool)


def _is_finite(value: Any) -> bool:
    return _is_number(value, (int, float)) and math.isfinite(value)


def _is_limit(value: Any) -> bool:
    return _is_number(value, (int, float)) and not math.isnan(value)


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, (str, bytes))
