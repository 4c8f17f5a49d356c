# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes while other threads query, and forks while they do: an answer is right, or a
RuntimeError says why there is none.
"""

import os
import threading

import numpy as np
import pytest
from tree.compiler.alone import run_alone
from tree.reference import effort

from bvh_ros import DynamicBVH
from bvh_ros.tree.access import OpenTree

# Boxes stand in one of two places, all at once. Further ones come and go, and make the arrays
# grow, where masks hide them. So each answer is that for one of the two places.
RUN = """
    import collections, faulthandler, os, sys, threading, time
    import numpy as np
    from bvh_ros import DynamicBVH

    rng = np.random.default_rng(0)
    N = 1500
    places = rng.uniform(0, 60, (2, N, 3))
    o, d = rng.uniform(0, 60, (800, 3)), rng.normal(size=(800, 3))
    few = slice(0, 40)
    SEEN = 1

    def lists(*arrays):
        return [np.asarray(array).tolist() for array in arrays]

    questions = {
        'raycast': lambda t: [(h.id, h.t) if h else None for h in
                              (t.raycast(o[0], d[0], mask=SEEN),)],
        'raycast_all': lambda t: [(h.id, h.t) for h in t.raycast_all(o[1], d[1], mask=SEEN)],
        'occluded': lambda t: t.occluded(o[2], d[2], mask=SEEN),
        'raycast_many': lambda t: lists(*t.raycast_many(o, d, mask=SEEN)),
        'threads': lambda t: lists(*t.raycast_many(o, d, mask=SEEN, threads=3)),
        'occluded_many': lambda t: lists(t.occluded_many(o[few], d[few], mask=SEEN)),
        'raycast_all_many': lambda t: lists(*t.raycast_all_many(o[few], d[few], mask=SEEN)),
        'overlap': lambda t: lists(t.overlap(o[3], o[3] + 3, SEEN)),
        'overlap_many': lambda t: lists(*t.overlap_many(o, o + 3, SEEN, threads=2)),
        'overlap_pairs': lambda t: lists(t.overlap_pairs(SEEN)),
        'nearest_many': lambda t: lists(*t.nearest_many(o, 2, mask=SEEN)),
        'nearest': lambda t: lists(*t.nearest(o[5], 2, mask=SEEN)),
        'boxcast': lambda t: t.boxcast(o[4], o[4] + 1, d[4] * 50, SEEN).t,
        'boxes': lambda t: lists(*t.boxes(handles)),
        'masks': lambda t: lists(t.masks(handles)),
        'shape': lambda t: (t.height < 99, t.cost() > 0, len(t) >= N, len(t.stats()) > 9),
        'ids': lambda t: (t.ids()[:N].tolist(), t.bounds is None, len(t.levels(0, 3, 99)[0]) > 0),
        'validate': lambda t: t.validate(),
        'copy': lambda t: t.__getstate__()['ndim'],
    }
    which, margin = sys.argv[1].split(','), float(sys.argv[2])
    trees = [DynamicBVH(margin=margin) for _ in places]
    for tree, lo in zip(trees, places):
        tree.insert_many(lo, lo + 1)
    handles = trees[0].ids()
    right = {name: [questions[name](tree) for tree in trees] for name in which}
    tree, other = trees
    other.move_many(handles, places[0], places[0] + 1)  # all changes are compiled, or loaded
    other.remove_many(other.insert_many(o, o + 1, 4))
    other.insert([0, 0, 0], [1, 1, 1], 4)
    other.optimize()
    other.rebuild()
    faulthandler.dump_traceback_later(2000, exit=True)  # says where it hangs
    stop = time.monotonic() + float(sys.argv[3])
    counts = collections.Counter()

    def goes_on():  # so long, and until each question had an answer and something was refused
        seen = counts['all', 'refused'] and all(counts[name, 'done'] for name in which)
        return time.monotonic() < stop or not seen

    def end(raised):  # what a thread raises ends all of them
        sys.excepthook(*raised[:3])
        os._exit(1)

    threading.excepthook = end

    def attempt(name, call):
        try:
            answer = call()
        except RuntimeError as error:
            assert 'by another thread' in str(error), error
            counts[name, 'refused'] += 1
            counts['all', 'refused'] += 1
            return None
        counts[name, 'done'] += 1
        return answer

    def ask(first):
        turn = first
        while goes_on():
            name = which[turn % len(which)]
            turn += 1
            answer = attempt(name, lambda: (questions[name](tree),))
            if answer is not None and answer[0] not in right[name]:
                counts[name, 'WRONG'] += 1

    def change(seed):
        turns = np.random.default_rng(seed)
        extra = np.array([], np.int64)
        while goes_on():
            kind = turns.integers(8)
            if kind < 3:
                lo = places[turns.integers(2)]
                attempt('move', lambda: tree.move_many(handles, lo, lo + 1))
            elif kind == 3:
                new = attempt('insert', lambda: tree.insert_many(o, o + 1, 4))
                extra = extra if new is None else np.append(extra, new)
            elif kind == 4 and len(extra):
                if attempt('remove', lambda: (tree.remove_many(extra),)) is not None:
                    extra = extra[:0]
            elif kind == 5:
                attempt('optimize', tree.optimize)
            elif kind == 6:
                new = attempt('one', lambda: tree.insert([0, 0, 0], [1, 1, 1], 4))
                extra = extra if new is None else np.append(extra, new)
            else:
                attempt('rebuild', tree.rebuild)
            time.sleep(0.001)

    threads = [threading.Thread(target=ask, args=(k,), daemon=True) for k in range(3)]
    threads += [threading.Thread(target=change, args=(k,), daemon=True) for k in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    tree.validate()
    assert not [key for key in counts if key[1] == 'WRONG'], counts
    tree.insert([0, 0, 0], [1, 1, 1])
"""

QUERIES = (
    'raycast,raycast_all,occluded,overlap,nearest,boxcast',
    'raycast_many,threads,occluded_many,raycast_all_many',
    'overlap_many,overlap_pairs,nearest_many',
    'boxes,masks,shape,ids,validate,copy',
)


@pytest.mark.parametrize('queries', QUERIES)
@pytest.mark.parametrize('margin', [0.0, pytest.param(0.2, marks=pytest.mark.slow)])
def test_queries_while_others_change(queries: str, margin: float) -> None:
    run_alone(RUN, queries, str(margin), str(effort(2, 60)))


def test_a_change_from_a_signal_handler_or_the_like_within_a_query() -> None:
    """It is done between two kernels, where no turn is taken; the query says that it was."""
    lo = np.random.default_rng(1).uniform(0, 20, (300, 3))
    tree = OpenTree(capacity=301)
    tree.insert_many(lo, lo + 1)
    view = tree.view()
    tree.insert([0, 0, 0], [1, 1, 1])
    with pytest.raises(RuntimeError, match='changed'):
        tree.check_unchanged(view)
    with pytest.raises(RuntimeError, match='changed'):
        tree.snapshot_for(10**6, view)
    tree.validate()


def test_a_growth_within_a_query() -> None:
    """The change is done in larger arrays: the query goes on in those of before, and what it
    leaves behind is not taken for the tree of now.
    """
    lo = np.random.default_rng(1).uniform(0, 20, (300, 3))
    tree = OpenTree.from_boxes(lo, lo + 1)
    view = tree.view()
    new = tree.insert([-9, 0, 0], [-8, 1, 1])
    tree.check_unchanged(view)
    before = tree.snapshot_for(10**6, view)
    starts, ways = np.tile([-10.0, 0.5, 0.5], (70, 1)), np.tile([1.0, 0, 0], (70, 1))
    assert before is not None
    assert new not in view.tree.handles
    assert set(tree.raycast_many(starts, ways).ids) == {new}


def test_worker_threads_do_not_pile_up() -> None:
    lo = np.random.default_rng(2).uniform(0, 20, (500, 3))
    tree = DynamicBVH.from_boxes(lo, lo + 1)
    for threads in range(2, 12):
        tree.raycast_many(lo, lo, threads=threads)
        tree.overlap_many(lo, lo + 1, threads=threads)
    mine = [thread for thread in threading.enumerate() if thread.name.startswith('bvh_ros')]
    assert len(mine) <= (os.cpu_count() or 1)


FORK = """
    import faulthandler, os, signal, sys, threading, time
    import numpy as np
    from bvh_ros import DynamicBVH

    faulthandler.register(signal.SIGALRM, chain=True)  # says where it hangs, then ends it
    changes = sys.argv[1] == 'changes'
    lo = np.random.default_rng(3).uniform(0, 60, (3000, 3))
    tree = DynamicBVH.from_boxes(lo, lo + 1)
    tree.raycast_many(lo, lo, threads=2)
    other = DynamicBVH.from_boxes(lo, lo + 1)  # all that is called is compiled, or loaded
    other.move(int(other.ids()[0]), lo[1], lo[1] + 1)
    other.move_many(other.ids()[:50], lo[50:100], lo[50:100] + 1)
    other.insert([0, 0, 0], [1, 1, 1])
    other.raycast_many(lo, lo)
    other.rebuild()
    other.validate()
    stop = False

    def busy():
        while not stop:
            try:
                if changes:
                    tree.move(int(handles[0]), lo[1], lo[1] + 1)
                    tree.rebuild()
                else:
                    tree._wide = 0, 0, None, None  # a snapshot is built by each batch
                    tree.raycast_many(lo, lo, threads=2)
            except RuntimeError:
                pass

    handles = tree.ids()
    threads = [threading.Thread(target=busy) for _ in range(2)]
    for thread in threads:
        thread.start()
    codes, allowed = [], {0, 256} if changes else {0}
    # On to a fork between two changes: on a loaded machine that may be a late one.
    while (len(codes) < int(sys.argv[2]) or 0 not in codes) and set(codes) <= allowed:
        time.sleep(0.003 * (len(codes) % 5))
        child = os.fork()
        if child == 0:
            signal.alarm(1000)  # seconds: a loaded machine is slow
            code = 0
            try:
                tree.raycast_many(lo, lo, threads=2)
                tree.insert([0, 0, 0], [1, 1, 1])
                tree.move_many(handles[:50], lo[50:100], lo[50:100] + 1)
                tree.raycast_many(lo, lo)
                tree.validate()
            except RuntimeError as error:
                code = 1 if 'by another thread' in str(error) else 2
            except BaseException:
                code = 3
            os._exit(code)
        codes.append(os.waitpid(child, 0)[1])
    stop = True
    for thread in threads:
        thread.join()
    tree.validate()
    assert set(codes) <= allowed, codes
"""


@pytest.mark.skipif(not hasattr(os, 'fork'), reason='this system does not fork')
@pytest.mark.parametrize('meanwhile', ['queries', 'changes'])
def test_forks_in_the_middle(meanwhile: str) -> None:
    """A child has a tree of its own, and whose turn it was in the parent does not matter. Only a
    tree that was being changed is half changed: the child is told.
    """
    run_alone(FORK, meanwhile, str(effort(20, 500)), PYTHONWARNINGS='ignore')
