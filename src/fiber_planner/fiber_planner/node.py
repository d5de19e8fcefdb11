"""The planner as a node: targets in, one trajectory for the whole plane out."""

import dataclasses

import numpy as np
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from fiber_core.assignment import assign
from fiber_core.errors import FiberError
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_msgs_py import (
    PlanStamp,
    Stage,
    held,
    targets,
    topics,
    trajectory,
)
from fiber_node import PlaneCache, Reporter, declare_parameters_of, run
from fiber_planner.registry import DEFAULT_PLANNER, make_planner, parameters_of, planners

__all__ = ["PlannerNode", "main"]


class PlannerNode(Node):
    """Plans each table of targets from where the robots' encoders say they are.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, **options):
        super().__init__("planner", **options)
        about = ParameterDescriptor(description=f"one of {', '.join(planners())}")
        name = self.declare_parameter("planner", DEFAULT_PLANNER, about).value
        settings = {
            each: declare_parameters_of(self, parameters_of(each), each) for each in planners()
        }
        chosen = dataclasses.asdict(settings[name]) if name in settings else {}
        self._planner = make_planner(name, **chosen)
        self._stamp: PlanStamp | None = None
        self._report = Reporter(self, "planner")
        self._view = PlaneCache(self, self._report)
        self._held = topics.HELD_BY_PLANNER.publisher(self)
        self._trajectory = topics.TRAJECTORY.publisher(self)
        topics.TARGETS.subscription(self, self._on_targets)

    def _on_targets(self, message):
        try:
            stamp = PlanStamp.of(message)
            ids, xy_mm = targets.decode(message)
        except FiberError as error:
            self._report.refuse(f"targets refused: {error}")
            return
        self._view.when_new_enough(stamp, lambda: self._take(stamp, ids, xy_mm))

    def _take(self, stamp, ids, xy_mm):
        try:
            if self._stamp is not None and stamp <= self._stamp:
                self._report.drop(f"targets {stamp} dropped: plan {self._stamp} is not older")
                return
            if self._view.moving:
                self._report.refuse(f"targets {stamp} refused: robots are moving")
                return
            plane, start = self._view.plane, self._view.angles
            assignment = assign(plane, start, ids, xy_mm)
            self._stamp = stamp
            self._plan(Problem(plane, start, assignment.targets), assignment, stamp)
        except FiberError as error:
            self._report.refuse(f"targets refused: {error}")

    def _plan(self, problem, assignment, stamp):
        for robot in assignment.refused_ids:
            self.get_logger().warning(f"plan {stamp}: {assignment.explain(int(robot))}")
        planned = self._planner.plan(
            problem, lambda fraction, text: self._report.progress(stamp, fraction, text)
        )
        reason = np.where(assignment.refused, assignment.reason, planned.reason)
        holds = ~np.isin(reason, (Reason.OK, Reason.NO_TARGET))
        ids = problem.plane.ids
        self._warn_of(planned.tangled, ids, stamp)
        self._held.publish(held.encode(ids[holds], reason[holds], Stage.PLANNER, stamp))
        self._trajectory.publish(trajectory.encode(ids, planned.motion, stamp))
        arriving, makespan_s = int((reason == Reason.OK).sum()), planned.motion.makespan_s
        self._report.counters |= {
            "plan": stamp,
            "arriving": arriving,
            "held": int(holds.sum()),
            "tangled": len(planned.tangled),
            "makespan_s": f"{makespan_s:.3f}",
        }
        self._report.done(
            stamp, f"{arriving} robots arrive in {makespan_s:.2f} s, {holds.sum()} held"
        )

    def _warn_of(self, tangled, ids, stamp):
        for pair in tangled:
            names = " and ".join(
                f"robot {ids[row]}" if row < len(ids) else f"obstacle {row - len(ids)}"
                for row in pair
            )
            self.get_logger().warning(f"plan {stamp}: {names} start too close to each other")


def main(args=None) -> int:
    """Run the planner until it is interrupted."""
    return run(PlannerNode, args)
