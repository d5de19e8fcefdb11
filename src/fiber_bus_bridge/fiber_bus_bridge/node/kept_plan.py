# SPDX-License-Identifier: Apache-2.0
"""The plan under way on disk: a bridge tells how the plan of the bridge before it has ended."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.left_plan import LeftPlan, load_left_plan, save_left_plan
from fiber_bus_bridge.node.publishers import Publishers
from fiber_bus_bridge.plan_result import PlanResult
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.unexecuted import unexecuted
from fiber_core.array_types import Ints, Mask, Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Reason
from fiber_msgs_py import PlanStamp
from fiber_node import Reporter

__all__ = ["KeptPlan"]


class KeptPlan:
    """Keeps a plan in a file from its acceptance until its outcome is published.

    The file has place for one plan: the newest that was accepted, or the one of which robots move.
    A bridge that finds a plan there is one whose bridge died: it reads the robots, publishes the
    outcome once, and keeps the plan until the next one begins, so that a bridge that dies in
    between says the same.

    Args:
        session: the session with the robots, not configured yet.
        plane: the focal plane.
        memory: file of the memory of the robots; None for no memory.
        outgoing: publishes outcomes.
        reporter: reports what is found, and what is wrong with the file.
        now_s: returns the time of the buses [s].
    """

    def __init__(
        self,
        session: Session,
        plane: FocalPlane,
        memory: Path | None,
        outgoing: Publishers,
        reporter: Reporter,
        now_s: Callable[[], float],
    ):
        self._session, self._plane, self._outgoing = session, plane, outgoing
        self._reporter, self._now_s = reporter, now_s
        self._path = None if memory is None else memory.with_name(memory.name + ".plan")
        self._own: LeftPlan | None = None
        self._left = self._load()  # of an earlier bridge, until it is told
        is_open = self._left is not None and not self._left.ended
        session.look_back(self._note_ends if is_open else None)

    def _load(self) -> LeftPlan | None:
        if self._path is None:
            return None
        try:
            return load_left_plan(self._path, self._plane)
        except BridgeError as error:
            self._reporter.refuse(f"{error}; how that plan ended is not told")
            return None

    def accept(self, stamp: PlanStamp, goals: Points, fibre: Ints) -> None:
        """Keep a plan that waits for its orders; without a place on disk it goes on all the same.

        Args:
            stamp: names the plan.
            goals: target of each fibre [mm], shape (n, 2), nan = no target.
            fibre: number of the fibre that each target is for, -1 for any, shape (n,).
        """
        if self._path is None:
            return
        self.tell()
        if self._left is not None:
            return  # the file has place for one plan, and that one is not over
        plane, nothing = self._plane, np.zeros(self._plane.n, dtype=bool)
        angles = self._session.angles
        result = unexecuted(plane.with_fibre(fibre), angles, goals, Reason.NOT_PLANNED)
        plan = LeftPlan(stamp.ns, goals, fibre, nothing, result)
        self._own = plan if self._save(plan) else None

    def begin(self, plan: LeftPlan | None) -> None:
        """Keep the plan whose robots are about to be sent a GO.

        Raises:
            BridgeError: the file cannot be written.
        """
        if self._path is None or plan is None:
            return
        self._tell()  # the file has place for one plan
        save_left_plan(self._path, plan, self._plane)
        self._own = plan

    def note_result(self, result: PlanResult) -> None:
        """Keep the result of an attempt, before its robots are cleared and forget it.

        Raises:
            BridgeError: the file cannot be written.
        """
        if self._path is None or self._own is None:
            return
        self._own = replace(self._own, started=np.zeros(self._plane.n, dtype=bool), result=result)
        save_left_plan(self._path, self._own, self._plane)

    def publish_outcome(self, result: PlanResult, stamp: PlanStamp) -> None:
        """Publish the outcome of a plan; the file then has nothing to tell of it."""
        own = self._own
        if self._path is None or own is None or own.stamp_ns != stamp.ns:
            self._outgoing.publish_outcome(result, stamp)
            return
        self._save_ended(replace(own, result=result, ended=True))
        self._outgoing.publish_outcome(result, stamp)
        self._own = None
        self._remove()

    def _note_ends(self, at_rest: Mask) -> None:
        # as `configure` has read the robots, before it deletes why they rest
        session, left = self._session, self._left
        if left is not None and not left.ended:
            self._left = left.noted(
                session.plane, session.angles, at_rest, session.robots["rest_cause"],
                session.config.tolerance_mm,
            )  # fmt: skip
            self._save(self._left, synced=True)

    def tell(self) -> None:
        """Publish the outcome of the plan of an earlier bridge, once its robots rest."""
        left = self._left
        if left is None:
            return
        if not left.ended:
            if not self._session.known.any():
                return  # no robot was read yet
            if self._session.has_buses and self._session.look(self._now_s()).any():
                return  # some move: they stop by themselves
        self._tell()

    def _tell(self) -> None:
        left, self._left = self._left, None
        if left is None:
            return
        self._session.look_back(None)
        session = self._session
        if not left.ended:
            robots = session.robots
            # a sector that was not configured anew knows robots that do not answer any more
            sure = session.usable & ~robots["lost"] & (robots["state"] != 0)
            left = left.found(
                session.plane, session.angles, sure, robots["rest_cause"],
                session.config.tolerance_mm,
            )  # fmt: skip
            self._save_ended(left)
        stamp, result = PlanStamp(left.stamp_ns), left.result
        self._outgoing.publish_outcome(result, stamp)
        self._reporter.info(f"plan {stamp}, whose bridge died, has ended: {result.summary}")

    def _save_ended(self, plan: LeftPlan) -> None:
        # without these results in it the next bridge would find others: better none than two
        if not self._save(plan):
            self._remove()

    def _save(self, plan: LeftPlan, synced: bool = False) -> bool:
        assert self._path is not None  # a plan was kept
        try:
            save_left_plan(self._path, plan, self._plane, synced)
        except BridgeError as error:
            self._reporter.refuse(str(error))
            return False
        return True

    def _remove(self) -> None:
        assert self._path is not None  # a plan was kept
        try:
            self._path.unlink(missing_ok=True)
        except OSError as error:
            self._reporter.refuse(f"plan under way {self._path} stays: {error}")
