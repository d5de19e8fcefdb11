# SPDX-License-Identifier: Apache-2.0
"""Motions without targets and planner: home, and the test turn of robots at unknown places."""

from collections.abc import Callable

from fiber_bus_bridge.node.attempts import Attempts
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.unplaced_robots import refused_text, turn_unplaced, turns_of
from fiber_core.outcomes import Reason

__all__ = ["UnplannedMotions"]


class UnplannedMotions:
    """Starts motions that end all plans. A caller holds the lock of the bridge.

    Args:
        session: the session with the robots.
        attempts: the plans, and what is under way.
        now_s: returns the time of the buses [s].
        check_role: raises an error while this bridge may not move robots.
        may_go: asked when the orders are certified.
        report_started: tells how many robots were started.
    """

    def __init__(
        self,
        session: Session,
        attempts: Attempts,
        now_s: Callable[[], float],
        check_role: Callable[[], None],
        may_go: Callable[[], bool],
        report_started: Callable[[], str],
    ):
        self._session, self._attempts, self._now_s = session, attempts, now_s
        self._check_role, self._may_go = check_role, may_go
        self._report_started = report_started

    def home(self) -> str:
        """Fold robots; return how many were started."""
        return self._move("the robots go home", self._session.home)

    def turn(self) -> str:
        """Turn robots at unknown places; return how many were started, and which rest."""
        _, refused = turns_of(self._session)
        rest = f"; {refused_text(self._session, refused)}" if refused.any() else ""
        started = self._move(
            "robots at unknown places turn",
            lambda t, may_go: turn_unplaced(self._session, t, may_go),
        )
        return started + rest

    def _move(self, why: str, move: Callable[[float, Callable[[], bool]], float]) -> str:
        self._check_role()
        self._attempts.end_all(Reason.NOT_PLANNED, why)
        move(self._now_s(), self._may_begin)
        self._begin()
        return self._report_started()

    def _may_begin(self) -> bool:
        self._begin()
        return self._may_go()

    def _begin(self) -> None:
        if self._attempts.ended:
            self._attempts.begin_home()
