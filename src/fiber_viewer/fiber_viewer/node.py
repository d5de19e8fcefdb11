# SPDX-License-Identifier: Apache-2.0
"""The node `viewer`: a live view of the focal plane for RViz, Foxglove and PlotJuggler.

The viewer is a process of its own, and the other nodes do not depend on it. It subscribes to the
joint states only while its own topics have subscribers, so an unused viewer costs nothing.
"""

import time
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from geometry_msgs.msg import Point
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from fiber_core.array_types import Angles, Codes, Mask
from fiber_core.bounds import Range, check_ranges
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_msgs_py import (
    PlanStamp,
    guarded,
    joint_states,
    layout,
    outcome,
    qos,
    targets,
    topics,
)
from fiber_msgs_py.point_clouds import (
    ViewState,
    arms_cloud,
    plane_cloud,
    points_cloud,
    view_states,
)
from fiber_msgs_py.table import encode_table
from fiber_node import PlaneNode, Reporter, SessionGate, run
from fiber_viewer.outlines import outlines

__all__ = ["WATCHED", "ViewerNode", "main"]

WATCHED = topics.Topic(
    f"{topics.NAMESPACE}/view/watched",
    MarkerArray,
    qos.LATEST,
    "Outlines of the robots of the parameter `watch`.",
)

_LONGEST_EXTRAPOLATION_S = 0.15  # after a reading of the encoders
_LINE_M = 1.5e-4
_COLOR = ColorRGBA(r=0.9, g=0.62, b=0.0, a=1.0)


@dataclass(frozen=True)
class ViewRate:
    """How often the view is drawn.

    Args:
        rate_hz: pictures a second while robots move [Hz].

    Raises:
        FiberError: the rate is no number or out of bounds.
    """

    RANGES: ClassVar = {"rate_hz": Range(0.01, 1000.0)}

    rate_hz: float = 20.0

    def __post_init__(self) -> None:
        check_ranges(self, self.RANGES, FiberError)


@dataclass(frozen=True)
class WatchedRobots:
    """The robots that are shown with their outlines.

    Args:
        watch: ids of the robots that are shown with their outlines; an id that no robot has
            shows none.
    """

    watch: tuple[int, ...] = (0,)


