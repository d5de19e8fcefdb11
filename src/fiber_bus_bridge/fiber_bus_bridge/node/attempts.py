# SPDX-License-Identifier: Apache-2.0
"""The orders of a plan, its attempts one after another, and its outcome."""

import threading
import time
from collections.abc import Callable
from copy import copy
from typing import Any

import numpy as np
from rclpy.node import Node

from fiber_bus_bridge.availability import Availability
from fiber_bus_bridge.errors import BridgeError, SessionError
from fiber_bus_bridge.left_plan import LeftPlan
from fiber_bus_bridge.node.accepted_plans import AcceptedPlans
from fiber_bus_bridge.node.kept_plan import KeptPlan
from fiber_bus_bridge.node.outlines import Outlines
from fiber_bus_bridge.node.plan_inputs import PlanInputs
from fiber_bus_bridge.node.publishers import Publishers
from fiber_bus_bridge.node.settings import AttemptConfig
from fiber_bus_bridge.node.stage_watch import StageWatch
from fiber_bus_bridge.plan_result import PlanResult
from fiber_bus_bridge.replanning import Replanning
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.session_state import SessionState
from fiber_core.array_types import Mask
from fiber_core.errors import FiberError
from fiber_core.outcomes import Outcome, Reason
from fiber_msgs_py import Attempt, PlanStamp, targets, topics
from fiber_node import Declared, Reporter

__all__ = ["Attempts"]


