# SPDX-License-Identifier: Apache-2.0
"""Claims: which node of a graph has a role of which there can be one, such as planner.

A claim is a subscription of a topic that carries nothing, named by role and id. Every node sees it
in the graph, and no player of a bag makes one. Beside it is a publisher whose liveliness tells that
the node lives. Ids sort by the time of their making: of two nodes with one role the later stays
out.
"""

import os
import re

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from std_msgs.msg import Empty

from fiber_msgs_py import guarded, new_session, topics
from fiber_node.signs_of_life import SignsOfLife, publish_life

__all__ = ["BRIDGE", "DISCRETIZER", "PLANNER", "Claim", "claims"]

BRIDGE, PLANNER, DISCRETIZER = "bridge", "planner", "discretizer"

_RANDOM_BYTES = 4
_LOOK_S = 0.5  # time between two looks at the claims of others


class Claim:
    """The claim of a node to a role, from its making until it is released or the node goes.

    Args:
        node: the node.
        role: the role.
    """

    def __init__(self, node: Node, role: str):
        self._node, self._role = node, role
        now_ns = max(node.get_clock().now().nanoseconds, 0)
        self.id = new_session(now_ns, os.urandom(_RANDOM_BYTES))
        self._life = publish_life(node, _name(f"{role}_alive", self.id))
        self._subscription = node.create_subscription(
            Empty, _name(role, self.id), lambda _: None, 1
        )
        # the death of an earlier node is known when it is asked for
        self._timer = node.create_timer(
            _LOOK_S,
            guarded(node, "claims", self._look),
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )

    def _look(self) -> None:
        self.others()

    def release(self) -> None:
        """Give up the role; every node sees it."""
        self._node.destroy_timer(self._timer)
        self._node.destroy_subscription(self._subscription)
        self._node.destroy_publisher(self._life)

    def others(self) -> list[str]:
        """Return the other claims to the same role, the earliest first."""
        return [each for each in claims(self._node, self._role) if each != self.id]

    def earlier(self) -> list[str]:
        """Return the claims to the same role that were made before this one."""
        return [each for each in self.others() if each < self.id]


def claims(node: Node, role: str) -> list[str]:
    """Return the ids of all claims of living nodes to a role, the earliest first.

    Args:
        node: sees them in its graph. To notice a death it calls more than once.
        role: the role.
    """
    pattern = re.compile(re.escape(node.resolve_topic_name(_name(role, ""))) + r"(session_\w+)")
    names = (pattern.fullmatch(name) for name, _ in node.get_topic_names_and_types())
    found = [match[1] for match in names if match and node.count_subscribers(match[0])]
    signs = {_name(f"{role}_alive", each): each for each in found}
    return sorted(signs[topic] for topic in SignsOfLife.of(node).alive(role, signs))


def _name(role: str, id: str) -> str:
    # a name that begins with an underscore is hidden from lists of topics
    return f"{topics.NAMESPACE}/_{role}_{id}"
