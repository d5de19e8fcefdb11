# SPDX-License-Identifier: Apache-2.0
"""Other participants of the graph of a kill campaign: strangers, and clients that call services."""

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fiber_msgs_py import Topic, topics
from fiber_node import RosClient, WaitError

__all__ = ["OTHERS", "SERVICES", "Others"]

OTHERS = 4  # clients that call services at the same time
SERVICES = (topics.START, topics.STOP, topics.CLEAR, topics.HOME, topics.CONFIGURE)


class Others:
    """Nodes that know nothing of the plan under way.

    Args:
        wait_s: longest wait for the answer of a service [s].
    """

    def __init__(self, wait_s: float):
        self._wait_s = wait_s
        self._clients = [RosClient(f"other_{k}") for k in range(OTHERS)]
        self._strangers: list[tuple[Any, list[Any]]] = []

    def close(self) -> None:
        """Leave the graph."""
        for client in self._clients:
            client.close()

    def attack(self) -> None:
        """Publish malformed and foreign messages on every topic."""
        if not self._strangers:
            path = Path(__file__).parents[1] / "test" / "test_graph_killers.py"
            spec = importlib.util.spec_from_file_location("killers", path)
            assert spec is not None and spec.loader is not None
            module = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
            node = self._clients[0].node
            every = [topic for topic in vars(topics).values() if isinstance(topic, Topic)]
            self._strangers = [(topic.publisher(node), module.killers(topic)) for topic in every]
        for publisher, messages in self._strangers:
            for message in messages:
                publisher.publish(message)

    def call(self, services: Sequence[int]) -> None:
        """Call a service from each client at the same time.

        Args:
            services: place in `SERVICES` of the service of each client.
        """
        calls = []
        for other, at in zip(self._clients, services):
            client = SERVICES[at].client(other.node)
            calls.append((other, client, client.call_async(SERVICES[at].type.Request())))
        for other, client, future in calls:
            try:
                other.wait_for(future.done, self._wait_s)
            except WaitError:
                pass  # its plan has an end all the same, or the run counts it
            other.node.destroy_client(client)
