# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Answers that nobody waits for any more."""

import gc

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)

from bvh_ros.client import BvhError
from bvh_ros.client.waiting import Patience, Question


@pytest.mark.parametrize('comes', ['before', 'meanwhile', 'after'])
def test_an_error_that_nobody_waits_for_is_not_complained_of(comes: str, capfd):
    error = BvhError('the node cannot answer')

    class Asked(Question):
        def forget(self) -> None:
            if comes == 'meanwhile':  # another thread was faster
                self.answer.set_exception(error)

    question = Asked('the node', Patience())
    if comes == 'before':
        question.answer.set_exception(error)
    question.drop()
    if comes == 'after':  # it had been taken by another thread
        question.answer.set_exception(error)
    del question
    gc.collect()
    assert capfd.readouterr() == ('', '')
