# SPDX-License-Identifier: Apache-2.0
"""The discretizer as a node: a trajectory in, certified segments in whole wire units out."""

from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from trajectory_msgs.msg import JointTrajectory

from fiber_core.clearance import Safety
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_discretizer.discretize_stage import DiscretizeStageResult, discretize_trajectory
from fiber_discretizer.joint_corridors import joint_corridors
from fiber_discretizer.options import DiscretizeOptions
from fiber_msgs_py import (
    Attempt,
    PlanStamp,
    Stage,
    corridors,
    held,
    segments,
    session_of,
    topics,
    trajectory,
)
from fiber_node import (
    DISCRETIZER,
    AcceptedAttempts,
    Claim,
    ManagedNode,
    PlaneCache,
    SessionGate,
    run,
)

__all__ = ["DiscretizerNode", "main"]


class DiscretizerNode(ManagedNode):
    """Turns each trajectory, of any planner, into orders that are proven safe.

    It works on the attempts that the bridge has accepted, and stays out while an earlier
    discretizer is in the graph. Configured it follows the plane; active it has the role of the
    discretizer and works; deactivated it ends the work under way, whose plan ends with an outcome
    of the bridge.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, **options: Any):
        super().__init__("discretizer", DISCRETIZER, **options)
        self._options = self.parameters.declare(DiscretizeOptions)
        self._safety = self.parameters.declare(Safety, "safety")
        self.parameters.finish()
        self._newest: Attempt | None = None  # whose orders were published last
        self._claim: Claim | None = None  # while it is active
        self.begin()

    def configure(self) -> None:
        """Follow the plane, and hear trajectories."""
        gate = SessionGate(self, self._refuse_message)
        self._plane_cache = PlaneCache(gate, self.reporter)
        self._accepted = AcceptedAttempts(self, gate)
        self._held = topics.HELD_BY_DISCRETIZER.publisher(self)
        self._segments = topics.SEGMENTS.publisher(self)
        self._corridors = topics.CORRIDORS.publisher(self)
        self._worker = self.worker("discretizing")
        self._worker.follow_stop(self.reporter, self._is_done)
        gate.subscription(topics.TRAJECTORY, self._on_trajectory)
        # a publisher with the default quality of service matches this one alone
        gate.subscription(topics.TRAJECTORY.volatile, self._on_trajectory)

    def activate(self) -> None:
        """Claim the role of the discretizer."""
        self._claim = Claim(self, DISCRETIZER)  # last: the node is complete
        margin = f"a margin of {self._safety.value.margin_mm:g} mm"
        self.get_logger().info(f"waits for a bridge and for trajectories, to certify with {margin}")

    def deactivate(self) -> None:
        """End the work under way, and give up the role."""
        claim, self._claim = self._claim, None
        if claim is not None:
            claim.release()
        for attempt in self._worker.cancel():
            self.reporter.drop(f"plan {attempt}: discretizing ended: the node is deactivated")

    def _refuse_message(self, topic: str, text: str, message: Any) -> None:
        # of the session whose layout has come: its bridge, if it is there, waits for an answer
        ours = topic == "trajectory" and session_of(message) == self.reporter.session
        attempt = None
        if ours and self._claim is not None and not self._claim.earlier():
            with suppress(FiberError):
                attempt = Attempt.first(PlanStamp.of(message))
        self.reporter.refuse(text, topic, attempt)

    def _on_trajectory(self, message: JointTrajectory) -> None:
        try:
            stamp = PlanStamp.of(message)
        except FiberError as error:
            self.reporter.refuse(f"trajectory refused: {error}", "trajectory")
            return

        def discretize_when_current(attempt: Attempt, session: str) -> None:
            if session != session_of(message):
                self.reporter.refuse(
                    f"trajectory {attempt} refused: it belongs to {session_of(message)}, the plan "
                    f"to {session}",
                    "trajectory",
                )
            elif self._claim is None:
                self.reporter.drop(f"trajectory {attempt} not used: this discretizer is inactive")
            elif self._claim.earlier():
                self.reporter.drop(
                    f"trajectory {attempt} left to the discretizer that was here before"
                )
            else:
                work = partial(self._discretize, attempt, session, message)
                self._plane_cache.when_current(
                    attempt, session, lambda: self._worker.submit(attempt, work)
                )

        if self._accepted.has_ended(stamp):
            self.reporter.debug(f"trajectory {stamp} was heard before, or its plan was refused")
            return  # heard before, by the other subscription perhaps
        if not self._accepted.when_accepted(stamp, discretize_when_current):
            self.reporter.waiting(f"trajectory {stamp} waits until the bridge accepts its plan")

    def _is_done(self, attempt: Attempt) -> bool:
        return attempt == self._newest

    def _discretize(self, attempt: Attempt, session: str, message: JointTrajectory) -> None:
        if self._claim is None:
            return  # deactivated while the attempt waited for the plane
        try:
            ids, motion, velocities = trajectory.decode(message)
            safety, state = self._safety.value, self._plane_cache.state
            safety.check_borders(*state.border_skews_s)
            text = f"plan {attempt}: profiles of {len(ids)} robots, {self._options.value.sharing}"
            self.reporter.debug(text)
            result = discretize_trajectory(
                state.plane,
                state.angles,
                ids,
                motion,
                state.units,
                safety,
                options=self._options.value,
                progress=self.reporter.progress_of(attempt, self._worker.check),
                velocities=velocities,
            )
            self._worker.check()
            self._newest = attempt
            self._publish(result, state.plane, safety, attempt, session)
        except FiberError as error:
            self.reporter.refuse(f"trajectory refused: {error}", "trajectory", attempt)

    def _publish(
        self,
        result: DiscretizeStageResult,
        plane: FocalPlane,
        safety: Safety,
        attempt: Attempt,
        session: str,
    ) -> None:
        # corridors take longer than all the rest, and are computed when the orders are out
        corridors_wanted = self._corridors.get_subscription_count() > 0
        ids = plane.ids
        wire, certificate = result.discretization.wire, result.discretization.certificate
        reason, is_held, stamp = result.reason, result.held, attempt.stamp
        self._held.publish(held.encode(ids[is_held], reason[is_held], Stage.DISCRETIZER, stamp))
        self._segments.publish(segments.encode(ids, wire, stamp, session))
        if told := result.discretization.breaches.told(plane.drive, plane.supply, ids):
            first = "; ".join(told[:3])
            self.get_logger().warning(
                f"plan {attempt}: {len(told)} rules of motors or joints are broken: {first}"
            )
        if not certificate.ok:
            robots = ids[certificate.unsafe_robots].tolist()
            self.get_logger().warning(
                f"plan {attempt}: robots {robots} stand too close to a neighbour and rest"
            )
        if (close := certificate.close_at_rest_robots).any():
            self.get_logger().info(
                f"plan {attempt}: disabled robots {ids[close].tolist()} are nearer than the margin "
                f"to something that does not move either"
            )
        moving = int(wire.moves.sum())
        close_pairs = certificate.nearer(plane, wire.decoded().start, safety.margin_mm)
        clearance = f"{certificate.gap_mm[~close_pairs].min(initial=np.inf):.4f}"
        self.reporter.counters |= {
            "plan": attempt,
            "moving": moving,
            "held": int(is_held.sum()),
            "segments": len(wire.ticks),
            "clearance_mm": clearance,
        }
        self.reporter.done(
            attempt,
            f"{moving} robots move, {is_held.sum()} held, {len(wire.ticks)} segments, "
            f"least clearance {clearance} mm"
            + (f", {close_pairs.sum()} pairs nearer from the start" if close_pairs.any() else ""),
        )
        if corridors_wanted:
            found = joint_corridors(plane, wire.decoded(), safety)
            self._corridors.publish(corridors.encode(ids, found, stamp))


def main(args: list[str] | None = None) -> int:
    """Run the discretizer until it is interrupted."""
    return run(DiscretizerNode, args)
