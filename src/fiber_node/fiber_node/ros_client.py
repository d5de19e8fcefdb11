"""A party to a graph that does one thing after another: a client, or a test."""

import time
from collections.abc import Callable

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

from fiber_core.errors import FiberError
from fiber_msgs_py import Topic

__all__ = ["RosClient", "WaitError"]

_SLICE_S = 0.05  # how long a wait listens before it asks condition and guard again


class WaitError(FiberError):
    """What was waited for did not come.

    Args:
        what: what was missing.
        timeout_s: how long it was waited for [s].
    """

    def __init__(self, what: str, timeout_s: float):
        super().__init__(f"{what} did not come within {timeout_s:g} s")
        self.what, self.timeout_s = what, timeout_s


class RosClient:
    """A node that listens while its owner waits, and only then.

    It has a context of its own, so that one process can hold peers in several domains.

    Args:
        name: of its node.
        domain: ROS domain; by default that of the environment.
        guard: called over and over while waiting; ends a wait by raising.
        clock: seconds, for time-outs.
    """

    def __init__(
        self,
        name: str,
        domain: int | None = None,
        guard: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = time.monotonic,
    ):
        self._guard, self._clock = guard, clock
        self._context = Context()
        rclpy.init(args=[], context=self._context, domain_id=domain)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._nodes: list[Node] = []
        self.node = self.host(lambda **options: Node(name, enable_rosout=False, **options))

    def __enter__(self) -> "RosClient":
        return self

    def __exit__(self, *_):
        self.close()

    def host(self, make_node: Callable[..., Node], **parameters) -> Node:
        """Run another node beside its own, while it waits.

        Args:
            make_node: called with `context` and `parameter_overrides`.
            parameters: parameters of the node; a double underscore stands for a dot.
        """
        overrides = [
            Parameter(name.replace("__", "."), value=value) for name, value in parameters.items()
        ]
        node = make_node(context=self._context, parameter_overrides=overrides)
        self._nodes.append(node)
        self._executor.add_node(node)
        return node

    def hear(self, topic: Topic) -> list:
        """Return a list to which every message of a topic is added from now on."""
        heard = []
        topic.subscription(self.node, heard.append)
        return heard

    def until(
        self,
        condition: Callable[[], object],
        timeout_s: float,
        what: str | Callable[[], str] = "what was waited for",
    ) -> None:
        """Listen until a condition holds.

        Args:
            condition: asked after everything that is heard.
            timeout_s: how long at most [s].
            what: what is waited for, for the error.

        Raises:
            WaitError: the time is up.
        """
        deadline = self._clock() + timeout_s
        while not condition():
            self._guard()
            left = deadline - self._clock()
            if left <= 0:
                raise WaitError(what if isinstance(what, str) else what(), timeout_s)
            self._executor.spin_once(timeout_sec=min(left, _SLICE_S))

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        for node in self._nodes:
            node.destroy_node()
        self._context.try_shutdown()
