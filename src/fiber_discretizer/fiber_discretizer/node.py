"""The discretizer as a node: a trajectory in, certified segments in whole wire units out."""

from functools import partial
from typing import Any

from trajectory_msgs.msg import JointTrajectory

from fiber_core.clearance import Safety
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_discretizer.discretize_stage import DiscretizeStageResult, discretize_trajectory
from fiber_discretizer.joint_corridors import joint_corridors
from fiber_discretizer.options import DiscretizeOptions
from fiber_msgs_py import Attempt, PlanStamp, Stage, corridors, held, segments, topics, trajectory
from fiber_node import AttemptListener, PlaneCache, PlaneNode, Reporter, run

__all__ = ["DiscretizerNode", "main"]


class DiscretizerNode(PlaneNode):
    """Turns each trajectory, of any planner, into orders that are proven safe.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, **options: Any):
        super().__init__("discretizer", **options)
        self._options = self.parameters.declare(DiscretizeOptions)
        self._safety = self.parameters.declare(Safety, "safety")
        self.parameters.finish()
        self._newest: Attempt | None = None
        self._report = Reporter(self, "discretizer")
        self._plane_cache = PlaneCache(self, self._report)
        self._attempts = AttemptListener(self)
        self._held = topics.HELD_BY_DISCRETIZER.publisher(self)
        self._segments = topics.SEGMENTS.publisher(self)
        self._corridors = topics.CORRIDORS.publisher(self)
        self._worker = self.worker("discretizing")
        self._worker.follow_stop(self._report, self._is_done)
        topics.TRAJECTORY.subscription(self, self._on_trajectory)

    def _on_trajectory(self, message: JointTrajectory) -> None:
        try:
            stamp = PlanStamp.of(message)
        except FiberError as error:
            self._report.refuse(f"trajectory refused: {error}", "trajectory")
            return

        def discretize_when_current(attempt: Attempt) -> None:
            work = partial(self._discretize, attempt, message)
            self._plane_cache.when_current(attempt, lambda: self._worker.submit(attempt, work))

        if not self._attempts.when_announced(stamp, discretize_when_current):
            self._report.waiting(f"trajectory {stamp} waits for targets with its stamp")

    def _is_done(self, attempt: Attempt) -> bool:
        return self._newest is not None and attempt.stamp <= self._newest.stamp

    def _discretize(self, attempt: Attempt, message: JointTrajectory) -> None:
        try:
            newest = self._newest
            if newest is not None and attempt.stamp <= newest.stamp:
                self._report.drop(
                    f"trajectory {attempt} dropped: plan {newest} is not older", "trajectory"
                )
                return
            ids, motion, velocities = trajectory.decode(message)
            safety, state = self._safety.value, self._plane_cache.state
            result = discretize_trajectory(
                state.plane,
                state.angles,
                ids,
                motion,
                state.units,
                safety,
                options=self._options.value,
                progress=self._report.progress_of(attempt, self._worker.check),
                velocities=velocities,
            )
            self._worker.check()
            self._newest = attempt
            self._publish(result, state.plane, safety, attempt)
        except FiberError as error:
            self._report.refuse(f"trajectory refused: {error}", "trajectory")

    def _publish(
        self, result: DiscretizeStageResult, plane: FocalPlane, safety: Safety, attempt: Attempt
    ) -> None:
        # corridors take longer than all the rest, and are computed when the orders are out
        corridors_wanted = self._corridors.get_subscription_count() > 0
        ids = plane.ids
        wire, certificate = result.discretization.wire, result.discretization.certificate
        reason, is_held, stamp = result.reason, result.held, attempt.stamp
        self._held.publish(held.encode(ids[is_held], reason[is_held], Stage.DISCRETIZER, stamp))
        self._segments.publish(segments.encode(ids, wire, stamp))
        if not certificate.ok:
            robots = ids[certificate.unsafe_robots].tolist()
            self.get_logger().warning(
                f"plan {attempt}: robots {robots} stand too close to a neighbour and rest"
            )
        moving = int(wire.moves.sum())
        clearance = f"{certificate.min_gap_mm:.4f}"
        self._report.counters |= {
            "plan": attempt,
            "moving": moving,
            "held": int(is_held.sum()),
            "segments": len(wire.ticks),
            "clearance_mm": clearance,
        }
        self._report.done(
            attempt,
            f"{moving} robots move, {is_held.sum()} held, {len(wire.ticks)} segments, "
            f"least clearance {clearance} mm",
        )
        if corridors_wanted:
            found = joint_corridors(plane, wire.decoded(), safety)
            self._corridors.publish(corridors.encode(ids, found, stamp))


def main(args: list[str] | None = None) -> int:
    """Run the discretizer until it is interrupted."""
    return run(DiscretizerNode, args)
