# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Texts in log lines and errors: how long they are, how often they come, and what is counted."""

import logging

from bvh_ros.ros.texts import LISTED, LONGEST_LINE, Refused, Seldom, as_line, shortened
from bvh_ros.scene import Refusal


def test_texts_of_others_fit_into_a_line():
    assert shortened('short') == 'short'
    assert shortened('x' * 80) == 'x' * 80
    assert shortened('x' * 81) == 'x' * 80 + '... (81 characters)'
    assert shortened('a\nb\x1b') == 'a\\nb\\x1b'
    assert as_line(ValueError('one\n two ' + 'x' * 10**6)).startswith('one two xxx')
    assert len(as_line(ValueError('x' * 10**6))) < LONGEST_LINE + 30


def test_a_line_every_two_seconds_and_none_is_left_out(monkeypatch):
    now, said = [10.0], []
    monkeypatch.setattr('time.monotonic', lambda: now[0])
    seldom = Seldom(said.append)
    seldom.log()
    for total in (2, 4, 6):
        seldom.add(f'{total} are lost', 2)
    assert said == ['2 are lost (1 more since the last report)']
    now[0] += 2.0
    for _ in range(2):
        seldom.log()
    assert said[1:] == ['6 are lost (3 more since the last report)']


def test_refused_rows_are_listed_up_to_a_limit():
    refused = Refused(logging.getLogger('test'), 'source')
    refused.add_rows([Refusal(row, f'a/{row}', f'reason {row}') for row in range(7)])
    rows = refused.rows()
    assert rows['refused rows'].splitlines() == [f"'a/{i}': reason {i}" for i in range(7)]
    assert rows['refused rows not listed'] == 0
    refused.add_rows([Refusal(row, f'b/{row}', 'no') for row in range(3 * LISTED)])
    rows = refused.rows()
    assert len(rows['refused rows'].splitlines()) == LISTED
    assert rows['refused rows not listed'] == 2 * LISTED + 7
