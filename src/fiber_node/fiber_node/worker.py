# SPDX-License-Identifier: Apache-2.0
"""Long work of a node, in a thread of its own: callbacks return at once and the node answers."""

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from builtin_interfaces.msg import Time
from rclpy.node import Node

from fiber_core.errors import FiberError
from fiber_msgs_py import Attempt, PlanStamp, guarded, topics
from fiber_msgs_py.stamps import ns_from_time
from fiber_node.reporter import Reporter

__all__ = ["WorkCancelled", "Worker"]


class WorkCancelled(BaseException):
    """The work on a plan was cancelled; no `except Exception` of a core may hold it up."""


@dataclass(eq=False)
class _Job:
    attempt: Attempt
    work: Callable[[], None]
    cancelled: bool = False


class Worker:
    """Does one piece of work after another, in the order in which they were submitted.

    Compiled loops that run long release the interpreter lock, so that callbacks run meanwhile.
    Work calls `check` from time to time and before it publishes anything.

    Args:
        node: the node, for the report of an exception that escapes the work.
        name: name of the work, for that report.
    """

    def __init__(self, node: Node, name: str):
        self._node, self._name = node, name
        self._waiting: deque[_Job] = deque()
        self._current: _Job | None = None
        self._closing = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def submit(self, attempt: Attempt, work: Callable[[], None]) -> None:
        """Do work on an attempt after all work that was submitted before."""
        with self._changed:
            self._waiting.append(_Job(attempt, work))
            self._changed.notify_all()

    def cancel(self, until: PlanStamp | None = None) -> list[Attempt]:
        """Cancel all work that waits or is under way.

        Args:
            until: cancel only work on attempts with stamps up to this one.

        Returns:
            The attempts whose work was cancelled.
        """
        with self._changed:
            jobs = [job for job in (self._current, *self._waiting) if job is not None]
            jobs = [
                job
                for job in jobs
                if (until is None or job.attempt.stamp <= until) and not job.cancelled
            ]
            for job in jobs:
                job.cancelled = True
            return [job.attempt for job in jobs]

    def follow_stop(
        self, report: Reporter, is_done: Callable[[Attempt], bool] = lambda _: False
    ) -> None:
        """Cancel the work whenever the bridge is told to stop, and report each plan it ends.

        Args:
            report: the reporter of the node.
            is_done: tells whether the result of an attempt is out already, and only other work on
                it is under way.
        """

        def on_stopped(message: Time) -> None:
            try:
                stamp = PlanStamp(ns_from_time(message))
            except FiberError as error:
                report.refuse(f"stopped refused: {error}", "stopped")
                return
            for attempt in self.cancel(stamp):
                if not is_done(attempt):
                    report.drop(f"plan {attempt}: {self._name} ended by the service stop")

        topics.STOPPED.subscription(self._node, on_stopped)

    def check(self) -> None:
        """End the work that calls this if it was cancelled, or a signal ends the process.

        Raises:
            WorkCancelled: it was cancelled.
        """
        current, ending = self._current, self._closing or not self._node.context.ok()
        if ending or (current is not None and current.cancelled):
            raise WorkCancelled

    def close(self, timeout_s: float) -> bool:
        """Cancel all work; return whether it has ended within a time [s]."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closing)
                if self._closing:
                    return
                job = self._current = self._waiting.popleft()
            logger = self._node.get_logger()
            try:
                if not job.cancelled:
                    logger.debug(f"plan {job.attempt}: {self._name} begins")
                    guarded(self._node, self._name, partial(self._do, job.work))()
                    logger.debug(f"plan {job.attempt}: {self._name} has ended")
            except WorkCancelled:
                logger.debug(f"plan {job.attempt}: {self._name} was cancelled")
            finally:
                self._current = None

    def _do(self, work: Callable[[], None]) -> None:
        try:
            work()
        except Exception:
            if self._node.context.ok():
                raise
            raise WorkCancelled from None  # after a signal whatever is sent fails
