# SPDX-License-Identifier: Apache-2.0
"""A node that does one thing after another and receives messages in between."""

import os
import signal
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

from fiber_core.errors import FiberError
from fiber_msgs_py import Topic
from fiber_node.signs_of_life import SignsOfLife

__all__ = ["RosClient", "WaitError"]

_SIGNALS = signal.SIGINT, signal.SIGTERM  # SIGINT first
_SLICE_S = 0.05  # longest time without a message after which condition and guard are evaluated


class WaitError(FiberError):
    """A condition that was waited for did not hold in time.

    Args:
        what: what was missing.
        timeout_s: how long the client waited [s].
    """

    def __init__(self, what: str, timeout_s: float):
        super().__init__(f"{what} did not come within {timeout_s:g} s")
        self.what, self.timeout_s = what, timeout_s


def uninterrupted(work: Callable[[], None]) -> None:
    """Do a short piece of work; Ctrl-C, and a signal handled like it, come when it has ended.

    Args:
        work: called once.

    Raises:
        KeyboardInterrupt: a signal came meanwhile; whatever the work raised is lost.
    """
    came: list[int] = []
    held = []
    if threading.current_thread() is threading.main_thread():
        held = [n for n in _SIGNALS if signal.getsignal(n) is signal.default_int_handler]
    try:
        for number in held:
            signal.signal(number, lambda number, _: came.append(number))
        work()
    finally:
        # the last one back is SIGINT, after which one may come at any place
        for number in reversed(held):
            signal.signal(number, signal.default_int_handler)
        if came:
            raise KeyboardInterrupt


class RosClient:
    """A node that receives messages while its owner waits, and only then.

    It has a context of its own, so that one process can hold clients in several domains.

    Args:
        name: name of the node.
        domain: ROS domain; by default the domain of the environment.
        guard: called again and again while the client waits; it ends the wait by raising.
        clock: returns seconds, for time-outs.
        args: command line for ROS, such as ``["--ros-args", "-r", "__ns:=/north"]``; None for that
            of the process.
        namespace: namespace of the node; by default that of the environment variable
            ROS_NAMESPACE.
    """

    def __init__(
        self,
        name: str,
        domain: int | None = None,
        guard: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = time.monotonic,
        args: Sequence[str] | None = (),
        namespace: str | None = None,
    ):
        self._guard, self._clock = guard, clock
        self._context = Context()
        rclpy.init(
            args=None if args is None else list(args), context=self._context, domain_id=domain
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._nodes: list[Node] = []
        place = os.environ.get("ROS_NAMESPACE", "") if namespace is None else namespace
        self.node = self.add_node(
            lambda **options: Node(name, namespace=place, enable_rosout=False, **options)
        )

    def __enter__(self) -> "RosClient":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add_node(self, make_node: Callable[..., Node], **parameters: Any) -> Node:
        """Run another node in the same process; it works while the client waits.

        Args:
            make_node: called with `context` and `parameter_overrides`.
            parameters: parameters of the node; a double underscore in a name stands for a dot.
        """
        overrides = [
            Parameter(name.replace("__", "."), value=value) for name, value in parameters.items()
        ]
        node = make_node(context=self._context, parameter_overrides=overrides)
        self._nodes.append(node)
        self._executor.add_node(node)
        return node

    def remove_node(self, node: Node) -> None:
        """End another node of the process."""
        self._nodes.remove(node)
        self._executor.remove_node(node)
        node.destroy_node()

    def collect(self, topic: Topic) -> list[Any]:
        """Subscribe to a topic; return a list that grows by every message received."""
        received: list[Any] = []
        topic.subscription(self.node, received.append)
        return received

    def wait_for(
        self,
        condition: Callable[[], object],
        timeout_s: float,
        what: str | Callable[[], str] = "what was waited for",
    ) -> None:
        """Receive messages until a condition holds.

        Args:
            condition: evaluated after every message.
            timeout_s: time-out [s].
            what: names what is waited for, in the error.

        Raises:
            WaitError: the condition did not hold in time.
        """
        deadline = self._clock() + timeout_s
        while not condition():
            self._guard()
            left = deadline - self._clock()
            if left <= 0:
                raise WaitError(what if isinstance(what, str) else what(), timeout_s)
            self._spin_once(min(left, _SLICE_S))

    def wait_quietly(self, quiet_s: float, count: Callable[[], int]) -> None:
        """Receive messages until their number has not changed for a while.

        Args:
            quiet_s: the while [s].
            count: returns the number of messages.
        """
        before, since_s = count(), self._clock()
        while self._clock() < since_s + quiet_s:
            self._guard()
            self._spin_once(_SLICE_S)
            if count() != before:
                before, since_s = count(), self._clock()

    def _spin_once(self, timeout_s: float) -> None:
        # an interrupt inside the executor can leave a callback group busy for ever, and the client
        # would never hear the answer to its stop
        uninterrupted(lambda: self._executor.spin_once(timeout_sec=timeout_s))

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        for node in self._nodes:
            SignsOfLife.of(node).end()
            node.destroy_node()
        self._context.try_shutdown()
