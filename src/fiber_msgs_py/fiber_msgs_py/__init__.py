"""Stock ROS messages to and from the types of the core, with topic names and QoS.

One module per message, each with ``encode`` and ``decode``; ``topics`` names them.
Messages are SI in the frame `focal_plane`, core types are mm, rad, s: the only place
where one becomes the other is here.
"""

from fiber_msgs_py import (
    diagnostics,
    frames,
    held,
    joint_states,
    layout,
    outcome,
    progress,
    segments,
    targets,
    topics,
    trajectory,
)
from fiber_msgs_py.diagnostics import Level, Status
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.frames import FrameLog
from fiber_msgs_py.held import Stage
from fiber_msgs_py.parameters import declare_settings
from fiber_msgs_py.plane_view import PlaneView
from fiber_msgs_py.progress import Progress
from fiber_msgs_py.reporter import Reporter
from fiber_msgs_py.running import run
from fiber_msgs_py.segments import SegmentTable
from fiber_msgs_py.stamps import FRAME_ID, PlanStamp
from fiber_msgs_py.topics import Service, Topic

__all__ = [
    "FRAME_ID",
    "FrameLog",
    "Level",
    "MessageError",
    "PlanStamp",
    "PlaneView",
    "Progress",
    "Reporter",
    "SegmentTable",
    "Service",
    "Stage",
    "Status",
    "Topic",
    "declare_settings",
    "diagnostics",
    "frames",
    "held",
    "joint_states",
    "layout",
    "outcome",
    "progress",
    "run",
    "segments",
    "targets",
    "topics",
    "trajectory",
]
