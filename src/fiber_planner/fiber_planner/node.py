# SPDX-License-Identifier: Apache-2.0
"""The planner node: targets in, one trajectory for the whole plane out."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import ClassVar

import numpy as np
from sensor_msgs.msg import PointCloud2

from fiber_core.array_types import Pairs
from fiber_core.assignment import Assignment, assign
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_msgs_py import (
    Attempt,
    PlanStamp,
    Stage,
    held,
    targets,
    topics,
    trajectory,
)
from fiber_node import (
    PLANNER,
    AcceptedAttempts,
    Claim,
    ManagedNode,
    PlaneCache,
    SessionGate,
    run,
)
from fiber_planner.errors import PlannerError
from fiber_planner.interface import Planner, check_borders, spacing_of
from fiber_planner.plan_stage import PlanStageResult, plan_assignment
from fiber_planner.registry import (
    DEFAULT_PLANNER,
    LISTED_PLANNER,
    make_planner,
    parameters_of,
    planners,
    suited,
)
from fiber_planner.scheduled import ScheduledParameters
from fiber_planner.straight import StraightPlanner

__all__ = ["PlannerNode", "main"]


@dataclass(frozen=True)
class PlannerChoice:
    """Which planner plans.

    Args:
        planner: name of the planner; its parameters begin with its name. For motors with listed
            speeds, `scheduled` plans in place of `direct`.

    Raises:
        PlannerError: there is no planner of that name.
    """

    CHOICES: ClassVar = {"planner": planners()}

    planner: str = DEFAULT_PLANNER

    def __post_init__(self) -> None:
        if self.planner not in planners():
            raise PlannerError(
                f"no planner is called {self.planner!r}; there are {', '.join(planners())}"
            )


class PlannerNode(ManagedNode):
    """Plans each table of targets from the joint angles that the encoders report.

    It plans the attempts that the bridge has accepted, corrections by the planner `straight`
    whatever planner is chosen, and stays out while an earlier planner is
    in the graph. Configured it follows the plane; active it has the role of the planner and plans;
    deactivated it ends the planning under way, whose plan ends with an outcome of the bridge.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, **options):
        super().__init__("planner", PLANNER, **options)
        self._choice = self.parameters.declare(PlannerChoice)
        self._settings = {
            name: self.parameters.declare(parameters_of(name), name) for name in planners()
        }
        self.parameters.finish()
        self._claim: Claim | None = None  # while it is active
        self.begin()

    def configure(self) -> None:
        """Follow the plane, and hear targets."""
        gate = SessionGate(self, self.reporter.refuse_message)
        self._plane_cache = PlaneCache(gate, self.reporter)
        self._accepted = AcceptedAttempts(self, gate)
        self._held = topics.HELD_BY_PLANNER.publisher(self)
        self._trajectory = topics.TRAJECTORY.publisher(self)
        self._worker = self.worker("planning")
        self._worker.follow_stop(self.reporter)
        topics.TARGETS.subscription(self, self._on_targets)

    def activate(self) -> None:
        """Claim the role of the planner."""
        self._claim = Claim(self, PLANNER)  # last: the node is complete
        self.get_logger().info(
            f"waits for a bridge and for targets, to plan with {self._choice.value.planner}"
        )

    def deactivate(self) -> None:
        """End the planning under way, and give up the role."""
        claim, self._claim = self._claim, None
        if claim is not None:
            claim.release()
        for attempt in self._worker.cancel():
            self.reporter.drop(f"plan {attempt}: planning ended: the node is deactivated")

    def planner(self, plane: FocalPlane) -> Planner:
        """Return the planner that plans next, with the parameters that are in effect.

        Args:
            plane: the focal plane.
        """
        name = suited(self._choice.value.planner, plane)
        return make_planner(name, **asdict(self._settings[name].value))

    def _moving(self, plane: FocalPlane, attempt: Attempt) -> Planner:
        planner, chosen = self.planner(plane), self._choice.value.planner
        if planner.name != chosen:
            self.get_logger().info(
                f"plan {attempt}: the motors have a list of speeds, planner {planner.name} plans "
                f"in place of {chosen}"
            )
        return planner

    def _straight(self) -> StraightPlanner:
        scheduled = self._settings[LISTED_PLANNER].value
        assert isinstance(scheduled, ScheduledParameters)
        return StraightPlanner(scheduled=scheduled)

    def _on_targets(self, message: PointCloud2) -> None:
        try:
            stamp = PlanStamp.of(message)
        except FiberError as error:
            self.reporter.refuse(f"targets refused: {error}", "targets")
            return

        def plan_when_current(attempt: Attempt, session: str) -> None:
            if self._claim is None:
                self.reporter.drop(f"targets {attempt} not planned: this planner is inactive")
                return
            if self._claim.earlier():
                self.reporter.drop(f"targets {attempt} left to the planner that was here before")
                return
            work = partial(self._plan, attempt, session, message)
            self._plane_cache.when_current(
                attempt, session, lambda: self._worker.submit(attempt, work)
            )

        if not self._accepted.when_accepted(stamp, plan_when_current):
            self.reporter.waiting(f"targets {stamp} wait until the bridge accepts them")

    def _plan(self, attempt: Attempt, session: str, message: PointCloud2) -> None:
        if self._claim is None:
            return  # deactivated while the attempt waited for the plane
        try:
            ids, xy_mm = targets.decode(message)
            plane, _, start, moving, border_skews_s = self._plane_cache.state
            if moving:
                self.reporter.refuse(
                    f"targets {attempt} refused: robots are moving", "targets", attempt
                )
                return
            plane = targets.plane_for(plane, message)
            straight = targets.decode_straight(message)
            planner = self._straight() if straight else self._moving(plane, attempt)
            check_borders(planner, border_skews_s)
            self.reporter.debug(f"plan {attempt}: {len(ids)} targets, planner {planner.name}")
            spacing_mm = spacing_of(planner, plane)
            assignment = assign(plane, start, ids, xy_mm, spacing_mm=spacing_mm)
            self._warn_of_refused(assignment, attempt)
            result = plan_assignment(
                start,
                assignment,
                planner,
                self.reporter.progress_of(attempt, self._worker.check),
            )
            self._worker.check()
            self._publish(result, attempt, session)
        except FiberError as error:
            self.reporter.refuse(f"targets refused: {error}", "targets", attempt)

    def _publish(self, result: PlanStageResult, attempt: Attempt, session: str) -> None:
        ids, motion, is_held = result.problem.plane.ids, result.planned.motion, result.held
        self._warn_of_tangled(result.planned.tangled, result.problem.plane, attempt)
        self._held.publish(
            held.encode(ids[is_held], result.reason[is_held], Stage.PLANNER, attempt.stamp)
        )
        self._trajectory.publish(trajectory.encode(ids, motion, attempt.stamp, session))
        arriving, holds = (int(np.count_nonzero(mask)) for mask in (result.arriving, is_held))
        self.reporter.counters |= {
            "plan": attempt,
            "arriving": arriving,
            "held": holds,
            "tangled": len(result.planned.tangled),
            "makespan_s": f"{motion.makespan_s:.3f}",
        }
        self.reporter.done(
            attempt, f"{arriving} robots arrive in {motion.makespan_s:.2f} s, {holds} held"
        )

    def _warn_of_refused(self, assignment: Assignment, attempt: Attempt) -> None:
        for robot in assignment.refused_ids:
            self.get_logger().warning(f"plan {attempt}: {assignment.explain(int(robot))}")

    def _warn_of_tangled(self, tangled: Pairs, plane: FocalPlane, attempt: Attempt) -> None:
        for pair in tangled:
            names = " and ".join(plane.name_of(int(row)) for row in pair)
            self.get_logger().warning(f"plan {attempt}: {names} start too close to each other")


def main(args: Sequence[str] | None = None) -> int:
    """Run the planner node until it is interrupted."""
    return run(PlannerNode, args)
