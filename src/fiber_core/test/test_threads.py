# SPDX-License-Identifier: Apache-2.0
import threading
from concurrent.futures import wait

import numpy as np
import pytest

from fiber_core.threads import share_out, started_pool, threads


@pytest.mark.parametrize("number", [1, 2, 3])
@pytest.mark.parametrize("count, least", [(0, 1), (1, 1), (7, 3), (1000, 1), (1000, 400)])
def test_all_of_the_work_is_done_once(number, count, least):
    done, sizes = np.zeros(count, dtype=int), []

    def work(first, last):
        done[first:last] += 1
        sizes.append(last - first)

    with threads(number):
        share_out(work, count, least)
    assert (done == 1).all()
    assert min(sizes, default=least) >= min(least, count)
    assert len(sizes) <= 1 or number > 1


def test_parts_go_on_side_by_side():
    together = threading.Barrier(2, timeout=30.0)
    with threads(2):
        share_out(lambda first, last: together.wait() and None, 2, 1)  # each waits for the other


def test_a_part_may_share_out_its_own_work():
    done = np.zeros((8, 8), dtype=int)

    def inner(row):
        def work(first, last):
            done[row, first:last] += 1

        return work

    def outer(first, last):
        for row in range(first, last):
            share_out(inner(row), 8, 1)

    with threads(2):
        share_out(outer, 8, 1)
    assert (done == 1).all()


@pytest.mark.parametrize("bad", ["caller", "helper"])
def test_an_error_of_a_part_is_raised_when_no_part_goes_on(bad, monkeypatch):
    # The part of the caller fails while the other one goes on until it is waited for; that of the
    # helper fails while the caller goes on.
    together, caller, done = threading.Barrier(2, timeout=30.0), threading.get_ident(), []
    failed, waited_for = threading.Event(), threading.Event()

    def wait_for(futures):
        waited_for.set()
        return wait(futures)

    def work(first, last):
        together.wait()
        is_caller = threading.get_ident() == caller
        if is_caller == (bad == "caller"):
            failed.set()
            raise ValueError(bad)
        (failed if is_caller else waited_for).wait(30.0)
        done.append(first)

    monkeypatch.setattr("fiber_core.threads.wait", wait_for)
    with threads(2):
        with pytest.raises(ValueError, match=bad):
            share_out(work, 2, 1)
        assert len(done) == 1


@pytest.fixture
def full(monkeypatch):
    """Function after which the system has no place for another thread."""

    def refuse(_):
        raise RuntimeError("can't start new thread")

    return lambda: monkeypatch.setattr(threading.Thread, "start", refuse)


def test_the_caller_works_alone_where_no_thread_can_be_started(full):
    done = np.zeros(100, dtype=int)

    def work(first, last):
        done[first:last] += 1

    full()
    with threads(3):
        share_out(work, 100, 1)
    assert (done == 1).all()


def test_work_of_a_pool_that_has_begun_starts_no_thread(full):
    pool = started_pool(3)
    full()
    together = threading.Barrier(3, timeout=30.0)
    for each in [pool.submit(together.wait) for _ in range(3)]:
        each.result()
    pool.shutdown()


def test_a_pool_that_cannot_begin_says_so_and_leaves_no_thread(monkeypatch):
    before, start, begun = threading.active_count(), threading.Thread.start, []

    def once(thread):
        if begun:
            raise RuntimeError("can't start new thread")
        begun.append(thread)
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", once)
    with pytest.raises(RuntimeError, match="can't start new thread"):
        started_pool(2)
    assert threading.active_count() == before


@pytest.mark.parametrize("begun", [1, 2, 3])
def test_an_interrupt_while_a_pool_begins_leaves_no_thread(monkeypatch, begun):
    before, start, started = threading.active_count(), threading.Thread.start, []

    def interrupted(thread):
        start(thread)
        started.append(thread)
        if len(started) == begun:
            raise KeyboardInterrupt

    monkeypatch.setattr(threading.Thread, "start", interrupted)
    with pytest.raises(KeyboardInterrupt):
        started_pool(3)
    for thread in started:
        thread.join(30.0)
    assert threading.active_count() == before
