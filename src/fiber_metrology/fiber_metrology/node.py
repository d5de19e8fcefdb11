# SPDX-License-Identifier: Apache-2.0
"""The metrology as a node: an image of the robots at rest in, where every robot is out."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, TypeAlias

import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from sensor_msgs.msg import Image, JointState, PointCloud2
from std_srvs.srv import Trigger

from fiber_core.array_types import Angles, Floats, Points
from fiber_core.bounds import Range, check_ranges
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_metrology.centroids import CentroidConfig, find_spots
from fiber_metrology.errors import ImageError, MetrologyError
from fiber_metrology.identify import IdentifyConfig
from fiber_metrology.knowledge import DriveErrors, Knowledge
from fiber_metrology.measure import MeasureConfig, Measurement, measure
from fiber_metrology.plate import PlateConfig
from fiber_metrology.polynomials import PolynomialMap, fit_map
from fiber_metrology.spots import Spots, checked_spots
from fiber_msgs_py import (
    Attempt,
    PlanStamp,
    images,
    joint_states,
    layout,
    measured,
    session_of,
    spots,
    targets,
    topics,
)
from fiber_node import AcceptedAttempts, ManagedNode, SessionGate, run

__all__ = ["MetrologyNode", "main"]

_STATES_KEPT = 64  # joint states, among which is the one before a motion
_SETTLED_S = 2.0  # longest wait for the outcome and the encoders of a plan that has ended
_REASONS = 20  # robots that are named in the log after an image
_Response: TypeAlias = Trigger.Response


@dataclass(frozen=True)
class MetrologyConfig:
    """How images are taken.

    Args:
        exposures: exposures of one image.
        pixels: whether spots are found in the pixels of the topic camera/image; else lists of
            spots are heard on camera/spots.
        expose: whether the camera is told to expose by the service camera/expose; else the next
            exposures that come are taken.
        timeout_s: longest wait for all exposures of an image [s].
        degree: degree of the map from pixels to the plane that the calibration lights give.

    Raises:
        MetrologyError: a value is out of range; names it.
    """

    RANGES: ClassVar = {
        "exposures": Range(1, 100, whole=True),
        "timeout_s": Range(0.1, 3600.0),
        "degree": Range(1, 9, whole=True),
    }

    exposures: int = 3
    pixels: bool = False
    expose: bool = True
    timeout_s: float = 20.0
    degree: int = 9

    def __post_init__(self) -> None:
        check_ranges(self, self.RANGES, MetrologyError)


class MetrologyNode(ManagedNode):
    """Measures where the robots are, whenever the service `measure` is called.

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
        self._states: dict[int, tuple[Angles, bool]] = {}  # by stamp, whether robots move
        self._waiting: tuple[PlanStamp, int, bool] | None = (
            None  # a motion whose joint states have not come
        )
        self._stamp: PlanStamp | None = None  # of the last plan that has ended
        self._begun: PlanStamp | None = None  # of the last plan that was accepted
        self._heard_rest = True  # the encoders were heard at rest since that plan ended
        self._map: PolynomialMap | None = None
        self._fiducials: Points = np.zeros((0, 2))
        self._exposures: list[Spots | Exception] = []
        self._came = threading.Condition()
        self._state_lock = threading.Condition()
        gate = SessionGate(self, lambda topic, text: self.reporter.refuse(text, topic))
        self._accepted = AcceptedAttempts(self, gate)
        gate.subscription(topics.LAYOUT, self._refusing("layout", self._on_layout))
        gate.subscription(topics.JOINT_STATES, self._refusing("states", self._on_joint_states))
        gate.subscription(topics.OUTCOME, self._refusing("outcome", self._on_outcome))
        topics.TARGETS.subscription(self, self._refusing("targets", self._on_targets))
        topics.CALIBRATION.subscription(self, self._refusing("calibration", self._on_calibration))
        camera = MutuallyExclusiveCallbackGroup()
        for topic, pixels in ((topics.SPOTS, False), (topics.IMAGE, True)):
            if pixels == self._config.value.pixels:
                topic.subscription(self, self._on_exposure, callback_group=camera)
        self._expose = topics.EXPOSE.client(self, callback_group=ReentrantCallbackGroup())
        self._measured = topics.MEASURED.publisher(self)
        own = MutuallyExclusiveCallbackGroup()  # it waits for the camera
        topics.MEASURE.server(self, self._on_measure, callback_group=own)

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
        with self._state_lock:
            if session != self._session:
                self._states.clear()
                self._knowledge, self._stamp, self._waiting = None, None, None
                self._begun, self._heard_rest = None, True
            if self._knowledge is None or self._plane is None or self._plane.n != plane.n:
                self._knowledge = Knowledge(plane, self._drive)
            self._plane, self._session = plane, session

    def _on_joint_states(self, message: JointState) -> None:
        _, angles, velocities, _ = joint_states.decode(message)
        with self._state_lock:
            self._states[PlanStamp.of(message).ns] = angles, bool(np.any(velocities))
            for old in sorted(self._states)[:-_STATES_KEPT]:
                del self._states[old]
            self._heard_rest |= not np.any(velocities)
            self._begin_motion()
            self._state_lock.notify_all()

    def _on_targets(self, message: PointCloud2) -> None:
        straight = targets.decode_straight(message)

        def accepted(attempt: Attempt, session: str) -> None:
            with self._state_lock:
                self._begun = max(attempt.plan, self._begun or attempt.plan)
                if attempt.since_ns is not None and attempt.number == 1:
                    self._waiting = attempt.plan, attempt.since_ns, straight
                    self._begin_motion()

        self._accepted.when_accepted(PlanStamp.of(message), accepted)

    def _begin_motion(self) -> None:
        # the bridge tells with each plan which joint states it begins at; of these only the newest
        # is sure to come
        if self._waiting is None or self._knowledge is None:
            return
        plan, since_ns, straight = self._waiting
        ended = self._stamp is not None and plan <= self._stamp
        found = [ns for ns in sorted(self._states) if ns >= since_ns and not self._states[ns][1]]
        if ended or not found:  # newer ones may be of after the motion
            found = [ns for ns in sorted(self._states) if ns <= since_ns][-1:] if ended else []
        if found:
            self._knowledge.begin(self._states[found[0]][0], straight)
        if found or ended:
            self._waiting = None

    def _on_outcome(self, message: PointCloud2) -> None:
        with self._state_lock:
            stamp = PlanStamp.of(message)
            self._stamp = stamp if self._stamp is None else max(stamp, self._stamp)
            self._begin_motion()
            self._heard_rest = False
            self._state_lock.notify_all()

    # --- the camera ----------------------------------------------------------

    def _on_calibration(self, message: PointCloud2) -> None:
        plane_mm, place_px, fiducial = spots.decode_calibration(message)
        lights = np.isfinite(place_px).all(axis=1)
        degree = self._config.value.degree
        terms = (degree + 1) * (degree + 2) // 2
        if lights.sum() < terms:
            raise MetrologyError(
                f"{lights.sum()} calibration lights, and a map of degree {degree} has {terms} terms"
            )
        self._map = fit_map(place_px[lights], plane_mm[lights], degree)
        self._fiducials = plane_mm[fiducial]
        text = f"calibration: {lights.sum()} lights, {fiducial.sum()} fiducials"
        self.get_logger().info(text)

    def _on_exposure(self, message: PointCloud2 | Image) -> None:
        found: Spots | Exception
        try:
            if isinstance(message, Image):
                found = find_spots(images.decode(message), self._centroids.value)
            else:
                found = checked_spots(*spots.decode(message))
        except FiberError as error:
            found = error
        with self._came:
            self._exposures.append(found)
            del self._exposures[: -self._config.value.exposures]
            self._came.notify_all()

    def _take_exposures(self) -> list[Spots]:
        config = self._config.value
        until_s = time.monotonic() + config.timeout_s
        with self._came:
            self._exposures.clear()
        if config.expose:
            self._tell_camera(until_s)
        with self._came:
            self._came.wait_for(
                lambda: len(self._exposures) >= config.exposures, until_s - time.monotonic()
            )
            taken = list(self._exposures)
        if len(taken) < config.exposures:
            raise ImageError(
                f"the camera gave {len(taken)} of {config.exposures} exposures in "
                f"{config.timeout_s:g} s"
            )
        for each in taken:
            if isinstance(each, Exception):
                raise each
        return [each for each in taken if isinstance(each, Spots)]

    def _tell_camera(self, until_s: float) -> None:
        if not self._expose.wait_for_service(max(until_s - time.monotonic(), 0.0)):
            raise ImageError("there is no camera in the graph: nothing serves camera/expose")
        answered = threading.Event()
        future = self._expose.call_async(Trigger.Request())
        future.add_done_callback(lambda _: answered.set())
        if not answered.wait(max(until_s - time.monotonic(), 0.0)):
            raise ImageError("the camera does not answer")
        answer = future.result()
        if answer is None or not answer.success:
            raise ImageError(f"the camera did not expose: {answer.message if answer else ''}")

    # --- an image ------------------------------------------------------------

    def _on_measure(self, request: Any, response: _Response) -> _Response:
        stamp = self._stamp
        try:
            response.message, response.success = self._measure_now(), True
        except FiberError as error:
            text = f"no image: {error}"
            attempt = None if stamp is None else Attempt.first(stamp)
            self.reporter.refuse(text, attempt=attempt)
            response.message, response.success = text, False
        return response

    def _measure_now(self) -> str:
        if not self.active:
            raise MetrologyError("the metrology is inactive: activate it first")
        counters, stamp = self._at_rest()
        if self._map is None:
            raise MetrologyError("the camera has sent no calibration")
        taken = self._take_exposures()
        again, newest = self._at_rest()
        if stamp != newest or not np.array_equal(again, counters):
            raise ImageError("the robots were told to move while the camera exposed")
        with self._state_lock:
            knowledge, session, plane = self._knowledge, self._session, self._plane
            assert knowledge is not None and plane is not None
            expected = knowledge.expected(counters)
        stamp = PlanStamp(self.get_clock().now().nanoseconds) if stamp is None else stamp
        begin_s = time.monotonic()
        image = measure(expected, taken, self._fiducials, self._map, self._measure_config())
        took_s = time.monotonic() - begin_s
        with self._state_lock:
            knowledge.learn(image)
            wider_mm = knowledge.outlines_off_mm(image)
        self._publish(image, wider_mm, stamp, session)
        return self._report(image, stamp, took_s)

    def _at_rest(self) -> tuple[Angles, PlanStamp | None]:
        """The counters of robots at rest, and the last plan, None before the first."""
        with self._state_lock:
            if self._plane is None or not self._states:
                raise MetrologyError("no plane is known yet: there is no bridge in the graph")
            # topics overtake each other: a client may know the outcome before this node
            self._state_lock.wait_for(self._has_settled, _SETTLED_S)
            angles, moving = self._states[max(self._states)]
            if moving:
                raise MetrologyError("robots are moving")
            if not self._has_settled():
                raise MetrologyError(f"plan {self._begun} has not ended: start it, or clear")
            return angles, self._stamp

    def _has_settled(self) -> bool:
        ended = self._begun is None or (self._stamp is not None and self._begun <= self._stamp)
        return ended and self._heard_rest and not self._states[max(self._states)][1]

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
