# SPDX-License-Identifier: Apache-2.0
"""A request to a service that finds the server that takes the place of a dead one."""

import threading
import time
from collections.abc import Callable, Collection
from typing import Any

from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future

__all__ = ["RepeatedRequest"]

_SETTLED_S = 0.1  # after which a server that is in the graph hears requests too
_LOOK_S = 0.05  # between two looks at the graph


class RepeatedRequest:
    """A request that is sent again when a server has come that takes the place of a dead one.

    The middleware delivers a request to the servers that it knows as it is sent, and knows one that
    was killed until its lease ends. Meanwhile its service counts as there, and a request reaches no
    server if the next one is not known yet. While all servers live nothing is sent again: a server
    that lives would do twice what it was asked, and one that stays out would answer in its place.

    Args:
        node: the node that asks.
        client: its client of the service.
        request: the request.
        living: returns the servers that live, such as the claims to a role.
        clock: returns seconds.
    """

    def __init__(
        self,
        node: Node,
        client: Client,
        request: Any,
        living: Callable[[], Collection[object]],
        clock: Callable[[], float] = time.monotonic,
    ):
        self._node, self._client, self._request, self._clock = node, client, request, clock
        self._living, self._servers, self._none = living, self._count(), False
        self._look_s, self._again_s = clock() + _LOOK_S, float("inf")
        self._answered = threading.Event()
        self._futures: list[Future] = []
        self._send()

    def done(self) -> bool:
        """Return whether there is an answer, and send the request again where it is due."""
        if any(future.done() for future in self._futures):
            return True
        now_s = self._clock()
        if now_s >= self._look_s:
            self._look_s = now_s + _LOOK_S
            servers = self._count()
            self._none |= servers == 0
            if servers > self._servers:
                self._again_s = now_s + _SETTLED_S
            self._servers = servers
            if now_s >= self._again_s and (self._none or len(self._living()) < servers):
                self._again_s, self._none = float("inf"), False
                self._send()
        return False

    def wait(self, timeout_s: float) -> bool:
        """Wait in a thread, while another one runs the node; return whether there is an answer."""
        until_s = self._clock() + timeout_s
        while not self.done() and self._clock() < until_s:
            self._answered.wait(_LOOK_S)
        return self.done()

    def result(self) -> Any:
        """Return the first answer; None without one, and where the service failed."""
        answers = (future.result() for future in self._futures if future.done())
        return next((answer for answer in answers if answer is not None), None)

    def _send(self) -> None:
        future = self._client.call_async(self._request)
        future.add_done_callback(lambda _: self._answered.set())
        self._futures.append(future)

    def _count(self) -> int:
        return self._node.count_services(self._client.service_name)
