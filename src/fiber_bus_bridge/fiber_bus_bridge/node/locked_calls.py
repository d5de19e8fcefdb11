# SPDX-License-Identifier: Apache-2.0
"""Callbacks of the bridge that hold its lock, and its services."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeAlias

from std_srvs.srv import Trigger

from fiber_bus_bridge.errors import SessionError
from fiber_core.errors import FiberError
from fiber_node import ManagedNode

__all__ = ["LockedCalls"]

_ANSWER_S = 0.25  # longest wait of a change of parameters for other work of the bridge
_Response: TypeAlias = Trigger.Response


class LockedCalls:
    """Makes callbacks of calls, one of which is at work at a time, while the bridge is configured.

    A callback may have waited for the lock while the bridge was cleaned up; it does nothing then.

    Args:
        node: the node of the bridge.
        lock: held while the session is used.
    """

    def __init__(self, node: ManagedNode, lock: threading.Lock):
        self._node, self._lock = node, lock
        self.open = False  # whether the bridge is configured; changed by a holder of the lock

    def locked(self, call: Callable[..., None]) -> Callable[..., None]:
        """Return the callback of a topic or of a timer."""

        def run(*arguments: Any) -> None:
            with self._lock:
                if self.open:
                    call(*arguments)

        return run

    @contextmanager
    def soon(self, change: str) -> Iterator[None]:
        """Hold the lock in a call that must be answered at once, also while unconfigured.

        Args:
            change: what the call does with robots, for the refusal.

        Raises:
            SessionError: another call is at work, such as a plan or the transition configure.
        """
        if not self._lock.acquire(timeout=_ANSWER_S):
            doing = "a plan is under way" if self.open else "the bridge is configured"
            raise SessionError(f"robots cannot be {change} while {doing}")
        try:
            yield
        finally:
            self._lock.release()

    def serving(self, name: str, call: Callable[[], str]) -> Callable[[Any, _Response], _Response]:
        """Return the callback of a Trigger service; a refusal of the core becomes the response.

        Args:
            name: name of the service.
            call: does what the service is for; returns its effect, for people.
        """
        name = name.rpartition("/")[2]

        def serve(_: Any, response: _Response) -> _Response:
            try:
                with self._lock:
                    if not self.open:
                        raise SessionError("the bridge is not configured any more")
                    response.message = call()
                response.success = True
                self._node.get_logger().info(f"service {name}: {response.message}")
            except FiberError as error:
                response.success, response.message = False, str(error)
                self._node.reporter.refuse(f"service {name} refused: {error}")
            return response

        return serve
