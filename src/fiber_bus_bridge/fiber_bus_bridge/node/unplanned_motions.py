# SPDX-License-Identifier: Apache-2.0
"""Motions without targets and planner: home, test turns, and turns to a stop."""

from collections.abc import Callable
from typing import Any

import numpy as np

from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.node.attempts import Attempts
from fiber_bus_bridge.node.publishers import Publishers
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.session_state import SessionState
from fiber_bus_bridge.stop_turns import blocked_text, turn_to_stops
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
        outgoing: publishes layout and encoders.
    """

    def __init__(
        self,
        session: Session,
        attempts: Attempts,
        now_s: Callable[[], float],
        check_role: Callable[[], None],
        may_go: Callable[[], bool],
        report_started: Callable[[], str],
        outgoing: Publishers,
        reporter: Reporter,
    ):
        self._session, self._attempts, self._now_s = session, attempts, now_s
        self._check_role, self._may_go = check_role, may_go
        self._report_started = report_started
        self._outgoing, self._reporter = outgoing, reporter
        self._waiting: tuple[PlanStamp, Floats] | None = None  # turns that no `turn` has made yet

    def home(self) -> str:
        """Fold robots; return how many were started.

        Raises:
            SessionError: the bridge may not move robots, or they cannot be moved in this state.
        """
        return self._move("the robots go home", "home", self._session.home)

    def hear_turns(self, message: Any) -> None:
        """Keep which turns the next call of `turn` makes, or refuse them."""
        attempt: Attempt | None = None
        try:
            attempt = Attempt.first(PlanStamp.of(message))
            self._attempts.inputs.check_session(message, "turns")
            told, plane = turns.decode(message), self._session.plane
            rows = plane.index_of(told.ids)
            if (rows < 0).any():
                robot = int(told.ids[rows < 0][0])
                raise MessageError("turns", "is not of this plane", robot=robot)
            self._attempts.check_turn_stamp(attempt.stamp)
            ways = np.full(plane.n, np.nan)
            ways[rows] = told.way
            self._waiting = attempt.stamp, ways
            of = f"{len(rows)} robots" if len(rows) else "the robots at unknown places"
            self._reporter.done(attempt, f"ready: turns of {of}")
        except FiberError as error:
            self._reporter.refuse(f"turns refused: {error}", "turns", attempt)

    def forget_turns(self) -> None:
        """Let no turns wait for a call of `turn`."""
        self._waiting = None

    def turn(self) -> str:
        """Make the turns that wait: of code words, to stops, or of robots at unknown places.

        The motion has the stamp of these turns. A bridge that has not heard them makes none.

        Returns:
            How many robots were started, and which rest.

        Raises:
            SessionError: no turns wait, no robot may turn, or robots cannot be moved in this state.
        """
        if self._waiting is None:
            raise SessionError(
                "no turns wait: stop, clear, configure, home or another motion made this bridge "
                "forget them, or they were sent to another bridge; send them anew"
            )
        stamp, ways = self._waiting
        if (np.abs(ways) == turns.TO_UPPER_STOP).any():
            return self._turn_to_stops(ways, stamp)
        if np.isfinite(ways).any():
            return self._turn_words(ways, stamp)
        return self._turn_unplaced(stamp)

    def _turn_words(self, ways: Floats, stamp: PlanStamp) -> str:
        refused = cannot_turn(self._session) & np.isfinite(ways)
        rest = f"; {resting_text(self._session, refused)}" if refused.any() else ""
        started = self._move(
            "phi turns by code words", "turn by code words",
            lambda t, may_go: turn_words(self._session, ways, t, may_go), stamp,
        )  # fmt: skip
        return started + rest

    def _turn_to_stops(self, ways: Floats, stamp: PlanStamp) -> str:
        text = blocked_text(self._session, ways)
        started = self._move(
            "robots turn to their stops", "turn to stops",
            lambda t, may_go: turn_to_stops(self._session, ways, t, self._told(may_go)), stamp,
        )  # fmt: skip
        self._outgoing.publish_layout()  # before an image: their places are unknown now
        return f"{started}; {text}" if text else started

    def _told(self, may_go: Callable[[], bool]) -> Callable[[], bool]:
        # the motion begins at counters that were set just now
        def tell_and_ask() -> bool:
            self._outgoing.publish_encoders()
            return may_go()

        return tell_and_ask

    def _turn_unplaced(self, stamp: PlanStamp) -> str:
        _, refused = turns_of(self._session)
        rest = f"; {refused_text(self._session, refused)}" if refused.any() else ""
        started = self._move(
            "robots at unknown places turn", "turn at unknown places",
            lambda t, may_go: turn_unplaced(self._session, t, may_go), stamp,
        )  # fmt: skip
        return started + rest

    def _move(
        self,
        why: str,
        what: str,
        move: Callable[[float, Callable[[], bool]], float],
        stamp: PlanStamp | None = None,
    ) -> str:
        self._check_role()
        state = self._session.state
        if state is not SessionState.IDLE:  # and no plan is ended, and nothing is forgotten
            raise SessionError(f"cannot {what} while {state.name}: {state.value}")
        self.forget_turns()
        self._attempts.end_all(Reason.NOT_PLANNED, why)
        move(self._now_s(), lambda: self._may_begin(stamp))
        self._begin(stamp)
        return self._report_started()

    def _may_begin(self, stamp: PlanStamp | None) -> bool:
        self._begin(stamp)
        return self._may_go()

    def _begin(self, stamp: PlanStamp | None) -> None:
        if self._attempts.ended:
            self._attempts.begin_unplanned(stamp)
