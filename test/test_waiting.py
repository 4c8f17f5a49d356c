# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Answers that nobody waits for any more."""

import gc

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

from rclpy.task import Future

from bvh_ros.client import BvhError
from bvh_ros.client.waiting import Pending


@pytest.mark.parametrize('comes', ['before', 'meanwhile', 'after'])
def test_an_error_that_nobody_waits_for_is_not_complained_of(comes: str, capfd):
    answer, error = Future(), BvhError('the node cannot answer')
    if comes == 'before':
        answer.set_exception(error)

    def forget(future: Future) -> None:
        if comes == 'meanwhile':  # another thread was faster
            future.set_exception(error)

    Pending(None, answer, 'the node', forget).forget()
    if comes == 'after':  # it had been taken by another thread
        answer.set_exception(error)
    del answer
    gc.collect()
    assert capfd.readouterr() == ('', '')
