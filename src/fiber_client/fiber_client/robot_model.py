# SPDX-License-Identifier: Apache-2.0
"""The node `robot_model`: the URDF of one robot of a running plane, for RobotModel and tf.

The topic `robot_description` keeps the URDF for subscribers that come later. From it
`robot_state_publisher` makes the static transforms, and the others from the joint states.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from fiber_client.urdf import robot_urdf
from fiber_core.bounds import Range, check_ranges
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_msgs_py import layout, qos, topics
from fiber_node import PlaneNode, Reporter, SessionGate, run

__all__ = ["DESCRIPTION", "RobotModelNode", "main"]

DESCRIPTION = topics.Topic("robot_description", String, qos.LATEST, "URDF of one robot.")


@dataclass(frozen=True)
class ModelledRobot:
    """The robot that is described.

    Args:
        robot_model: id of the robot that is described; -1 for the first of the plane.

    Raises:
        FiberError: the id is no whole number or out of bounds.
    """

    RANGES: ClassVar = {"robot_model": Range(-1, 2**31 - 1, whole=True)}

    robot_model: int = -1

    def __post_init__(self) -> None:
        check_ranges(self, self.RANGES, FiberError)


class RobotModelNode(PlaneNode):
    """Publishes the URDF of one robot of the layout, and again when a layout changes it.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, **options: Any):
        super().__init__("robot_model", **options)
        self._chosen = self.parameters.declare(ModelledRobot, read_only=True).value.robot_model
        self.parameters.finish()
        self._report = Reporter(self, "robot_model")
        self._description, self._published = DESCRIPTION.publisher(self), ""
        gate = SessionGate(self, self._report.refuse_message)
        gate.subscription(topics.LAYOUT, self._on_layout)
        self.get_logger().info("waits for a bridge, to describe a robot")

    def _on_layout(self, message: PointCloud2) -> None:
        try:
            plane: FocalPlane = layout.decode(message)[0]
            robot = int(plane.ids[0]) if self._chosen < 0 else self._chosen
            text = robot_urdf(plane, robot, topics.frame_of(self))
        except FiberError as error:
            self._report.refuse(f"layout refused: {error}", "layout")
            return
        if text == self._published:  # a display would build the model anew
            return
        self._published = text
        self._description.publish(String(data=text))
        described = f"robot {robot} is described on robot_description"
        self._report.info(described)
        self._report.waiting(described)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until it is interrupted."""
    return run(RobotModelNode, args)
