# SPDX-License-Identifier: Apache-2.0
"""The connections of a coordinator with its sectors, by topics."""

import array
import threading
from collections.abc import Callable
from dataclasses import replace

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import UInt8MultiArray

from fiber_msgs_py import topics
from fiber_msgs_py.topics import Topic
from fiber_sectors.inbox import Inbox
from fiber_sectors.node.settings import namespace_of

__all__ = ["TopicLinks", "as_message"]


def as_message(data: bytes) -> UInt8MultiArray:
    """Return bytes as a message."""
    return UInt8MultiArray(data=array.array("B", data))


def _of(topic: Topic, sector: int) -> Topic:
    return replace(topic, name=f"{namespace_of(sector)}/{topic.name}")


class TopicLinks:
    """Topics to and from each sector, heard by a node and a thread of their own.

    The thread of the coordinator waits for answers, also before its own node spins.

    Args:
        node: the node of the coordinator, whose namespace and context are used.
        sectors: number of sectors.
    """

    def __init__(self, node: Node, sectors: int):
        self._node = Node(
            f"{node.get_name()}_links",
            namespace=node.get_namespace(),
            context=node.context,
            start_parameter_services=False,
            enable_rosout=False,
            use_global_arguments=False,
        )
        self._came = Inbox()
        self._to = [_of(topics.TO_SECTOR, k).publisher(self._node) for k in range(sectors)]
        for k in range(sectors):
            _of(topics.FROM_SECTOR, k).subscription(self._node, self._hear)
        self._seen = [False] * sectors
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin, name="sector links", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except (ExternalShutdownException, RuntimeError):
            # a wait that begins in the instant of the shutdown fails with an error of its own
            if self._node.context.ok():
                raise

    def _hear(self, message: UInt8MultiArray) -> None:
        self._came.put(bytes(message.data))

    def send(self, sector: int, data: bytes) -> None:
        """Send bytes to one sector."""
        self._to[sector].publish(as_message(data))

    def receive(self, wait_s: float) -> list[bytes]:
        """Return what has come from any sector, or wait for it [s]."""
        return self._came.take(wait_s)

    def left(self, sector: int) -> bool:
        """Return whether a sector was in the graph, and is not any more."""
        there = self._to[sector].get_subscription_count() > 0
        self._seen[sector] = self._seen[sector] or there
        return self._seen[sector] and not there

    def wait(self, pause: Callable[[float], None], polls: int) -> list[int]:
        """Wait until all sectors are in the graph; return those that are not.

        Args:
            pause: waits for a number of seconds.
            polls: largest number of looks, twenty a second.
        """
        missing = list(range(len(self._to)))
        for _ in range(polls):
            missing = [k for k in missing if self._to[k].get_subscription_count() == 0]
            if not missing:
                break
            pause(0.05)
        return missing

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._thread.join(5.0)
        self._node.destroy_node()
