# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether numba's inside is what `kernel_parts` and `kernel_files` build on.

These two are the only modules that import names which numba does not document, or set options
that it does not document, and they are imported here only. Without them kernels are compiled in
numba's own way: as right, but slower, and each process compiles its own. numba's own disk cache
is no help: it would run old code after an edit, and mix up record types (see `kernel_parts`).
"""

import functools
import warnings
from typing import Any

import numba

KNOWN = (0, 62), (0, 68)  # versions that were tested; setup.py allows no others


@functools.cache
def parts() -> Any:
    """Return the module `kernel_parts`; None, with a warning, where numba's inside is another."""
    why = f'numba {numba.__version__} is not one that bvh_ros was tested with'
    if KNOWN[0] <= numba.version_info.short <= KNOWN[1]:
        try:
            from . import kernel_parts
        except (ImportError, AttributeError) as error:
            why = f'numba {numba.__version__} is not as it was when bvh_ros was tested: {error}'
        else:
            return kernel_parts
    warnings.warn(
        f'{why}; kernels are slower, and every process compiles them', RuntimeWarning, stacklevel=2
    )
    return None
