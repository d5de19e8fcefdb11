# SPDX-License-Identifier: Apache-2.0
"""Motions without targets and planner: home, and test turns."""

from collections.abc import Callable
from typing import Any

import numpy as np

from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.node.attempts import Attempts
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.unplaced_robots import refused_text, turn_unplaced, turns_of
from fiber_bus_bridge.word_turns import cannot_turn, resting_text, turn_words
from fiber_core.array_types import Floats
from fiber_core.errors import FiberError
from fiber_core.outcomes import Reason
from fiber_msgs_py import Attempt, MessageError, PlanStamp, turns
from fiber_node import Reporter

__all__ = ["UnplannedMotions"]


class UnplannedMotions:
    """Starts motions that end all plans. A caller holds the lock of the bridge.

    Args:
        session: the session with the robots.
        attempts: the plans, and what is under way.
        now_s: returns the time of the buses [s].
        check_role: raises an error while this bridge may not move robots.
        may_go: asked when the orders are certified.
        reporter: answers to messages.
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
        reporter: Reporter,
    ):
        self._session, self._attempts, self._now_s = session, attempts, now_s
        self._check_role, self._may_go = check_role, may_go
        self._report_started, self._reporter = report_started, reporter
        self._ways: Floats | None = None  # of the robots that shall turn by code words
        self._forgotten = False  # whether another call came between such ways and their `turn`

    def home(self) -> str:
        """Fold robots; return how many were started."""
        self.forget_turns()
        return self._move("the robots go home", self._session.home)

    def hear_turns(self, message: Any) -> None:
        """Keep which robots the next call of `turn` shall turn by code words, or refuse it."""
        attempt: Attempt | None = None
        try:
            attempt = Attempt.first(PlanStamp.of(message))
            self._attempts.inputs.check_session(message, "turns")
            told, plane = turns.decode(message), self._session.plane
            rows = plane.index_of(told.ids)
            if (rows < 0).any():
                robot = int(told.ids[rows < 0][0])
                raise MessageError("turns", "is not of this plane", robot=robot)
            self._ways = np.full(plane.n, np.nan)
            self._ways[rows], self._forgotten = told.way, False
            self._reporter.done(attempt, f"ready: turns of {len(rows)} robots")
        except FiberError as error:
            self._reporter.refuse(f"turns refused: {error}", "turns", attempt)

    def forget_turns(self) -> None:
        """Let no code word wait for a call of `turn`; that call then turns no other robots."""
        self._forgotten |= self._ways is not None
        self._ways = None

    def turn(self) -> str:
        """Turn robots by code words or at unknown places; return how many, and which rest.

        Raises:
            SessionError: no robot may turn, or the code words that waited were forgotten.
        """
        ways, forgotten = self._ways, self._forgotten
        self._ways, self._forgotten = None, False
        if forgotten:
            raise SessionError(
                "the turns that waited were forgotten by stop, clear, configure or home: send them "
                "anew, or call turn once more for robots at unknown places"
            )
        return self._turn_unplaced() if ways is None else self._turn_words(ways)

    def _turn_words(self, ways: Floats) -> str:
        refused = cannot_turn(self._session) & np.isfinite(ways)
        rest = f"; {resting_text(self._session, refused)}" if refused.any() else ""
        started = self._move(
            "phi turns by code words",
            lambda t, may_go: turn_words(self._session, ways, t, may_go),
        )
        return started + rest

    def _turn_unplaced(self) -> str:
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
