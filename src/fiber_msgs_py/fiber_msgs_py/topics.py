"""Every topic and service of the graph: its name, its message type, its quality of service."""

from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState, PointCloud2
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from fiber_msgs_py import qos

__all__ = [
    "CLEAR",
    "CONFIGURE",
    "DIAGNOSTICS",
    "FRAMES",
    "HELD_BY_DISCRETIZER",
    "HELD_BY_PLANNER",
    "HOME",
    "JOINT_STATES",
    "LAYOUT",
    "CORRIDORS",
    "NAMESPACE",
    "OUTCOME",
    "PROGRESS",
    "SEGMENTS",
    "START",
    "STOP",
    "TARGETS",
    "TRAJECTORY",
    "Service",
    "Topic",
    "VIEW_ARMS",
    "VIEW_PLANE",
    "VIEW_TARGETS",
]

NAMESPACE = "focal_plane"


@dataclass(frozen=True)
class Topic:
    """A topic: how it is called, what it carries, and how it is published or heard.

    Args:
        name: its name; relative, so that a namespace makes a second graph.
        type: message class.
        qos: quality of service, the same for both sides.
    """

    name: str
    type: type
    qos: QoSProfile

    def publisher(self, node, **options):
        """Return a new publisher of a node; options as for Node.create_publisher."""
        return node.create_publisher(self.type, self.name, self.qos, **options)

    def subscription(self, node, callback, **options):
        """Return a new subscription of a node; options as for Node.create_subscription."""
        return node.create_subscription(self.type, self.name, callback, self.qos, **options)


@dataclass(frozen=True)
class Service:
    """A service: how it is called and what it answers.

    Args:
        name: its name; relative, so that a namespace makes a second graph.
        type: service class.
    """

    name: str
    type: type

    def server(self, node, callback, **options):
        """Return a new service of a node; options as for Node.create_service."""
        return node.create_service(self.type, self.name, callback, **options)

    def client(self, node, **options):
        """Return a new client of a node; options as for Node.create_client."""
        return node.create_client(self.type, self.name, **options)


def _topic(name, type, profile) -> Topic:
    return Topic(f"{NAMESPACE}/{name}", type, profile)


def _service(name, type) -> Service:
    return Service(f"{NAMESPACE}/{name}", type)


LAYOUT = _topic("layout", PointCloud2, qos.LATEST)
TARGETS = _topic("targets", PointCloud2, qos.EVENTS)
TRAJECTORY = _topic("trajectory", JointTrajectory, qos.LATEST)
SEGMENTS = _topic("segments", PointCloud2, qos.LATEST)
FRAMES = _topic("frames", PointCloud2, qos.STREAM)
JOINT_STATES = _topic("joint_states", JointState, qos.LATEST)
CORRIDORS = _topic("corridors", PointCloud2, qos.LATEST)
OUTCOME = _topic("outcome", PointCloud2, qos.RESULTS)
PROGRESS = _topic("progress", DiagnosticStatus, qos.STREAM)
DIAGNOSTICS = Topic("/diagnostics", DiagnosticArray, qos.EVENTS)

# One topic per stage: an empty table cannot say whose it is, and two latched writers on
# one topic of depth 1 would hide each other from a reader.
HELD_BY_PLANNER = _topic("held/planner", PointCloud2, qos.LATEST)
HELD_BY_DISCRETIZER = _topic("held/discretizer", PointCloud2, qos.LATEST)

# What a live view draws: points along arms, centres, targets.
VIEW_ARMS = _topic("view/arms", PointCloud2, qos.LATEST)
VIEW_PLANE = _topic("view/plane", PointCloud2, qos.LATEST)
VIEW_TARGETS = _topic("view/targets", PointCloud2, qos.LATEST)

START = _service("start", Trigger)
STOP = _service("stop", Trigger)
HOME = _service("home", Trigger)
CLEAR = _service("clear", Trigger)
CONFIGURE = _service("configure", Trigger)
