# SPDX-License-Identifier: Apache-2.0
"""Signs of life: whether the node that makes a claim is alive, asked of the middleware.

The graph alone is no judge of that. A participant that is silent for its lease is deleted from the
graph, and one that was only paused may not be found again for minutes: Fast DDS 2.14 numbers the
requests of a reader, a participant that has found another one again numbers its requests from one,
and its peer, which was paused and has deleted nothing, takes them for old ones. So the lease is
longer than pauses that happen, and the liveliness of a publisher tells within two seconds that its
node is dead.

Fast DDS keeps one state for all readers of a process that watch a publisher with the same lease,
and tells them only of its changes. A reader that is made later hears of none, and neither does one
whose publisher comes to life between the match and the end of its making. So each subscription has
a lease of its own, and one that has heard nothing is soon joined by another.
"""

import itertools
import threading
import time
from collections import deque
from collections.abc import Callable, Collection

from rclpy.duration import Duration
from rclpy.event_handler import QoSSubscriptionEventType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.type_support import check_is_valid_msg_type
from std_msgs.msg import Empty

__all__ = ["LIFE_QOS", "SignsOfLife", "publish_life"]

_LEASE_S = 0.9  # the middleware of a living process tells of it each two thirds of this time
_PATIENCE_S = 0.7  # without a sign until a node is dead: the observer may have been paused itself
_FIRST_S = 2.0  # until the first sign
_AGAIN_S, _SUBSCRIPTIONS = 0.7, 3  # time between two of a sign that never came, and their number
_STEP_NS, _STEPS = 1_000_000, 50  # between the leases of two subscriptions of this process
# A subscription is not destroyed while the middleware deletes the participant that it was matched
# with: both can wait for each other for ever, with the interpreter's lock (Fast DDS issue 6502).
_KEPT_S = 2.0

_OWN: set[str] = set()  # topics of this process, of which the middleware gives no sign to itself
_KEPT, _MAKING = "_signs_of_life", threading.Lock()


def _life_qos(lease: Duration) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=1,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.VOLATILE,
        liveliness=LivelinessPolicy.AUTOMATIC,
        liveliness_lease_duration=lease,
    )


LIFE_QOS = _life_qos(Duration(seconds=_LEASE_S))


def publish_life(node: Node, topic: str) -> Publisher:
    """Return a publisher of a topic that carries nothing; its liveliness is a sign of life."""
    _OWN.add(topic)
    return node.create_publisher(Empty, topic, LIFE_QOS)


_LEASES = itertools.cycle(
    Duration(seconds=_LEASE_S, nanoseconds=step * _STEP_NS) for step in range(_STEPS)
)


class _LifeSubscription:
    # It is in no wait set: where liveliness has changed it would wake the executor at once, again
    # and again, until the change is taken.

    def __init__(self, node: Node, topic: str):
        check_is_valid_msg_type(Empty)  # loads what the middleware knows of the type
        with node.handle:
            self._subscription = rclpy_implementation.Subscription(
                node.handle, Empty, topic, _life_qos(next(_LEASES)).get_c_qos_profile()
            )
        with self._subscription:
            self._event = rclpy_implementation.EventHandle(
                self._subscription,
                QoSSubscriptionEventType.RCL_SUBSCRIPTION_LIVELINESS_CHANGED,
            )

    def hears(self) -> bool:
        with self._event:
            status = self._event.take_event()  # the present counts, whatever has changed
        return status is not None and status.alive_count > 0

    def end(self) -> None:
        self._event.destroy_when_not_in_use()
        self._subscription.destroy_when_not_in_use()


class _Sign:
    # Of one publisher, as one node sees it.

    def __init__(self, node: Node, topic: str, clock: Callable[[], float]):
        self._node, self._topic, self._clock = node, topic, clock
        self._subscriptions: list[_LifeSubscription] = []
        self._dead_from_s = clock() + _FIRST_S
        self._present, self._ever = True, False
        self._subscribe()

    def _subscribe(self) -> None:
        self._again_s = self._clock() + _AGAIN_S
        self._subscriptions.append(_LifeSubscription(self._node, self._topic))

    def is_alive(self) -> bool:
        now_s, before = self._clock(), self._present
        self._present = any([each.hears() for each in self._subscriptions])
        self._ever |= self._present
        if self._present:
            self._dead_from_s = now_s
        elif before and self._dead_from_s <= now_s:
            self._dead_from_s = now_s + _PATIENCE_S
        can_ask = not self._ever and len(self._subscriptions) < _SUBSCRIPTIONS
        if can_ask and now_s >= self._again_s:
            self._subscribe()
        return self._present or now_s < self._dead_from_s

    def end(self) -> None:
        for each in self._subscriptions:
            each.end()


class SignsOfLife:
    """The signs of life that a node sees, of publishers that `publish_life` made.

    A publisher is alive until it has given no sign for 0.7 s since this was first seen, which
    the middleware tells 0.9 s after the last sign. One that is new counts as alive for 2 s.

    Args:
        node: the node.
        clock: returns seconds.
    """

    def __init__(self, node: Node, clock: Callable[[], float] = time.monotonic):
        self._node, self._clock = node, clock
        self._signs: dict[str, dict[str, _Sign]] = {}
        self._gone: deque[tuple[float, _Sign]] = deque()  # with the time at which each is destroyed
        self._lock = threading.Lock()

    @classmethod
    def of(cls, node: Node) -> "SignsOfLife":
        """Return the signs that a node sees."""
        with _MAKING:
            kept = vars(node)  # in no other table: that would keep the node
            if _KEPT not in kept:
                kept[_KEPT] = cls(node)
            return kept[_KEPT]

    def alive(self, kind: str, topics: Collection[str]) -> set[str]:
        """Return the topics of one kind whose publishers are alive.

        Args:
            kind: of the publishers, such as the role of their nodes.
            topics: all topics of this kind that are in the graph; of others nothing is kept.
        """
        with self._lock:
            signs, now_s = self._signs.setdefault(kind, {}), self._clock()
            for gone in signs.keys() - set(topics):
                self._gone.append((now_s + _KEPT_S, signs.pop(gone)))
            while self._gone and self._gone[0][0] <= now_s:
                self._gone.popleft()[1].end()
            return {topic for topic in topics if self._is_alive(signs, topic)}

    def _is_alive(self, signs: dict[str, _Sign], topic: str) -> bool:
        if topic in _OWN:
            return True
        try:
            if topic not in signs:
                signs[topic] = _Sign(self._node, topic, self._clock)
            return signs[topic].is_alive()
        except rclpy_implementation.InvalidHandle:  # the node was cleaned up meanwhile
            if topic in signs:
                signs.pop(topic).end()
            return True

    def end(self) -> None:
        """Look for no sign any more: the node is about to be destroyed."""
        with self._lock:
            left = [sign for signs in self._signs.values() for sign in signs.values()]
            left += [sign for _, sign in self._gone]
            self._signs.clear()
            self._gone.clear()
            for sign in left:
                sign.end()
