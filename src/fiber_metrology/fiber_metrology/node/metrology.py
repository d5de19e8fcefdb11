# SPDX-License-Identifier: Apache-2.0
"""The metrology as a node: an image of the robots at rest in, where every robot is out."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from sensor_msgs.msg import JointState, PointCloud2
from std_srvs.srv import Trigger

from fiber_core.array_types import Angles, Codes, Floats
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_metrology.centroids import CentroidConfig
from fiber_metrology.errors import ImageError, MetrologyError
from fiber_metrology.exposures import combine
from fiber_metrology.identify import IdentifyConfig
from fiber_metrology.knowledge import DriveErrors, Knowledge
from fiber_metrology.measure import MeasureConfig, Measurement, measure
from fiber_metrology.node.bridge_answer import BridgeAnswer, BridgeSilent
from fiber_metrology.node.camera_intake import CameraIntake
from fiber_metrology.node.motions import Motions, Rest
from fiber_metrology.node.settings import MetrologyConfig
from fiber_metrology.node.turn_images import TurnImages, at_unknown_places
from fiber_metrology.plate import PlateConfig
from fiber_msgs_py import (
    Attempt,
    PlanStamp,
    joint_states,
    layout,
    lights,
    measured,
    session_of,
    targets,
    topics,
)
from fiber_node import AcceptedAttempts, ManagedNode, SessionGate, run

__all__ = ["MetrologyNode", "main"]

_REASONS = 20  # robots that are named in the log after an image
_Response: TypeAlias = Trigger.Response


class MetrologyNode(ManagedNode):
    """Measures where the robots are, whenever the service `measure` is called.

    The service `look` publishes the lights of an image alone, and nothing is learned from it.

    The robots must rest, and the exposures must come after the call. What cannot be used is refused
    with its reason; then nothing is published and nothing is learned.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, **options: Any):
        super().__init__("metrology", "metrology", **options)
        self._config = self.parameters.declare(MetrologyConfig)
        self._drive = self.parameters.declare(DriveErrors, "drive", read_only=True).value
        self._measure = self.parameters.declare(MeasureConfig, "measure")
        self._plate = self.parameters.declare(PlateConfig, "plate")
        self._identify = self.parameters.declare(IdentifyConfig, "identify")
        self._centroids = self.parameters.declare(CentroidConfig, "centroids")
        self.parameters.finish()
        self.begin()

    def configure(self) -> None:
        """Follow the plane, its plans, and the camera."""
        self._plane: FocalPlane | None = None
        self._session: str | None = None
        self._knowledge: Knowledge | None = None
        self._unplaced: Codes = np.zeros(0, dtype=np.int64)
        self._motions, self._turns = Motions(self._begin_motion), TurnImages()
        gate = SessionGate(self, self.reporter.refuse_message)
        self._accepted = AcceptedAttempts(self, gate)
        gate.subscription(topics.LAYOUT, self._refusing("layout", self._on_layout))
        gate.subscription(topics.JOINT_STATES, self._refusing("states", self._on_joint_states))
        gate.subscription(topics.OUTCOME, self._refusing("outcome", self._on_outcome))
        topics.TARGETS.subscription(self, self._refusing("targets", self._on_targets))
        self._camera = CameraIntake(self, self._config, self._centroids, self._refusing)
        self._answer = BridgeAnswer(self)
        self._measured = topics.MEASURED.publisher(self)
        self._lights = topics.LIGHTS.publisher(self)
        own = MutuallyExclusiveCallbackGroup()  # it waits for the camera and the bridge
        topics.MEASURE.server(self, self._on_measure, callback_group=own)
        topics.LOOK.server(self, self._on_look, callback_group=own)

    def activate(self) -> None:
        """Measure when told to."""
        self.get_logger().info("waits for the service measure")

    def _refusing(self, name: str, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        def receive(message: Any) -> None:
            try:
                callback(message)
            except FiberError as error:
                self.reporter.refuse(f"{name} refused: {error}", name)

        return receive

    # --- the plane and its plans ---------------------------------------------

    def _on_layout(self, message: PointCloud2) -> None:
        plane, session = layout.decode(message)[0], session_of(message)
        with self._motions.lock:
            self._motions.open(session)
            if session != self._session or self._plane is None or self._plane.n != plane.n:
                self._knowledge = Knowledge(plane, self._drive)
            self._plane, self._session = plane, session
            self._unplaced = layout.decode_unplaced(message)

    def _begin_motion(self, angles: Angles, straight: bool) -> None:
        if self._knowledge is not None:
            self._knowledge.begin(angles, straight)

    def _on_joint_states(self, message: JointState) -> None:
        _, angles, velocities, _ = joint_states.decode(message)
        self._motions.hear_states(PlanStamp.of(message).ns, angles, bool(np.any(velocities)))

    def _on_targets(self, message: PointCloud2) -> None:
        straight = targets.decode_straight(message)
        self._accepted.when_accepted(
            PlanStamp.of(message),
            lambda attempt, session: self._motions.hear_accepted(attempt, straight),
        )

    def _on_outcome(self, message: PointCloud2) -> None:
        self._motions.hear_outcome(PlanStamp.of(message))

    # --- an image ------------------------------------------------------------

    def _on_measure(self, request: Any, response: _Response) -> _Response:
        stamp: PlanStamp | None = None
        try:
            rest = self._may_measure()
            stamp = rest.plan
            response.message, response.success = self._measure_now(rest), True
        except FiberError as error:
            text = f"no image: {error}"
            attempt = None if stamp is None else Attempt.first(stamp)
            self.reporter.refuse(text, attempt=attempt)
            response.message, response.success = text, False
        return response

    def _on_look(self, request: Any, response: _Response) -> _Response:
        try:
            response.message, response.success = self._look_now(self._may_measure()), True
        except FiberError as error:
            response.message, response.success = f"no image: {error}", False
            self.reporter.refuse(response.message)
        return response

    def _look_now(self, rest: Rest) -> str:
        calibrated, fiducials = self._camera.calibration()
        taken = self._camera.take(rest.since_ns)
        if not rest.lasts_until(self._motions.at_rest()):
            raise ImageError("the robots were told to move while the camera exposed")
        seen = combine(taken, fiducials, calibrated, self._plate.value)
        table = lights.SeenLights(seen.places, seen.seen, seen.merged)
        self._lights.publish(lights.encode(table, self._stamp_of(rest), rest.session))
        return f"{len(seen.places)} lights"

    def _stamp_of(self, rest: Rest) -> PlanStamp:
        # of the motion that an image follows; before the first one the time of the image
        return PlanStamp(self.get_clock().now().nanoseconds) if rest.plan is None else rest.plan

    def _may_measure(self) -> Rest:
        if not self.active:
            raise MetrologyError("the metrology is inactive: activate it first")
        return self._motions.at_rest()

    def _measure_now(self, rest: Rest) -> str:
        calibrated, fiducials = self._camera.calibration()
        taken = self._camera.take(rest.since_ns)
        if not rest.lasts_until(self._motions.at_rest()):
            raise ImageError("the robots were told to move while the camera exposed")
        with self._motions.lock:
            knowledge = self._knowledge
            if knowledge is None or self._session != rest.session:
                raise ImageError("the bridge has begun anew while the camera exposed")
            unplaced = self._unplaced
            lost = at_unknown_places(unplaced)
            expected = replace(knowledge.expected(rest.counters), unplaced=lost)
        stamp = self._stamp_of(rest)
        begin_s = time.monotonic()
        config = self._measure_config()
        image = measure(expected, taken, fiducials, calibrated, config)
        image = self._turns.find(image, rest.counters, unplaced, rest.session, config)
        took_s = time.monotonic() - begin_s
        wider_mm = knowledge.outlines_off_mm(image)
        try:
            self._answer.wait_after(
                lambda: self._publish(image, wider_mm, stamp, rest.session),
                stamp, self._config.value.timeout_s,
            )  # fmt: skip
        except BridgeSilent:
            self._forget(knowledge)
            raise
        with self._motions.lock:
            knowledge.learn(image)  # after the bridge: both count from the same places
        if not rest.begin_heard:
            self.get_logger().warning(
                f"plan {stamp}: this node was started after the robots moved and did not hear "
                "where they were before: the image names no joint that did not turn"
            )
        return self._report(image, stamp, took_s)

    def _forget(self, knowledge: Knowledge) -> None:
        # the counters may be set to what was measured, later or not at all: what was known of them
        # before serves neither case
        with self._motions.lock:
            if self._knowledge is knowledge:
                self._knowledge = Knowledge(knowledge.plane, self._drive)

    def _measure_config(self) -> MeasureConfig:
        return replace(self._measure.value, plate=self._plate.value, identify=self._identify.value)

    def _publish(
        self, image: Measurement, wider_mm: Floats, stamp: PlanStamp, session: str | None
    ) -> None:
        table = measured.Measured(
            image.plane.ids, image.verdict, image.places, image.angles, image.interval_rad,
            image.error_mm, np.minimum(image.doubt, 1.0), wider_mm,
        )  # fmt: skip
        self._measured.publish(measured.encode(table, stamp, session))

    def _report(self, image: Measurement, stamp: PlanStamp, took_s: float) -> str:
        lines = image.reasons()
        for line in lines[:_REASONS]:
            self.get_logger().warning(line)
        if len(lines) > _REASONS:
            self.get_logger().warning(f"and {len(lines) - _REASONS} robots more")
        residual_um = max(plate.residual_um for plate in image.lights.plates)
        text = (
            f"{image.certain.sum()} of {image.plane.n} robots measured, "
            f"{image.not_moved.sum()} did not move, {len(lines)} named, "
            f"fiducials {residual_um:.1f} um rms"
        )
        self.reporter.counters |= {
            "plan": stamp,
            "measured": int(image.certain.sum()),
            "not_moved": int(image.not_moved.sum()),
            "fiducials_um": f"{residual_um:.2f}",
            "measure_s": f"{took_s:.3f}",
        }
        self.reporter.done(Attempt.first(stamp), text)
        return text


def main(args: list[str] | None = None) -> int:
    """Run the metrology until it is interrupted; return the exit code."""
    return run(MetrologyNode, args)
