# SPDX-License-Identifier: Apache-2.0
"""Turns made by the bridge: so small that nothing can touch, or certified, to stops."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_client.client import PlaneClient
from fiber_core.outcomes import PlanOutcome
from fiber_msgs_py import PlanStamp, topics, turns

__all__ = ["Turning"]


class Turning:
    """Sends `turns`, calls `turn`, and waits for the end of the motion.

    Args:
        client: a client of the graph.
        timeout_s: time-out of each wait [s].
    """

    def __init__(self, client: PlaneClient, timeout_s: float):
        self._client, self._timeout_s = client, timeout_s
        self._publisher = topics.TURNS.publisher(client.node)
        self._last_ns = -1

    def turn_unplaced(self) -> PlanOutcome:
        """Turn theta of all robots at unknown places; see `turn_words`."""
        return self.turn_words(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))

    def turn_to_stops(self, ids: ArrayLike, way: ArrayLike) -> PlanOutcome:
        """Turn theta of robots that a camera has seen without their turn; see `turn_words`.

        Args:
            ids: ids of the robots, shape (k,), at least one.
            way: -1 for the lower stop, 1 for the upper one, shape (k,).
        """
        return self.turn_words(ids, np.asarray(way) * turns.TO_UPPER_STOP)

    def turn_words(self, ids: ArrayLike, way: ArrayLike) -> PlanOutcome:
        """Turn phi of robots up, down or back to where it rested.

        Args:
            ids: ids of the robots, shape (k,).
            way: 1 up, -1 down, 0 back, shape (k,), as `turns` has it.

        Returns:
            The outcome, whose stamp is that of the turns.

        Raises:
            PlaneRefusal: the bridge refuses the turns, or has not heard these; gives the reason.
            NodeLost, WaitError: as in the calls of the client. Robots that may move are stopped.
        """
        client, timeout_s = self._client, self._timeout_s
        client.wait_for(
            lambda: self._publisher.get_subscription_count() > 0, timeout_s,
            "a bridge that hears turns",
        )  # fmt: skip
        # a simulated clock may rest: two turns still need two stamps
        self._last_ns = max(client.now_ns(), self._last_ns + 1)
        stamp = PlanStamp(self._last_ns)
        self._publisher.publish(turns.encode(ids, way, stamp, client.session))
        client.wait_for(lambda: self._is_heard(stamp), timeout_s, f"answer to turns {stamp}")
        with client.stops_on_error(timeout_s):
            client.call_service(topics.TURN, timeout_s)
            return client.wait_for_outcome(stamp, timeout_s)

    def _is_heard(self, stamp: PlanStamp) -> bool:
        for refusal in self._client.refusals.get(stamp, []):
            raise refusal
        return "bridge" in self._client.times.get(stamp, {})
