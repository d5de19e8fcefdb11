"""A live view of the focal plane for RViz, Foxglove and PlotJuggler; costs nothing unwatched.

A process of its own that asks the graph for nothing. As long as nobody listens to what it
publishes it does not even listen to the joint states.
"""

import time

import numpy as np
from geometry_msgs.msg import Point
from rclpy.node import Node
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from fiber_core.errors import FiberError
from fiber_msgs_py import FRAME_ID, PlanStamp, joint_states, layout, outcome, qos, targets, topics
from fiber_msgs_py.point_clouds import (
    ViewState,
    arms_cloud,
    plane_cloud,
    points_cloud,
    view_states,
)
from fiber_msgs_py.table import encode_table
from fiber_node import Reporter, run
from fiber_viewer.outlines import outlines

__all__ = ["WATCHED", "ViewerNode", "main"]

WATCHED = topics.Topic(f"{topics.NAMESPACE}/view/watched", MarkerArray, qos.LATEST)

_LONGEST_S = 0.15  # arms are drawn where their speed takes them for this long after a reading
_LINE_M = 1.5e-4
_COLOR = ColorRGBA(r=0.9, g=0.62, b=0.0, a=1.0)


class ViewerNode(Node):
    """Publishes points along all arms, and outlines of a few robots that are watched.

    Between two readings of the encoders an arm is where its speed takes it.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, **options):
        super().__init__("viewer", **options)
        rate = self.declare_parameter("rate_hz", 20.0).value
        self.declare_parameter("watch", [0])  # ids; read at each picture, so it may be set
        self._plane = self._outcome = self._states = self._shown = self._listening = None
        self._heard_s = 0.0
        self._report = Reporter(self, "viewer")
        self._report.counters["pictures"] = 0
        self._arms, self._watched = topics.VIEW_ARMS.publisher(self), WATCHED.publisher(self)
        self._plane_points, self._targets = (
            topics.VIEW_PLANE.publisher(self),
            topics.VIEW_TARGETS.publisher(self),
        )
        topics.LAYOUT.subscription(self, self._on_layout)
        topics.TARGETS.subscription(self, self._on_targets)
        topics.OUTCOME.subscription(self, self._on_outcome)
        self.create_timer(1.0 / rate, self._tick)

    def _on_layout(self, message):
        try:
            self._plane = layout.decode(message)[0]
        except FiberError as error:
            self._report.refuse(f"layout refused: {error}")
            return
        self._outcome = self._states = None
        self._publish(self._plane_points, plane_cloud(self._plane))

    def _on_targets(self, message):
        try:
            if targets.decode_attempt(message).number > 1:
                return  # some of the targets that are shown already
            xy_mm = targets.decode(message)[1]
        except FiberError:
            return  # the planner says so
        self._outcome = None
        self._publish(self._targets, points_cloud(xy_mm, ViewState.REACHED))

    def _on_outcome(self, message):
        try:
            ids, ended, _, _ = outcome.decode(message)
        except FiberError as error:
            self._report.refuse(f"outcome refused: {error}")
            return
        if self._plane is not None and np.array_equal(ids, self._plane.ids):
            self._outcome, self._shown = ended, None

    def _on_joint_states(self, message):
        try:
            self._states = joint_states.decode(message)
        except FiberError as error:
            self._report.refuse(f"joint states refused: {error}")
            return
        self._heard_s, self._shown = time.monotonic(), None

    def _tick(self):
        listeners = self._arms.get_subscription_count(), self._watched.get_subscription_count()
        wanted = any(listeners)
        if wanted and self._listening is None:
            self._listening = topics.JOINT_STATES.subscription(self, self._on_joint_states)
        elif not wanted and self._listening is not None:
            self.destroy_subscription(self._listening)
            self._listening = self._states = None
        if not wanted or self._plane is None or self._states is None:
            return
        ids, angles, speeds, _ = self._states
        moving = speeds.any(axis=1)
        if not np.array_equal(ids, self._plane.ids):
            return
        picture = self._states[3], list(self.get_parameter("watch").value), listeners
        if self._shown == picture and not moving.any():
            return  # nothing has changed, and nobody came
        self._shown = picture
        since = min(time.monotonic() - self._heard_s, _LONGEST_S)
        self._show(angles + since * speeds, moving)

    def _show(self, angles, moving):
        self._report.counters["pictures"] += 1
        if self._arms.get_subscription_count():
            states = view_states(self._plane, moving, self._outcome)
            self._publish(self._arms, arms_cloud(self._plane, angles, states))
        if self._watched.get_subscription_count():
            self._watched.publish(self._markers(angles))

    def _markers(self, angles) -> MarkerArray:
        ids = np.array(self.get_parameter("watch").value, dtype=np.int64)
        header = Header(frame_id=FRAME_ID, stamp=self.get_clock().now().to_msg())
        found = [Marker(header=header, action=Marker.DELETEALL)]  # who is no longer watched
        for row in self._plane.index_of(ids).tolist():
            for link, line in enumerate(outlines(self._plane, row, angles) if row >= 0 else ()):
                name = f"{self._plane.ids[row]}"
                marker = Marker(header=header, ns=name, id=link, type=Marker.LINE_STRIP)
                marker.scale.x, marker.color = _LINE_M, _COLOR
                marker.pose.orientation.w = 1.0
                marker.points = [Point(x=x, y=y) for x, y in (line * 1e-3).tolist()]
                found.append(marker)
        return MarkerArray(markers=found)

    def _publish(self, publisher, rows):
        publisher.publish(encode_table(rows, PlanStamp(self.get_clock().now().nanoseconds)))


def main(args=None) -> int:
    """Run the viewer until it is interrupted."""
    return run(ViewerNode, args)
