# SPDX-License-Identifier: Apache-2.0
"""Plans from their targets to their orders: accepted or refused, then awaited, then ended."""

import time
from collections.abc import Callable
from typing import Any

from rclpy.publisher import Publisher

from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.node.kept_plan import KeptPlan
from fiber_bus_bridge.node.outlines import Outlines
from fiber_bus_bridge.node.plan_inputs import PlanInputs
from fiber_bus_bridge.node.publishers import Publishers
from fiber_bus_bridge.node.stage_watch import STAGES, StageWatch
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.session_state import SessionState
from fiber_bus_bridge.unexecuted import unexecuted
from fiber_core.array_types import Points
from fiber_core.errors import FiberError
from fiber_core.outcomes import Reason
from fiber_msgs_py import Attempt, PlanStamp, progress, targets
from fiber_node import Reporter

__all__ = ["AcceptedPlans"]

_REPEAT_S = 1.0  # an acceptance is repeated, for nodes that were not connected
_FOREIGN_S = 0.1  # shortest time between two answers to messages of other sessions


class AcceptedPlans:
    """Hears targets, accepts or refuses their plans, and ends those whose orders cannot come.

    An accepted plan is announced with the time of the joint states that are published with it, and
    planner and discretizer plan with these or newer ones. Every plan of this session that is not
    carried out gets an outcome at once: its targets are refused, a stage refuses it, a stage has
    left the graph, another plan takes its place, or an operator ends it.

    Args:
        watch: knows which nodes work on the plans.
        session: the session with the robots.
        session_id: id of the session in messages.
        inputs: keeps the accepted plans.
        outlines: the outlines of the session.
        outgoing: publishes encoders.
        kept: publishes outcomes.
        reporter: publishes acceptances and refusals.
        sender: publishes targets without a stamp again, with one.
        check_role: refuses by a SessionError while this bridge may move no robot.
    """

    def __init__(
        self,
        watch: StageWatch,
        session: Session,
        session_id: str,
        inputs: PlanInputs,
        outlines: Outlines,
        outgoing: Publishers,
        kept: KeptPlan,
        reporter: Reporter,
        sender: Publisher,
        check_role: Callable[[], None],
    ):
        self._watch, self._session, self._session_id = watch, session, session_id
        self._inputs, self._outlines = inputs, outlines
        self._outgoing, self._kept, self._reporter = outgoing, kept, reporter
        self._open: dict[PlanStamp, Attempt] = {}  # accepted, and without orders yet
        self._announced_s = self._foreign_s = 0.0
        self._sender, self._check_role = sender, check_role

    def hear_targets(self, message: Any) -> PlanStamp | None:
        """Accept or refuse the targets of a plan; return its stamp if they are accepted."""
        try:
            stamp = PlanStamp.of(message)
            if self._inputs.knows(stamp):
                return None  # of an attempt that this bridge has made, or sent twice
        except FiberError as error:
            self._reporter.refuse(f"targets refused: {error}", "targets")
            return None
        try:
            self._inputs.check_session(message, "targets")
        except FiberError as error:
            self._refuse_foreign(stamp, f"targets {stamp} refused: {error}")
            return None
        if stamp.ns == 0:
            return self._send_with_present_stamp(message)
        return stamp if self._accept(stamp, message) else None

    def _refuse_foreign(self, stamp: PlanStamp, text: str) -> None:
        # no outcome, and few answers: a flood of these must not hide what this session says
        answers = time.monotonic() > self._foreign_s + _FOREIGN_S
        if answers:
            self._foreign_s = time.monotonic()
        self._reporter.refuse(text, "targets", Attempt.first(stamp) if answers else None)

    def _send_with_present_stamp(self, message: Any) -> PlanStamp | None:
        # zero means now; all nodes must take the same time for it, so the targets are sent again
        stamp = PlanStamp(self._outgoing.now_ns())
        message.header.stamp = stamp.to_time()
        if not self._accept(stamp, message):
            return None
        self._sender.publish(message)
        return stamp

    def _accept(self, stamp: PlanStamp, message: Any) -> bool:
        goals = None
        try:
            self._inputs.check_stamp(stamp, self._outgoing.now_ns())
            goals = self._inputs.goals(message)
            fibre = self._inputs.chosen_fibre(message)
            straight = targets.decode_straight(message)
            number = targets.decode_attempt(message).number
            if number != 1:
                raise SessionError(f"attempt {number} was not made by this bridge")
            self._check_state()
            self._outlines.use(straight)
        except FiberError as error:
            self._refuse(Attempt.first(stamp), goals, f"targets {stamp} refused: {error}")
            return False
        self._inputs.add(stamp, goals, fibre, straight)
        now_ns = self._outgoing.now_ns()
        attempt = Attempt(stamp, stamp, 1, now_ns, self._outgoing.layout_ns)
        self._open[stamp] = attempt
        self._watch.begin(stamp)
        self._outgoing.publish_encoders(now_ns)
        self._reporter.debug(f"plan {attempt}: targets accepted")
        self._announce(attempt)
        return True

    def _check_state(self) -> None:
        self._check_role()
        state = self._session.state
        if state is SessionState.MOVING:
            raise SessionError(f"robots are moving: {state.value}")
        if state not in (SessionState.IDLE, SessionState.READY):
            raise SessionError(f"no plan is accepted while {state.name}: {state.value}")

    def _announce(self, attempt: Attempt) -> None:
        self._announced_s = time.monotonic()
        self._reporter.progress(attempt, 0.0, "accepted: waits for its orders")

    def _refuse(self, attempt: Attempt, goals: Points | None, text: str) -> None:
        self._reporter.refuse(text, "targets", attempt)
        self._publish_unexecuted(attempt.plan, goals, Reason.PLAN_REFUSED)

    def _publish_unexecuted(self, stamp: PlanStamp, goals: Points | None, reason: Reason) -> None:
        session = self._session
        plane = session.plane.with_fibre(self._inputs.fibre(stamp))
        result = unexecuted(plane, session.angles, goals, reason)
        self._kept.publish_outcome(result.explained_by(self._inputs.reasons(stamp)), stamp)

    def awaits_orders(self, stamp: PlanStamp) -> Attempt | None:
        """Return the accepted plan of a stamp whose orders have not come yet, None without one."""
        return self._open.get(stamp)

    @property
    def waiting(self) -> bool:
        """Whether an accepted plan waits for its orders."""
        return bool(self._open)

    @property
    def newest(self) -> PlanStamp | None:
        """The newest accepted plan whose orders have not come yet, None without one."""
        return max(self._open, default=None)

    def take(self, stamp: PlanStamp) -> None:
        """Take a plan whose orders have come; plans accepted before it end without orders."""
        order = list(self._open)
        for earlier in order[: order.index(stamp)]:
            self._end(earlier, Reason.NOT_PLANNED, f"the orders of plan {stamp} came first")
        del self._open[stamp]
        self._watch.end(stamp)

    def end_all(self, reason: Reason, why: str) -> None:
        """End all plans without orders.

        Args:
            reason: Reason of their robots with a target.
            why: the cause, for people.
        """
        for stamp in list(self._open):
            self._end(stamp, reason, why)

    def refuse_orders(self, stamp: PlanStamp, why: str) -> None:
        """End a plan whose orders, or whose work in a stage, were refused."""
        if stamp in self._open:
            self._end(stamp, Reason.PLAN_REFUSED, why)

    def _end(self, stamp: PlanStamp, reason: Reason, why: str) -> None:
        attempt = self._open.pop(stamp)
        self._watch.end(stamp)
        self._reporter.refuse(f"plan {stamp} ended without orders: {why}", "plans", attempt)
        self._publish_unexecuted(stamp, self._inputs.targets(stamp), reason)

    def refusal_of_stage(self, message: Any) -> tuple[PlanStamp, str] | None:
        """Return which attempt a stage refuses, and its reason; None if the message is no refusal.

        Raises:
            MessageError: the message is malformed.
        """
        received = progress.decode(message)
        ours = received.session == self._session_id and received.stage in STAGES
        if not ours or not received.refused:
            return None
        return received.attempt.stamp, f"{received.stage}: {received.text}"

    def check(self) -> None:
        """Announce the plans that wait once more, and end those whose stages are gone."""
        if self._open and time.monotonic() > self._announced_s + _REPEAT_S:
            for attempt in self._open.values():
                self._announce(attempt)
        for stamp, role in self._watch.lost():
            if stamp in self._open:
                self._end(stamp, Reason.NOT_PLANNED, f"the {role} is not in the graph")
