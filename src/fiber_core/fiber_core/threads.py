# SPDX-License-Identifier: Apache-2.0
"""Compiled loops on all cores: independent parts of the work, one thread each.

A loop that is shared out must not hold the lock of the interpreter (`nogil`), and no part of it may
read what another one writes. Then the result is the same on any number of threads.
"""

import itertools
import os
import threading
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager

__all__ = ["share_out", "started_pool", "thread_count", "threads"]

_PARTS = 4  # of each thread: the longest part delays all others


class _Pool:
    # The helpers of this process, made when they are first needed: one less than the threads, as
    # the caller works too.

    def __init__(self, count: int):
        self.count = count
        self.executor: ThreadPoolExecutor | None = None

    def begin(self) -> ThreadPoolExecutor | None:
        # all at once: where no thread can be started there is none, and the caller works alone
        if self.executor is None:
            try:
                self.executor = started_pool(max(1, self.count - 1), "loops")
            except RuntimeError:
                return None
        return self.executor

    def forget(self) -> None:
        # the threads of the executor are not in a process that was forked
        self.executor = None


_POOLS = [_Pool(len(os.sched_getaffinity(0)))]  # the last one is in use
os.register_at_fork(after_in_child=lambda: [pool.forget() for pool in _POOLS])


def thread_count() -> int:
    """Return how many threads work at the same time."""
    return _POOLS[-1].count


@contextmanager
def threads(count: int) -> Generator[None]:
    """Work on another number of threads than there are cores, within a `with`.

    Args:
        count: number of threads, 1 or more.
    """
    pool = _Pool(count)
    _POOLS.append(pool)
    try:
        yield
    finally:
        _POOLS.remove(pool)
        if pool.executor is not None:
            pool.executor.shutdown()


def started_pool(count: int, name: str = "") -> ThreadPoolExecutor:
    """Return an executor whose threads run already, so that no later work has to start one.

    Args:
        count: number of threads, 1 or more.
        name: what the names of the threads begin with.

    Raises:
        RuntimeError: the system has no place for another thread.
    """
    pool, begun = ThreadPoolExecutor(count, name), threading.Barrier(count + 1)
    try:
        for _ in range(count):  # each waits until all have begun, so that none takes two
            pool.submit(begun.wait)
        begun.wait()
    except BaseException:  # threads that wait on would keep an interrupted process from ending
        begun.abort()
        pool.shutdown(cancel_futures=True)
        raise
    return pool


def share_out(work: Callable[[int, int], None], count: int, least: int) -> None:
    """Call a function on parts of some work, side by side on all cores, until all is done.

    The caller works as well, so that calls from several threads at once, or from one part of
    another call, cannot wait for each other, and so that all is done where no thread can be
    started.

    Args:
        work: called with the first and past the last item of a part.
        count: number of items.
        least: items of a part, at least: less is done sooner than a thread begins.
    """
    pool = _POOLS[-1]
    number = min(count // max(least, 1), _PARTS * pool.count)
    executor = pool.begin() if number > 1 and pool.count > 1 else None
    if executor is None:
        if count:
            work(0, count)
        return
    bounds = [count * k // number for k in range(number + 1)]
    left = iter(list(itertools.pairwise(bounds)))  # next() of a list's iterator is atomic

    def help_out() -> None:
        for first, last in left:
            work(first, last)

    helpers = [executor.submit(help_out) for _ in range(min(pool.count, number) - 1)]
    try:
        help_out()
    finally:
        begun = [helper for helper in helpers if not helper.cancel()]
        wait(begun)
    for helper in begun:
        helper.result()