class ViewerNode(PlaneNode):
    """Publishes points along all arms, and outlines of a few watched robots.

    Between two readings of the encoders, arms are extrapolated with their velocities.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, **options: Any):
        super().__init__("viewer", **options)
        rate = self.parameters.declare(ViewRate, read_only=True).value
        self._watch = self.parameters.declare(WatchedRobots, effect="in the next picture")
        self.parameters.finish()
        self._plane: FocalPlane | None = None
        self._outcome: Codes | None = None
        self._states: tuple[Any, ...] | None = None
        self._shown: tuple[object, ...] | None = None
        self._joint_states_subscription = None
        self._received_s = 0.0
        self._report = Reporter(self, "viewer")
        self._pictures = 0
        self._report.counters["pictures"] = 0
        self._arms = topics.VIEW_ARMS.publisher(self)
        self._watched = WATCHED.publisher(self)
        self._plane_points = topics.VIEW_PLANE.publisher(self)
        self._targets = topics.VIEW_TARGETS.publisher(self)
        self._gate = SessionGate(self, self._report.refuse_message)
        self._gate.subscription(topics.LAYOUT, self._on_layout)
        self._gate.subscription(topics.TARGETS, self._on_targets)
        self._gate.subscription(topics.OUTCOME, self._on_outcome)
        self.create_timer(
            1.0 / rate.rate_hz,
            guarded(self, "view", self._on_timer),
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )
        self.get_logger().info(
            f"waits for a bridge and for subscribers, to show {rate.rate_hz:g} pictures a second"
        )

    def _on_layout(self, message: PointCloud2) -> None:
        try:
            self._plane = layout.decode(message)[0]
        except FiberError as error:
            self._report.refuse(f"layout refused: {error}", "layout")
            return
        self._outcome = self._states = None
        self._report.info(f"the plane has come: {self._plane.n} robots")
        self._publish(self._plane_points, plane_cloud(self._plane))

    def _on_targets(self, message: PointCloud2) -> None:
        try:
            if targets.decode_attempt(message).number > 1:
                return  # some of the targets that are shown already
            xy_mm = targets.decode(message)[1]
        except FiberError:
            return  # the planner reports the error
        self._outcome = None
        self._publish(self._targets, points_cloud(xy_mm, ViewState.REACHED))

    def _on_outcome(self, message: PointCloud2) -> None:
        try:
            ids, outcomes, _, _ = outcome.decode(message)
        except FiberError as error:
            self._report.refuse(f"outcome refused: {error}", "outcome")
            return
        if self._plane is not None and np.array_equal(ids, self._plane.ids):
            self._outcome, self._shown = outcomes, None

    def _on_joint_states(self, message: JointState) -> None:
        try:
            self._states = joint_states.decode(message)
        except FiberError as error:
            self._report.refuse(f"joint states refused: {error}", "joint_states")
            return
        self._received_s, self._shown = time.monotonic(), None

    def _on_timer(self) -> None:
        subscribers = self._arms.get_subscription_count(), self._watched.get_subscription_count()
        self._listen_to_joint_states(any(subscribers))
        plane, states = self._plane, self._states
        if not any(subscribers) or plane is None or states is None:
            return
        ids, angles, speeds, time_ns = states
        moving = speeds.any(axis=1)
        if not np.array_equal(ids, plane.ids):
            return
        picture = time_ns, self._watched_ids(), subscribers
        if self._shown == picture and not moving.any():
            return  # the picture that all subscribers have is still right
        self._shown = picture
        passed_s = min(time.monotonic() - self._received_s, _LONGEST_EXTRAPOLATION_S)
        self._publish_picture(plane, angles + passed_s * speeds, moving)

    def _listen_to_joint_states(self, wanted: bool) -> None:
        subscription = self._joint_states_subscription
        if wanted and subscription is None:
            self._report.debug("there are subscribers: joint states are followed")
            self._joint_states_subscription = self._gate.subscription(
                topics.JOINT_STATES, self._on_joint_states
            )
        elif not wanted and subscription is not None:
            self._report.debug("no subscriber is left: joint states are left alone")
            self.destroy_subscription(subscription)
            self._joint_states_subscription = self._states = None

    def _watched_ids(self) -> list[int]:
        return list(self._watch.value.watch)

    def _publish_picture(self, plane: FocalPlane, angles: Angles, moving: Mask) -> None:
        self._pictures += 1
        self._report.counters["pictures"] = self._pictures
        if self._arms.get_subscription_count():
            states = view_states(plane, moving, self._outcome)
            self._publish(self._arms, arms_cloud(plane, angles, states))
        if self._watched.get_subscription_count():
            self._watched.publish(self._markers(plane, angles))

    def _markers(self, plane: FocalPlane, angles: Angles) -> MarkerArray:
        ids = np.array(self._watched_ids(), dtype=np.int64)
        header = Header(frame_id=topics.frame_of(self), stamp=self.get_clock().now().to_msg())
        # first delete the outlines of robots that are not watched any more
        markers = [Marker(header=header, action=Marker.DELETEALL)]
        for row in plane.index_of(ids).tolist():
            for arm, line in enumerate(outlines(plane, row, angles) if row >= 0 else ()):
                name = f"{plane.ids[row]}"
                marker = Marker(header=header, ns=name, id=arm, type=Marker.LINE_STRIP)
                marker.scale.x, marker.color = _LINE_M, _COLOR
                marker.pose.orientation.w = 1.0
                marker.points = [Point(x=x, y=y) for x, y in (line * 1e-3).tolist()]
                markers.append(marker)
        return MarkerArray(markers=markers)

    def _publish(self, publisher: Publisher, rows: np.ndarray) -> None:
        publisher.publish(encode_table(rows, PlanStamp(self.get_clock().now().nanoseconds)))


def main(args: list[str] | None = None) -> int:
    """Run the viewer until it is interrupted; return the exit code.

    Args:
        args: arguments for ROS; by default those of the process.
    """
    return run(ViewerNode, args)