class Attempts:
    """Takes the orders of accepted plans, makes later attempts, and publishes outcomes.

    Args:
        node: the node.
        watch: knows which nodes work on the plans.
        session: the session with the robots.
        session_id: id of the session in messages.
        accepted: the plans that wait for orders.
        inputs: the targets of the plans, and the robots that the stages hold.
        availability: the robots that can be commanded.
        outlines: the outlines of the session.
        outgoing: publishes layout and encoders.
        kept: publishes outcomes, and keeps the plan under way in a file.
        reporter: publishes progress and refusals.
        config: largest number of attempts of a plan, longest wait for the orders of a later one.
        stopping: set while a stop is requested.
        now_s: returns the time of the buses [s].
        start: starts the orders of a later attempt.
        save_traffic: called with the stamp of each plan that has ended.
    """

    def __init__(
        self,
        node: Node,
        watch: StageWatch,
        session: Session,
        session_id: str,
        accepted: AcceptedPlans,
        inputs: PlanInputs,
        availability: Availability,
        outlines: Outlines,
        outgoing: Publishers,
        kept: KeptPlan,
        reporter: Reporter,
        config: Declared[AttemptConfig],
        stopping: threading.Event,
        now_s: Callable[[], float],
        start: Callable[[], str],
        save_traffic: Callable[[PlanStamp], None],
    ):
        self._node, self._watch = node, watch
        self._session, self._session_id = session, session_id
        self._accepted, self.inputs, self._availability = accepted, inputs, availability
        self._outlines, self._outgoing, self._reporter = outlines, outgoing, reporter
        self._kept, self._config = kept, config
        self._stopping, self._now_s, self._start = stopping, now_s, start
        self._save_traffic = save_traffic
        self.current: Attempt | None = None  # the attempt with the orders of the session
        self._ended = True  # the plan of `current` has its outcome
        self.awaited: Attempt | None = None  # next attempt, whose orders have not come yet
        self._awaited_until_s = 0.0
        self._made: set[PlanStamp] = set()  # later attempts that this node has made
        self._awaited_text = ""
        self._replaced: PlanStamp | None = None  # was ready, and other orders took its place
        self._replanning = Replanning(self._no_targets(), 1)
        self._ordered: Mask = np.zeros(session.plane.n, dtype=bool)  # with orders in this attempt
        self._targets = topics.TARGETS.publisher(node)

    @property
    def newest(self) -> PlanStamp | None:
        """The newest stamp of plans that were accepted."""
        return self.inputs.newest

    def _no_targets(self) -> np.ndarray:
        return np.full((self._session.plane.n, 2), np.nan)

    # --- orders --------------------------------------------------------------

    def hear_targets(self, message: Any) -> None:
        """Accept or refuse new targets; accepted ones end a plan that waits for another attempt."""
        stamp = self._accepted.hear_targets(message)
        goals = None if stamp is None else self.inputs.targets(stamp)
        if stamp is not None and goals is not None:
            self.give_up("there are new targets")
            self._kept.accept(stamp, goals, self.inputs.fibre(stamp))

    def hear_held(self, message: Any) -> None:
        """Keep the robots that a stage holds."""
        try:
            self.inputs.add_held(message)
        except FiberError as error:
            self._reporter.refuse(f"held refused: {error}", "held")

    def hear_progress(self, message: Any) -> None:
        """End the plan that a stage refuses."""
        try:
            refusal = self._accepted.refusal_of_stage(message)
        except FiberError:
            return
        if refusal is None:
            return
        stamp, why = refusal
        if self.awaited is not None and stamp == self.awaited.stamp:
            self.give_up(why)
        self._accepted.refuse_orders(stamp, why)

    def hear_segments(self, message: Any) -> None:
        """Take the orders of an accepted plan, or of the attempt that is awaited."""
        attempt: Attempt | None = None
        try:
            stamp = PlanStamp.of(message)
            self.inputs.check_session(message, "segments")
            attempt = self._expected(stamp)
            if attempt is None:
                self._reporter.drop(self._unexpected(stamp), "segments")
            else:
                self._accept_orders(attempt, message)
        except FiberError as error:
            self._reporter.refuse(f"segments refused: {error}", "segments")
            if attempt is not None and attempt == self.awaited:
                self.give_up("its orders were refused")
            elif attempt is not None:
                self._accepted.refuse_orders(attempt.stamp, f"its orders were refused: {error}")

    def _expected(self, stamp: PlanStamp) -> Attempt | None:
        if self.awaited is not None and stamp == self.awaited.stamp:
            return self.awaited
        return self._accepted.awaits_orders(stamp)

    def _unexpected(self, stamp: PlanStamp) -> str:
        if not self.inputs.knows(stamp):
            return f"segments {stamp} dropped: no targets with this stamp were accepted"
        if stamp in self._made:
            return f"segments {stamp} dropped: this attempt has ended"
        return f"segments {stamp} dropped: the plan has orders already, or has ended"

    def _accept_orders(self, attempt: Attempt, message: Any) -> None:
        motion = self.inputs.motion(message, self._session.units, self._session.counts)
        asked, is_awaited = self.inputs.targets(attempt.stamp), attempt == self.awaited
        if asked is None:
            raise BridgeError(f"the targets of plan {attempt} are not kept any more")
        self._outlines.use(self.inputs.straight(attempt.plan))  # stages may have seen others
        replaced = self._session.submit(motion, asked, self.inputs.fibre(attempt.stamp))
        if not is_awaited:
            self.give_up("there are new orders")
            self._accepted.take(attempt.stamp)
        if replaced is not None and self.current is not None:
            self._replaced = self.current.plan
            self.finish(self.current, replaced, last=True)
        if not is_awaited:
            self._replanning = Replanning(asked, self._config.value.attempts)
        self._watch.end(attempt.stamp)
        self.current, self.awaited, self._ended = attempt, None, False
        self._ordered = motion.moves
        self._reporter.done(attempt, f"ready: orders for {self._ordered.sum()} robots")
        if is_awaited:  # start was requested for this plan
            self._node.get_logger().info(self._start())

    def check_start(self, plan: str) -> None:
        """Refuse a start that may not mean the orders that wait.

        Args:
            plan: stamp of the plan that shall start, as text; empty for the one that was ready.

        Raises:
            SessionError: names the plan whose orders wait, or whose targets have come since.
        """
        if self._session.state is not SessionState.READY or self.current is None:
            return  # the session says what is missing
        waiting, newer = self.current.plan, self._accepted.newest
        if newer is not None:  # it is planned from where the robots are now
            raise SessionError(
                f"cannot start plan {waiting}: targets of plan {newer} have come since; "
                "wait for its orders, or clear"
            )
        if plan and plan != str(waiting):
            raise SessionError(f"cannot start plan {plan}: the orders of plan {waiting} wait")
        if not plan and self._replaced is not None:
            raise SessionError(
                f"the orders of plan {waiting} have taken the place of plan {self._replaced}: "
                "name the plan to start in the parameter start_plan, or clear"
            )

    @property
    def ended(self) -> bool:
        """Whether no plan has orders: the last one has its outcome."""
        return self._ended

    def so_far(self) -> LeftPlan | None:
        """Return the plan whose robots are about to be sent a GO, as it is known by then."""
        attempt = self.current
        if attempt is None or self._ended:
            return None
        result = self._session.so_far().explained_by(self.inputs.reasons(attempt.stamp))
        plan, before = attempt.plan, copy(self._replanning)
        return LeftPlan(
            plan.ns, before.goals, self.inputs.fibre(plan),
            self._session.robots["verified"].copy(), self._combined(before, attempt, result),
        )  # fmt: skip

    def check_turn_stamp(self, stamp: PlanStamp) -> None:
        """Refuse turns whose stamp cannot name the next motion.

        Raises:
            BridgeError: it is from the future, or not newer than that of a plan or motion before.
        """
        self.inputs.check_stamp(stamp, self._outgoing.now_ns())
        if self.current is not None and stamp <= self.current.plan:
            raise BridgeError(f"motion {self.current.plan} is not older than turns {stamp}")

    def begin_unplanned(self, stamp: PlanStamp | None = None) -> None:
        """Make a motion without targets the current plan.

        Args:
            stamp: names the motion; by default the present time.
        """
        self._outlines.move_blind()
        stamp = PlanStamp(self._outgoing.now_ns()) if stamp is None else stamp
        self.current = Attempt.first(stamp)
        self._replanning, self._ended = Replanning(self._no_targets(), 1), False

    def forget_stamps(self) -> None:
        """Let the next plan have any stamp: the clock was changed, or a plan had a wrong one."""
        self.inputs.forget()

    def forget_replaced(self) -> None:
        """Let the next start mean the orders that are ready then."""
        self._replaced = None

    # --- outcomes ------------------------------------------------------------

    def finish(self, attempt: Attempt, result: PlanResult, last: bool) -> None:
        """Add the result of an attempt; request the next attempt, or publish the outcome.

        Args:
            attempt: the attempt.
            result: its result.
            last: whether the plan gets no further attempt.
        """
        result = result.explained_by(self.inputs.reasons(attempt.stamp))
        known = self._session.known
        self._availability.exclude_failed(result, known)
        combined = self._combined(self._replanning, attempt, result)
        robots = self._replanning.next_robots(
            self._ordered, self._availability.commandable(self._session.usable)
        )
        stamp = self.inputs.free_stamp_after(attempt.stamp)
        self._reporter.debug(
            f"plan {attempt}: ended; {int(robots.sum())} robots could be tried again"
        )
        last = last or self._stopping.is_set() or not robots.any()
        if last or stamp is None or not (self._is_noted(combined) and self._is_cleared()):
            self._outgoing.publish_layout()
            self._publish_outcome(attempt.plan, combined)
        else:
            self._replan(attempt, stamp, robots, combined)

    def _is_noted(self, result: PlanResult) -> bool:
        """Note the result of an attempt before its robots are cleared; return whether it is."""
        try:
            self._kept.note_result(result)
        except BridgeError as error:
            self._reporter.refuse(f"the plan ends without another attempt: {error}")
            return False
        return True

    def _is_cleared(self) -> bool:
        """Clear the robots, which reads the positions of all, of failed robots too."""
        try:
            self._session.clear(self._now_s())
        except BridgeError as error:
            self._reporter.refuse(f"the plan ends without another attempt: {error}")
            return False
        return True

    def _combined(self, before: Replanning, attempt: Attempt, result: PlanResult) -> PlanResult:
        xy_mm = self.inputs.targets(attempt.stamp)
        asked = False if xy_mm is None else np.all(np.isfinite(xy_mm), axis=1)
        return before.add_attempt(self._availability.explain(result), asked)

    def _replan(
        self, last_attempt: Attempt, stamp: PlanStamp, robots: Mask, result: PlanResult
    ) -> None:
        """Request the next attempt of a plan for some robots; all others are obstacles."""
        now_ns = self._outgoing.now_ns()
        attempt = self.awaited = last_attempt.next(stamp, since_ns=now_ns)
        self._made = {made for made in self._made if self.inputs.knows(made)} | {stamp}
        self._watch.begin(stamp)
        self._awaited_until_s = time.monotonic() + self._config.value.attempt_timeout_s
        self._outgoing.publish_layout(always=True, now_ns=now_ns)
        ids, goals = self._session.plane.ids[robots], self._replanning.goals[robots]
        fibre, straight = self.inputs.fibre(attempt.plan), self.inputs.straight(attempt.plan)
        again = np.where(robots[:, None], self._replanning.goals, np.nan)
        self.inputs.add(stamp, again, fibre, straight)
        self._targets.publish(
            targets.encode_attempt(ids, goals, attempt, self._session_id, fibre[robots], straight)
        )
        held = int((robots & (result.outcome == Outcome.HELD)).sum())
        text = f"replanning: {held} robots were held because of robots that cannot be commanded"
        self._node.get_logger().info(f"plan {attempt}: {text}")
        self._awaited_text = text
        self._reporter.progress(attempt, 0.0, text)

    def give_up(self, reason: str) -> None:
        """End a plan whose next attempt is awaited, with the result so far."""
        result = self._replanning.result
        if self.awaited is not None and result is not None:
            self._node.get_logger().warning(f"plan {self.awaited} given up: {reason}")
            self._watch.end(self.awaited.stamp)
            plan, self.awaited = self.awaited.plan, None
            self._publish_outcome(plan, result)

    def end_all(self, reason: Reason, why: str) -> None:
        """End all plans whose orders have not come."""
        self.give_up(why)
        self._accepted.end_all(reason, why)
        self._replaced = None
        self._widen_at_rest()

    def check(self) -> None:
        """End the plans whose orders do not come."""
        self._accepted.check()
        self._widen_at_rest()
        if self.awaited is None:
            return
        for stamp, role in self._watch.lost():
            if stamp == self.awaited.stamp:
                self.give_up(f"the {role} is not in the graph")
                return
        # once more, for nodes that were not connected
        self._reporter.progress(self.awaited, 0.0, self._awaited_text)
        if time.monotonic() > self._awaited_until_s:
            timeout_s = self._config.value.attempt_timeout_s
            self._reporter.drop(
                f"plan {self.awaited}: no orders within {timeout_s:g} s, "
                "the plan ends without this attempt"
            )
            self.give_up("no orders came")

    def _widen_at_rest(self) -> None:
        if not self._accepted.waiting and self.awaited is None:
            self._outlines.rest()

    def _publish_outcome(self, plan: PlanStamp, result: PlanResult) -> None:
        attempts = self._replanning.attempts
        self._widen_at_rest()
        self._kept.publish_outcome(result, plan)
        self._ended = True
        summary = result.summary
        self._reporter.counters |= {"plan": plan, "outcome": summary, "attempts": attempts}
        text = summary if attempts == 1 else f"{summary}, in {attempts} attempts"
        self._reporter.done(Attempt.first(plan), text)
        self._save_traffic(plan)
