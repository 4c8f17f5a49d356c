# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lazy properties hold no lock that a forked child would wait for."""

from tree.compiler.alone import run_alone

FORK = """
    import os, signal, threading
    from bvh_ros.scene.shapes.lazy import LazyProperty

    begun, may_end = threading.Event(), threading.Event()

    class Owner:
        slow = False

        @LazyProperty
        def value(self):
            if self.slow:
                begun.set()
                may_end.wait()
            return object()

    one = Owner()
    one.slow = True
    thread = threading.Thread(target=lambda: one.value)
    thread.start()
    begun.wait()
    child = os.fork()
    if child == 0:
        signal.alarm(60)  # s; ends what hangs
        other = Owner()
        os._exit(0 if other.value is other.value else 1)
    _, code = os.waitpid(child, 0)
    may_end.set()
    thread.join()
    assert code == 0, code
"""


def test_a_child_computes_while_a_thread_of_its_parent_did():
    run_alone(FORK)
