# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A shape in canonical form as one record, as kernels read it."""

import numpy as np
from numpy.typing import NDArray

# `shaped` is anything but an axis-aligned box: it needs a narrow phase.
GEOMETRY = np.dtype(
    [
        ('position', np.float64, (3,)),
        ('orientation', np.float64, (4,)),
        ('half', np.float64, (3,)),
        ('kind', np.uint8),
        ('shaped', np.bool_),
        ('mesh', np.int32),  # in what alignment leaves free
    ],
    align=True,
)

UNTURNED = np.zeros((), GEOMETRY)  # what is not `shaped` has this kind and orientation
UNTURNED['orientation'] = (0.0, 0.0, 0.0, 1.0)

Records = NDArray[np.void]  # of GEOMETRY
