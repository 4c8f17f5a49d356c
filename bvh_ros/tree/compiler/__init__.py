# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The door to numba: decorators for kernels, and what decides when they are compiled."""

from . import kernel_cache, shipped
from .compiling import (
    address_of,
    called_at,
    chosen_by_types,
    entry_point,
    inlined,
    kernel,
    lean_kernel,
    prepare,
)
from .intrinsics import (
    CACHE_LINE,
    LANES,
    WIDTH,
    bits_of,
    clear8,
    copy8,
    elements_at,
    fma,
    index,
    largest8,
    largest_difference8,
    prefetch,
    stack_array,
    swap8,
    trailing_zeros,
)
from .shipped import host_features
from .workers import Workers, fork_ahead, processors
