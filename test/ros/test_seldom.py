# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lines of the log that may come by the thousand."""

from bvh_ros.ros.texts import Seldom


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
