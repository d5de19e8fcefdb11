# SPDX-License-Identifier: Apache-2.0
"""Turns to stops, until each robot that a camera has seen stands where one turn of theta can be."""

from collections.abc import Callable

import numpy as np

from fiber_client.client import PlaneClient
from fiber_client.errors import PlaneRefusal
from fiber_client.turning import Turning
from fiber_core.array_types import Ids, Ints, Mask
from fiber_core.outcomes import Outcome, Reason
from fiber_core.turns_of_theta import turns_in_range
from fiber_msgs_py import layout

__all__ = ["StopSearch"]

_DOWN, _UP = -1, 1
_WORDS = {_DOWN: "lower stop", _UP: "upper stop"}


class StopSearch:
    """Turns robots of which another turn of theta is in range to one stop, then to the other.

    A robot that a stop does not hold is seen after it where one angle alone is in its range. The
    bridge lets robots turn that are not neighbours, so a search takes several motions.

    Args:
        client: a client of the graph.
        turning: calls the bridge.
        timeout_s: time-out of each wait [s].
        find: called with the robots that have turned, shape (n,): finds them with a camera.
        say: called with a line for each motion.
    """

    def __init__(
        self,
        client: PlaneClient,
        turning: Turning,
        timeout_s: float,
        find: Callable[[Mask], None],
        say: Callable[[str], None],
    ):
        self._client, self._turning, self._timeout_s = client, turning, timeout_s
        self._find, self._say = find, say
        self._tried: dict[tuple[int, int], str] = {}  # what came of it, by robot and way
        self.motions = 0

    def run(self) -> None:
        """Turn robots until the turn of each is known, or both ways of it have been tried.

        Raises:
            NodeLost, WaitError: as in the calls of the client.
        """
        while True:
            ids, way = self._next()
            if len(ids) == 0:
                return
            tried = len(self._tried)
            try:
                self._turn(ids, way)
            except PlaneRefusal as refusal:
                self._say(str(refusal))
                return
            if len(self._tried) == tried:
                return

    def notes(self, ids: Ids) -> list[str]:
        """Return what was tried with each of some robots."""
        return [
            ", ".join(
                f"{word}: {self._tried[robot, way]}"
                for way, word in _WORDS.items()
                if (robot, way) in self._tried
            )
            or "not tried: beside a robot at an unknown place, too near to a neighbour, or with "
            "a theta that is not known well enough"
            for robot in ids.tolist()
        ]

    def _next(self) -> tuple[Ids, Ints]:
        """Robots with a way that was not tried, and this way: first to the stop that is nearer."""
        client = self._client
        plane, rows = client.plane, np.flatnonzero(client.unplaced == layout.SEEN)
        theta_range, theta_rad = plane.limits[rows, 0], client.angles[rows, 0]
        lowest, highest = turns_in_range(theta_range, theta_rad)
        first = np.where(lowest - theta_range[:, 0] <= theta_range[:, 1] - highest, _DOWN, _UP)
        chosen: list[tuple[int, int]] = []
        for robot, way in zip(plane.ids[rows].tolist(), first.tolist()):
            left = [each for each in (way, -way) if (robot, each) not in self._tried]
            chosen += [(robot, each) for each in left[:1]]
        ids, ways = np.array(chosen, dtype=np.int64).reshape(-1, 2).T
        return ids, ways

    def _turn(self, ids: Ids, way: Ints) -> None:
        client = self._client
        ended = self._turning.turn_to_stops(ids, way).of(ids)
        self.motions += 1
        rows, moved = client.plane.index_of(ids), ended.outcome != Outcome.HELD
        client.wait_for(
            lambda: (client.unplaced[rows[moved]] != layout.SEEN).all(), self._timeout_s,
            "the robots that have turned at unknown places",
        )  # fmt: skip
        # also of robots that were stopped on the way
        turned = client.unplaced[rows] != layout.SEEN
        for robot, each, went, reason in zip(ids.tolist(), way.tolist(), turned, ended.reason):
            if went:
                self._tried[robot, each] = "turned"
            elif reason != Reason.NO_TARGET:
                self._tried[robot, each] = Reason(reason).name.lower()
        among = np.isin(client.plane.ids, ids[turned])
        if turned.any():
            self._find(among)
        known = (client.unplaced[among] == 0).sum()
        self._say(
            f"after turn {self.motions} to stops: {turned.sum()} robots have turned, {known} of "
            "them are in use again"
        )
