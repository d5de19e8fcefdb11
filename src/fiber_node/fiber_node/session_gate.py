# SPDX-License-Identifier: Apache-2.0
"""A gate for messages: those of a session that is open in this graph pass, others are refused."""

import time
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.subscription import Subscription

from fiber_msgs_py import Topic, guarded, session_of, topics
from fiber_node.claims import BRIDGE, claims

__all__ = ["SessionGate"]

_CHECK_PERIOD_S = 0.05
_UNKNOWN_S = 2.0  # a bridge whose messages have come is in the graph by then
_MOST_KEPT = 100  # messages; with more the first is refused


class _Kept(NamedTuple):
    # a message whose bridge is not seen yet
    until_s: float
    topic: str
    session: str
    message: Any
    callback: Callable[[Any], None]


class SessionGate:
    """Subscribes to topics of the graph and passes on what belongs to an open session.

    A message can come before its bridge is seen in the graph: it is kept until then. Messages of no
    session, or of one whose bridge is not there, such as those of a bag or of a bridge that has
    ended, are refused.

    Args:
        node: the node that receives.
        refuse: called with the name of the topic, the reason and the message.
        group: callback group of the subscriptions; the default one of the node without one.
    """

    def __init__(
        self,
        node: Node,
        refuse: Callable[[str, str, Any], None],
        group: CallbackGroup | None = None,
    ):
        self._node, self._refuse, self._group = node, refuse, group
        self._open: set[str] = set()  # sessions seen in the graph; closed ones are found by is_open
        self._layout: Any = None  # the last one that passed
        self._kept: deque[_Kept] = deque()  # in the order of arrival
        self._timer = node.create_timer(
            _CHECK_PERIOD_S,
            guarded(node, "sessions", self._check_kept),
            callback_group=group,
            clock=Clock(clock_type=ClockType.STEADY_TIME),
            autostart=False,
        )

    def subscription(self, topic: Topic, callback: Callable[[Any], None]) -> Subscription:
        """Return a subscription that calls with the messages of open sessions."""
        return topic.subscription(
            self._node,
            lambda message: self._on_message(topic.name, message, callback),
            callback_group=self._group,
        )

    def is_open(self, session: str) -> bool:
        """Return whether the bridge of a session is in the graph."""
        return session in claims(self._node, BRIDGE)

    def _on_message(self, topic: str, message: Any, callback: Callable[[Any], None]) -> None:
        name, session = topic.rpartition("/")[2], session_of(message)
        if session is None:
            self._refuse(name, f"{name} refused: it belongs to no session", message)
        elif self.is_open(session):
            if self._kept:
                self._check_kept()  # those that came before go first
            self._pass(topic, message, callback)
        else:
            self._node.get_logger().debug(f"{name} waits until its bridge, of {session}, is seen")
            until_s = time.monotonic() + _UNKNOWN_S
            self._kept.append(_Kept(until_s, topic, session, message, callback))
            if len(self._kept) > _MOST_KEPT:
                self._refuse_kept(
                    self._kept.popleft(),
                    f"is not seen yet, and {_MOST_KEPT} later messages wait too",
                )
            self._timer.reset()

    def _pass(self, topic: str, message: Any, callback: Callable[[Any], None]) -> None:
        if topic == topics.LAYOUT.name:
            # the bridge repeats its layout at rest, for subscribers that came after it
            is_new, self._layout = message != self._layout, message
            if not is_new:
                return
        callback(message)

    def _check_kept(self) -> None:
        for _ in range(len(self._kept)):
            kept = self._kept.popleft()
            if self.is_open(kept.session):
                self._pass(kept.topic, kept.message, kept.callback)
            elif time.monotonic() > kept.until_s:
                self._refuse_kept(kept, "is not in the graph")
            else:
                self._kept.append(kept)
        if not self._kept:
            self._timer.cancel()

    def _refuse_kept(self, kept: _Kept, why: str) -> None:
        name = kept.topic.rpartition("/")[2]
        self._refuse(name, f"{name} refused: its bridge, of {kept.session}, {why}", kept.message)
