# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The sign of a sum of products, against rational arithmetic; above all where all but the last bit
cancels.
"""

from fractions import Fraction

import numpy as np
import pytest
from tree.adversary import MIXED, coordinates
from tree.reference import LARGEST, SMALLEST

from bvh_ros.tree.query.exact import sign_of_four_products

UP = np.nextafter(1.0, 2.0)

SUMS = {
    'nothing': ([0.0] * 8, 0),
    'signed zeros': ([-0.0, 1.0, 0.0, -1.0, -0.0, -0.0, 0.0, 5.0], 0),
    'one': ([1, 1, 0, 0, 0, 0, 0, 0], 1),
    'minus one': ([1, -1, 0, 0, 0, 0, 0, 0], -1),
    'cancels': ([3, 7, -3, 7, 0.1, 0.1, 0.1, -0.1], 0),
    'one ulp squared is left': ([UP, UP, -1, UP + (UP - 1), 0, 0, 0, 0], 1),
    'the least product is left': (
        [LARGEST, LARGEST, -LARGEST, LARGEST, SMALLEST, SMALLEST, 0, 0],
        1,
    ),
    'minus the least product': (
        [LARGEST, LARGEST, -LARGEST, LARGEST, SMALLEST, -SMALLEST, 0, 0],
        -1,
    ),
    'carries through all limbs': ([LARGEST, LARGEST] * 4, 1),
    'borrows through all limbs': ([-LARGEST, LARGEST] * 4, -1),
    'subnormals': ([SMALLEST, SMALLEST, SMALLEST, SMALLEST, -2 * SMALLEST, SMALLEST, 0, 0], 0),
    'large against small': ([1e300, 1e-300, -1, 1, 0, 0, 0, 0], None),
}


def exact_sign(values: list[float]) -> int:
    total = sum(Fraction(a) * Fraction(b) for a, b in zip(values[::2], values[1::2], strict=True))
    return (total > 0) - (total < 0)


@pytest.mark.parametrize(('values', 'sign'), SUMS.values(), ids=SUMS.keys())
def test_sums(values: list[float], sign: int | None) -> None:
    values = [float(value) for value in values]
    expected = exact_sign(values)
    assert sign is None or sign == expected
    for turn in range(0, 8, 2):
        assert sign_of_four_products(*values[turn:], *values[:turn]) == expected


@pytest.mark.parametrize('scale', [1.0, 1e-300, 1e300, MIXED])
def test_random_sums_that_nearly_cancel(scale: float) -> None:
    """Pairs of opposite products, one factor of each moved by some ulp."""
    rng = np.random.default_rng(1)
    signs = []
    for _ in range(2000):
        a, b, c, d = coordinates(rng, (4,), scale).tolist()
        values = [a, b, c, d, -a, b, c, -d]
        for place in rng.choice(8, rng.integers(0, 3), replace=False):
            values[place] = float(np.nextafter(values[place], rng.choice([-LARGEST, LARGEST])))
        signs.append(exact_sign(values))
        assert sign_of_four_products(*values) == signs[-1]
    assert set(signs) == {-1, 0, 1}
