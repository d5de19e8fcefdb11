# SPDX-License-Identifier: Apache-2.0
"""Which planner and discretizer work on a plan, and whether they are still in the graph."""

import time
from collections.abc import Callable

from rclpy.node import Node

from fiber_msgs_py import PlanStamp
from fiber_node import DISCRETIZER, PLANNER, claims

__all__ = ["STAGES", "StageWatch"]

STAGES = (PLANNER, DISCRETIZER)

_ABSENT_S = 1.0  # a node that is needed and not in the graph may come until then


class StageWatch:
    """Finds the plans whose orders cannot come, because a node that works on them is gone.

    A node that comes in place of one that is gone does not know what that one was working on.

    Args:
        node: a node of the graph.
        clock: returns seconds.
    """

    def __init__(self, node: Node, clock: Callable[[], float] = time.monotonic):
        self._node, self._clock = node, clock
        self._watched: dict[PlanStamp, tuple[float, dict[str, str]]] = {}

    def begin(self, stamp: PlanStamp) -> None:
        """Watch the nodes that are in the graph now, for a plan or an attempt of one."""
        present = {role: found[0] for role in STAGES if (found := claims(self._node, role))}
        self._watched[stamp] = self._clock(), present

    def end(self, stamp: PlanStamp) -> None:
        """Watch no more for a plan."""
        self._watched.pop(stamp, None)

    def lost(self) -> list[tuple[PlanStamp, str]]:
        """Return the plans whose orders cannot come, and the missing node of each."""
        # also without a plan: a death is noticed by looking more than once
        present = {role: claims(self._node, role) for role in STAGES}
        lost = []
        for stamp, (begun_s, before) in self._watched.items():
            for role in STAGES:
                if role in before:
                    missing = before[role] not in present[role]
                else:
                    missing = not present[role] and self._clock() > begun_s + _ABSENT_S
                if missing:
                    lost.append((stamp, role))
                    break
        return lost
