# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Verdicts of the report: they fail where something is wrong, and the command says so."""

import math
from fractions import Fraction
from functools import partial

import pytest

from bvh_ros import DynamicBVH
from bvh_ros.report import cli, stability
from bvh_ros.report.stability import LARGEST, Case, rounded, within_2_ulp


@pytest.mark.parametrize(
    ('t', 'exact', 'right'),
    [
        (1.0, Fraction(1), True),
        (1.0 + 2**-51, Fraction(1), True),
        (1.0 + 3 * 2**-52, Fraction(1), False),
        (0.0, Fraction(1, 10**330), True),
        (5e-324, Fraction(0), True),
        (2e-323, Fraction(0), False),
        (math.inf, Fraction(10**309), True),
        (LARGEST, Fraction(10**309), True),
        (1e308, Fraction(10**309), False),
        (math.inf, Fraction(10**308), False),
    ],
)
def test_two_ulp(t, exact, right):
    assert within_2_ulp(t, exact) is right


def test_rounding_beyond_the_doubles():
    assert rounded(Fraction(10**400)) == math.inf
    assert rounded(Fraction(1, 3)) == 1 / 3


@pytest.mark.parametrize('case', stability.ray_cases(), ids=lambda case: case.name)
def test_rays(case):
    assert case.passed, case


def test_rays_at_a_mesh():
    wrong = [case for case in stability.mesh_cases() if not case.passed]
    assert not wrong, wrong


def test_a_wrong_answer_fails(monkeypatch):
    monkeypatch.setattr(DynamicBVH, 'raycast', lambda *_, **__: None)
    assert not all(case.passed for case in stability.ray_cases())


def test_a_wrong_distance_fails(monkeypatch):
    right = DynamicBVH.raycast_many

    def off(self, *arguments, **options):
        hits = right(self, *arguments, **options)
        return hits._replace(t=hits.t * (1 + 1e-15))

    monkeypatch.setattr(DynamicBVH, 'raycast_many', off)
    assert not all(case.passed for case in stability.ray_cases())


@pytest.mark.parametrize('passed', [True, False])
def test_the_command_fails_if_a_case_does(passed, monkeypatch, tmp_path):
    pytest.importorskip('matplotlib')
    case = Case('a case', 'input', '1', '2', passed)
    section = partial(stability.judge, 'Some', lambda brief: [case])
    monkeypatch.setattr(stability, 'SECTIONS', {'some': section})
    arguments = ['stability', '--quick', '--out', str(tmp_path)]
    if passed:
        cli.main(arguments)
    else:
        with pytest.raises(SystemExit) as stopped:
            cli.main(arguments)
        assert stopped.value.code not in (None, 0)
    text = (tmp_path / 'stability_some.csv').read_text(encoding='utf-8')
    assert ('PASS' in text, 'FAIL' in text) == (passed, not passed)
    assert 'of 1 cases passed' in (tmp_path / 'report.md').read_text(encoding='utf-8')
