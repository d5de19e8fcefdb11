# SPDX-License-Identifier: Apache-2.0
"""Every topic and service of the graph: name, message type, quality of service."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar, cast

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image, JointState, PointCloud2
from std_msgs.msg import UInt8MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from fiber_msgs_py import qos
from fiber_msgs_py.callback_guard import guarded, guarded_service
from fiber_msgs_py.stamps import FRAME_ID

__all__ = [
    "CALIBRATION",
    "CLEAR",
    "CONFIGURE",
    "CORRIDORS",
    "DIAGNOSTICS",
    "EXPOSE",
    "FRAMES",
    "HELD_BY_DISCRETIZER",
    "HELD_BY_PLANNER",
    "HOME",
    "IMAGE",
    "JOINT_STATES",
    "LAYOUT",
    "LIGHTS",
    "LOOK",
    "MEASURE",
    "MEASURED",
    "NAMESPACE",
    "OUTCOME",
    "PROGRESS",
    "SEGMENTS",
    "SPOTS",
    "START",
    "STOP",
    "STOPPED",
    "FROM_SECTOR",
    "TARGETS",
    "TO_SECTOR",
    "TRAJECTORY",
    "TRUE_PLACES",
    "TURN",
    "TURNS",
    "VIEW_ARMS",
    "VIEW_PLANE",
    "VIEW_TARGETS",
    "Service",
    "Topic",
    "frame_of",
]

NAMESPACE = "focal_plane"

_Made = TypeVar("_Made")
_Made_co = TypeVar("_Made_co", covariant=True)


# The parts of rclpy's Node that make publishers and so on; this package does not import rclpy.node.
class PublisherFactory(Protocol, Generic[_Made_co]):
    """A node that makes publishers."""

    @property
    def create_publisher(self) -> Callable[..., _Made_co]:
        """As Node.create_publisher."""
        ...


class SubscriptionFactory(Protocol, Generic[_Made_co]):
    """A node that makes subscriptions."""

    @property
    def create_subscription(self) -> Callable[..., _Made_co]:
        """As Node.create_subscription."""
        ...


class ServiceFactory(Protocol, Generic[_Made_co]):
    """A node that makes services."""

    @property
    def create_service(self) -> Callable[..., _Made_co]:
        """As Node.create_service."""
        ...


class ClientFactory(Protocol, Generic[_Made_co]):
    """A node that makes clients of services."""

    @property
    def create_client(self) -> Callable[..., _Made_co]:
        """As Node.create_client."""
        ...


def frame_of(node: Any) -> str:
    """Return the frame of the plane of a node: `focal_plane`, after the namespace of the node."""
    return f"{node.get_namespace()}/{FRAME_ID}".lstrip("/")


class _InFrame:
    # a publisher that puts messages of the frame `focal_plane` into the frame of its own plane

    def __init__(self, publisher: Any, frame: str):
        self._publisher, self._frame = publisher, frame

    def __getattr__(self, name: str) -> Any:
        return getattr(self._publisher, name)

    def publish(self, message: Any) -> None:
        header = getattr(message, "header", None)
        if header is not None and header.frame_id == FRAME_ID:
            header.frame_id = self._frame
        self._publisher.publish(message)


@dataclass(frozen=True)
class Topic:
    """A topic with its message type and its quality of service.

    Args:
        name: its name, relative, so that a second graph can run in a namespace.
        type: message class.
        qos: quality of service of publishers and subscriptions.
        about: its content, for people.
        queued: whether a subscription keeps many messages until they are read, so that those of
            strangers push out none; False where a later message makes up for it, or each is large.
    """

    name: str
    type: type
    qos: QoSProfile
    about: str = ""
    queued: bool = True

    @property
    def volatile(self) -> "Topic":
        """The same topic, of which a subscription also hears publishers that keep no message.

        Publishers with the default quality of service are such; from others it gets no message
        from before it came.
        """
        return replace(self, qos=qos.EVENTS)

    def publisher(self, node: PublisherFactory[_Made], **options: object) -> _Made:
        """Return a new publisher of a node; options as for Node.create_publisher.

        A node in a namespace publishes in the frame of its own plane.
        """
        publisher = node.create_publisher(self.type, self.name, self.qos, **options)
        frame = frame_of(node)
        return publisher if frame == FRAME_ID else cast(_Made, _InFrame(publisher, frame))

    def subscription(
        self, node: SubscriptionFactory[_Made], callback: Callable[[Any], None], **options: object
    ) -> _Made:
        """Return a new subscription of a node; options as for Node.create_subscription.

        An exception that escapes the callback is reported and does not end the node.
        """
        call = guarded(node, self.name, callback)
        profile = qos.queued(self.qos) if self.queued else self.qos
        return node.create_subscription(self.type, self.name, call, profile, **options)


@dataclass(frozen=True)
class Service:
    """A service with its type.

    Args:
        name: its name, relative, so that a second graph can run in a namespace.
        type: service class.
        about: what a call does, for people.
    """

    name: str
    type: type
    about: str = ""

    def server(
        self, node: ServiceFactory[_Made], callback: Callable[[Any, Any], Any], **options: object
    ) -> _Made:
        """Return a new service of a node; options as for Node.create_service.

        An exception that escapes the callback is answered as a failure and does not end the node.
        """
        call = guarded_service(node, self.name, callback)
        return node.create_service(self.type, self.name, call, **options)

    def client(self, node: ClientFactory[_Made], **options: object) -> _Made:
        """Return a new client of a node; options as for Node.create_client."""
        return node.create_client(self.type, self.name, **options)


def _topic(name: str, type: type, profile: QoSProfile, about: str, queued: bool = True) -> Topic:
    return Topic(f"{NAMESPACE}/{name}", type, profile, about, queued)


def _service(name: str, about: str) -> Service:
    return Service(f"{NAMESPACE}/{name}", Trigger, about)


LAYOUT = _topic(
    "layout", PointCloud2, qos.LATEST,
    "One row a robot: place, arms, outlines, limits, speeds, bus, address, wire units, whether it "
    "can be commanded; fixed discs and walls. Once a second at rest.", queued=False,
)  # fmt: skip
TARGETS = _topic(
    "targets",
    PointCloud2,
    qos.EVENTS,
    "Id, x, y [m] of the robots with a target; the number of its fibre where targets name them.",
)
TRAJECTORY = _topic(
    "trajectory", JointTrajectory, qos.LATEST,
    "Joints `p0042/theta` and `p0042/phi` of all robots [rad]. The discretizer hears publishers "
    "with the default quality of service too.",
)  # fmt: skip
SEGMENTS = _topic(
    "segments", PointCloud2, qos.LATEST,
    "Id, joint, duration [ticks], velocity [wire units]: the orders of a plan.",
)  # fmt: skip
FRAMES = _topic(
    "frames", PointCloud2, qos.STREAM,
    "The bytes on each bus with the time of the buses, while the topic has subscribers.",
)  # fmt: skip
JOINT_STATES = _topic(
    "joint_states", JointState, qos.LATEST,
    "Readings of the robots' encoders: twenty a second of the buses while robots move, one a "
    "second at rest. The viewer subscribes while it has subscribers itself.", queued=False,
)  # fmt: skip
CORRIDORS = _topic(
    "corridors", PointCloud2, qos.LATEST,
    "How far each joint may turn at each instant of the motion; made for subscribers alone.",
)  # fmt: skip
OUTCOME = _topic(
    "outcome", PointCloud2, qos.RESULTS,
    "Id, outcome, reason, error [m] of every robot, when a plan has ended; codes are in "
    "[codes](codes.md).",
)  # fmt: skip
PROGRESS = _topic(
    "progress", DiagnosticStatus, qos.STREAM, "Stage, fraction 0 to 1, plan, and a line for people."
)
STOPPED = _topic(
    "stopped", Time, qos.EVENTS,
    "The bridge was told to stop: planning and discretizing of plans up to this stamp end.",
)  # fmt: skip
MEASURED = _topic(
    "measured", PointCloud2, qos.RESULTS,
    "Where the robots are after a plan, by images: verdict, place of the fibre, joint angles with "
    "half their intervals, how far outlines may be off. The bridge tells it to the robots.",
)  # fmt: skip
TURNS = _topic(
    "turns", PointCloud2, qos.EVENTS,
    "Id, way: at the next call of `turn` phi of the robot turns up (1), down (-1) or back (0) from "
    "where it rested; or of all rows theta to the upper (2) or lower (-2) stop; without rows theta "
    "of robots at unknown places. The bridge knows how far.",
)  # fmt: skip
LIGHTS = _topic(
    "lights", PointCloud2, qos.RESULTS,
    "X, y [m], number of exposures, and whether they may be two, of the lights of one image, "
    "stamped with the plan or motion after which it was taken.",
)  # fmt: skip
SPOTS = _topic(
    "camera/spots", PointCloud2, qos.EVENTS,
    "U, v [px], flux and width of the points of light in one exposure, stamped with its time.",
)  # fmt: skip
IMAGE = _topic(
    "camera/image", Image, qos.EVENTS,
    "The pixels of one exposure, mono8 or mono16, stamped with its time; made for subscribers "
    "alone. The metrology finds the spots in them if it is told to.", queued=False,
)  # fmt: skip
TRUE_PLACES = _topic(
    "camera/true_places", PointCloud2, qos.EVENTS,
    "Id, x, y [m] of the fibres as the simulated camera exposes them, for recordings.",
)  # fmt: skip
CALIBRATION = _topic(
    "camera/calibration", PointCloud2, qos.LATEST,
    "X, y [m] and u, v [px] of the lights by which the camera was calibrated, and the fiducials.",
)  # fmt: skip
DIAGNOSTICS = Topic(
    "/diagnostics", DiagnosticArray, qos.STREAM,
    "Counters of each node and bus, of all planes of a domain; once a second.",
)  # fmt: skip

# One topic for each stage: an empty table does not name its stage, and of two latched
# publishers on one topic of depth 1 a late subscriber would get one message only.
HELD_BY_PLANNER = _topic(
    "held/planner", PointCloud2, qos.LATEST, "Id, reason of the robots that the planner holds."
)
HELD_BY_DISCRETIZER = _topic(
    "held/discretizer", PointCloud2, qos.LATEST,
    "Id, reason of the robots that the discretizer holds.",
)  # fmt: skip

# In the namespace of each sector; see fiber_sectors.
TO_SECTOR = _topic(
    "to_sector",
    UInt8MultiArray,
    qos.SECTORS,
    "Beats and calls of the coordinator to one sector.",
    queued=False,
)
FROM_SECTOR = _topic(
    "from_sector", UInt8MultiArray, qos.SECTORS, "Reports and answers of one sector.", queued=False
)

# See point_clouds.
VIEW_ARMS = _topic(
    "view/arms", PointCloud2, qos.LATEST, "Points along the arms, for 3D viewers.", queued=False
)
VIEW_PLANE = _topic(
    "view/plane", PointCloud2, qos.LATEST, "Points at the centres of the robots.", queued=False
)
VIEW_TARGETS = _topic(
    "view/targets", PointCloud2, qos.LATEST, "Points at the targets.", queued=False
)

EXPOSE = _service("camera/expose", "Takes the exposures of one image, at once.")
MEASURE = _service(
    "measure",
    "Takes an image of the robots at rest, and publishes where they are as `measured`.",
)
LOOK = _service(
    "look",
    "Takes an image of the robots at rest, and publishes its `lights`; nothing is learned from it.",
)
START = _service("start", "Loads, verifies and starts the orders that are ready.")
STOP = _service(
    "stop", "Stops robots that move, and ends planning and discretizing; answered at any time."
)
HOME = _service("home", "Folds all robots that can be commanded.")
TURN = _service(
    "turn",
    "Makes the motion that `turns` has named last, so little that nothing can touch, or to stops, "
    "certified; the stamp of `turns` names it. A bridge that has not heard them refuses.",
)
CLEAR = _service(
    "clear",
    "Ends what is left of a plan or a stop, reads all robots, and makes the next plan possible.",
)
CONFIGURE = _service(
    "configure", "Asks all robots anew, as after a power cut, and sets their parameters."
)
