# SPDX-License-Identifier: Apache-2.0
"""A client of the graph in a thread: carries out requests, and receives messages all the time."""

import math
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from fiber_client.client import PlaneClient
from fiber_client.errors import PlaneError
from fiber_msgs_py import Progress

__all__ = ["ClientWorker", "Interrupted"]

_Result = TypeVar("_Result")


class Interrupted(PlaneError):
    """A request ended because it was interrupted."""


class ClientWorker:
    """A PlaneClient in a thread of its own, for programs with other work.

    A client receives messages only while it waits. This one waits between two requests, so it
    knows of plans of other clients too.

    Args:
        domain: ROS domain of the graph; by default the domain of the environment.
        on_progress: called in this thread with the progress of every stage.
    """

    def __init__(
        self,
        domain: int | None = None,
        on_progress: Callable[[Progress], None] = lambda _: None,
    ):
        self._client = PlaneClient(domain, on_progress, guard=self._guard)
        self._requests: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._lock, self._closing = threading.Lock(), threading.Event()
        self._interrupt: threading.Event | None = None  # of the request under way
        self._interrupted = False
        self._thread = threading.Thread(target=self._run, name="client", daemon=True)
        self._thread.start()

    def call(
        self, request: Callable[[PlaneClient], _Result], interrupt: threading.Event | None = None
    ) -> _Result:
        """Carry out a request in the thread of the client; return its result or raise its error.

        Args:
            request: called with the client.
            interrupt: when it is set, one wait of the request raises Interrupted; the waits
                after that, such as those of a stop, are not interrupted.

        Raises:
            Interrupted: the worker is closed.
        """
        future: Future[_Result] = Future()

        def carry_out() -> None:
            self._interrupt, self._interrupted = interrupt, False
            try:
                future.set_result(request(self._client))
            except BaseException as error:
                future.set_exception(error)
            self._interrupt, self._interrupted = None, False

        with self._lock:
            if self._closing.is_set():
                raise Interrupted("the client is closed")
            self._requests.put(carry_out)
        return future.result()

    def close(self) -> None:
        """Interrupt the request under way, wait for its end, and leave the graph."""
        with self._lock:
            self._closing.set()
        self._thread.join()

    def _guard(self) -> None:
        wanted = self._interrupt is not None and self._interrupt.is_set()
        if (wanted or self._closing.is_set()) and not self._interrupted:
            self._interrupted = True
            raise Interrupted("interrupted")

    def _run(self) -> None:
        with self._client:
            while not self._closing.is_set():
                try:
                    self._client.wait_for(lambda: not self._requests.empty(), math.inf)
                except Interrupted:
                    break
                self._requests.get()()
            while not self._requests.empty():  # they are interrupted in their first wait
                self._requests.get()()
