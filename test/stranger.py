# SPDX-License-Identifier: Apache-2.0
"""A plain rclpy program, which knows names and types and nothing else of this project."""

import time
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

__all__ = ["Stranger"]

WAIT_S = 120.0


class Stranger:
    """A node in a context of its own, which receives while it waits.

    Args:
        domain: its ROS domain.
        wait_s: longest wait for anything [s].
    """

    def __init__(self, domain: int, wait_s: float = WAIT_S):
        self.context, self.wait_s = Context(), wait_s
        rclpy.init(args=[], context=self.context, domain_id=domain)
        self.node = rclpy.create_node("stranger", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def __enter__(self) -> "Stranger":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def collect(self, kind: type, topic: str, qos: Any = 10) -> list[Any]:
        """A list of the messages of a topic, which grows."""
        received: list[Any] = []
        self.node.create_subscription(kind, topic, received.append, qos)
        return received

    def wait_for(self, condition: Any, timeout_s: float | None = None) -> None:
        end = time.monotonic() + (self.wait_s if timeout_s is None else timeout_s)
        while not condition():
            assert time.monotonic() < end, "it did not happen in time"
            self.executor.spin_once(timeout_sec=0.02)

    def result_of(self, future: Any) -> Any:
        self.wait_for(future.done)
        return future.result()

    def call(self, kind: type, name: str, **fields: Any) -> Any:
        """The answer of a service."""
        client = self.node.create_client(kind, name)
        self.wait_for(client.service_is_ready)
        answer = self.result_of(client.call_async(kind.Request(**fields)))
        self.node.destroy_client(client)
        return answer

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()
