"""The discretizer as a node: a trajectory in, certified segments in whole wire units out."""

import numpy as np
from rclpy.node import Node

from fiber_core.clearance import Safety
from fiber_core.errors import FiberError
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_discretizer.discretize import discretize
from fiber_discretizer.joint_corridors import joint_corridors
from fiber_discretizer.options import DiscretizeOptions
from fiber_msgs_py import (
    Attempt,
    MessageError,
    PlanStamp,
    Stage,
    corridors,
    held,
    segments,
    topics,
    trajectory,
)
from fiber_node import AttemptListener, PlaneCache, Reporter, declare_parameters, run

__all__ = ["DiscretizerNode", "main"]


class DiscretizerNode(Node):
    """Turn each trajectory, of whatever planner, into orders that are proven safe.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, **options):
        super().__init__("discretizer", **options)
        self._options = declare_parameters(self, DiscretizeOptions)
        self._safety = declare_parameters(self, Safety, "safety")
        self._newest: Attempt | None = None
        self._report = Reporter(self, "discretizer")
        self._view = PlaneCache(self, self._report)
        self._attempts = AttemptListener(self)
        self._held = topics.HELD_BY_DISCRETIZER.publisher(self)
        self._segments = topics.SEGMENTS.publisher(self)
        self._corridors = topics.CORRIDORS.publisher(self)
        topics.TRAJECTORY.subscription(self, self._on_trajectory)

    def _on_trajectory(self, message):
        try:
            stamp = PlanStamp.of(message)
        except FiberError as error:
            self._report.refuse(f"trajectory refused: {error}")
            return
        started = self._attempts.when_announced(
            stamp,
            lambda attempt: self._view.when_current(attempt, lambda: self._take(attempt, message)),
        )
        if not started:
            self._report.waiting(f"trajectory {stamp} waits for targets with its stamp")

    def _take(self, attempt, message):
        try:
            newest = self._newest
            if newest is not None and attempt.stamp <= newest.stamp:
                self._report.drop(f"trajectory {attempt} dropped: plan {newest} is not older")
                return
            ids, motion, velocities = trajectory.decode(message)
            motion, velocities = self._of_whole_plane(ids, motion, velocities)
            done = discretize(
                self._view.plane,
                motion,
                self._view.units,
                self._safety,
                self._view.units.to_counts(self._view.angles),
                self._options,
                lambda fraction, text: self._report.progress(attempt, fraction, text),
                velocities,
            )
            self._newest = attempt
            self._publish(done, self._view.plane.ids, attempt)
        except FiberError as error:
            self._report.refuse(f"trajectory refused: {error}")

    def _of_whole_plane(self, ids, motion, velocities):
        """The motion, and its velocities if any, with robots it does not mention at rest."""
        rows = self._view.plane.index_of(ids)
        if (rows < 0).any():
            raise MessageError("trajectory", "is not in the layout", robot=int(ids[rows < 0][0]))
        angles = np.repeat(self._view.angles[:, :, None], len(motion.time_s), axis=2)
        angles[rows] = motion.angles
        if velocities is not None:
            of_all = np.zeros_like(angles)
            of_all[rows] = velocities
            velocities = of_all
        return SampledMotion(motion.time_s, angles), velocities

    def _publish(self, done, ids, attempt):
        stamp = attempt.stamp
        holds = done.reason != Reason.OK
        self._held.publish(held.encode(ids[holds], done.reason[holds], Stage.DISCRETIZER, stamp))
        self._segments.publish(segments.encode(ids, done.wire, stamp))
        if not done.certificate.ok:
            names = ids[done.certificate.unsafe_robots].tolist()
            self.get_logger().warning(f"plan {attempt}: robots {names} stand too close and rest")
        counts = np.diff(done.wire.offsets)
        moving = int((counts.reshape(-1, 2) > 0).any(axis=1).sum())
        clearance = f"{done.certificate.min_gap_mm:.4f}"
        self._report.counters |= {
            "plan": attempt,
            "moving": moving,
            "held": int(holds.sum()),
            "segments": int(counts.sum()),
            "clearance_mm": clearance,
        }
        self._report.done(
            attempt,
            f"{moving} robots move, {holds.sum()} held, {counts.sum()} segments, "
            f"least clearance {clearance} mm",
        )
        if self._corridors.get_subscription_count():  # they take longer than the rest
            room = joint_corridors(self._view.plane, done.wire.decoded(), self._safety)
            self._corridors.publish(corridors.encode(ids, room, stamp))


def main(args=None) -> int:
    """Run the discretizer until it is interrupted."""
    return run(DiscretizerNode, args)
