# SPDX-License-Identifier: Apache-2.0
"""An executor that knows when its last callback has returned."""

import threading
from collections.abc import Callable

from rclpy.context import Context
from rclpy.executors import (
    ConditionReachedException,
    Executor,
    ExternalShutdownException,
    ShutdownException,
    TimeoutException,
    TimeoutObject,
)
from rclpy.task import Future, Task

from fiber_core.threads import started_pool

__all__ = ["ThreadExecutor"]

# rclpy wakes the loop at a signal just before it shuts the context down: a loop that is quicker
# finds the context well, and waits again
_LOOK_S = 0.5


class ThreadExecutor(Executor):
    """Runs callbacks in threads of its own, and shuts down only after the last has returned.

    A node must not be destroyed while one of its callbacks is at work. rclpy's own
    MultiThreadedExecutor does not tell when that is: its shutdown returns at once. An exception
    that escapes a callback ends the loop, which raises it. All threads begin with the executor: a
    stop is served also where the system has no place for another thread.

    Args:
        threads: number of threads; the loop has one more, that of its caller.
        context: context of the nodes; by default the global one.
    """

    def __init__(self, threads: int, context: Context | None = None):
        super().__init__(context=context)
        self._threads = started_pool(threads)
        self._free = threading.Semaphore(threads)  # threads without a callback
        self._stopping = threading.Event()
        self._errors: list[BaseException] = []

    def spin(self) -> None:
        """Run callbacks until `stop`, until the context is shut down, or until one fails.

        Raises:
            BaseException: what escaped a callback.
        """
        while self.context.ok() and not self._stopping.is_set():
            self.spin_once(_LOOK_S)
        if self._errors:
            raise self._errors[0]

    def stop(self) -> None:
        """End the loop; may be called from any thread, and more than once."""
        self._stopping.set()
        self.wake()
        self._free.release()  # the loop may wait for a thread

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Wait until all callbacks have returned, then give up the nodes.

        The loop must have ended. Callbacks are waited for however long they take.

        Args:
            timeout_sec: as in rclpy; of no effect on callbacks.
        """
        self._threads.shutdown()
        return super().shutdown(timeout_sec)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait for one callback and hand it to a thread; do nothing after the time-out [s]."""
        self._hand_over(timeout_sec, self._stopping.is_set)

    def spin_once_until_future_complete(
        self, future: Future, timeout_sec: float | TimeoutObject | None = None
    ) -> None:
        """As spin_once, and return when a future is done."""
        future.add_done_callback(lambda _: self.wake())
        self._hand_over(timeout_sec, future.done)

    def _hand_over(
        self, timeout_sec: float | TimeoutObject | None, condition: Callable[[], bool]
    ) -> None:
        self._free.acquire()
        if self._stopping.is_set():
            return
        try:
            callback, _, _ = self.wait_for_ready_callbacks(timeout_sec, None, condition)
        except (
            ConditionReachedException,
            ExternalShutdownException,
            ShutdownException,
            TimeoutException,
        ):
            self._free.release()
        else:
            self._threads.submit(self._run, callback)

    def _run(self, callback: Task) -> None:
        try:
            callback()
            error = callback.exception() if callback.done() else None
        except BaseException as escaped:  # a Task keeps only an Exception
            error = escaped
        self._free.release()
        if error is not None:
            self._errors.append(error)
            self.stop()
