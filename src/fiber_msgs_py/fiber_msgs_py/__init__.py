# SPDX-License-Identifier: Apache-2.0
"""Stock ROS messages to and from the types of the core, with topic names and QoS.

One module for each message, with ``encode`` and ``decode``; ``topics`` has their topics.
Messages are SI in the frame `focal_plane`, core types are mm, rad, s: units are converted in
this package only.
"""

from fiber_msgs_py import (
    corridors,
    diagnostics,
    frames,
    held,
    images,
    joint_states,
    layout,
    lights,
    measured,
    outcome,
    point_clouds,
    progress,
    segments,
    spots,
    targets,
    topics,
    trajectory,
    true_places,
    turns,
)
from fiber_msgs_py.attempts import Attempt, AttemptTable
from fiber_msgs_py.callback_guard import guarded, report_failures_to
from fiber_msgs_py.diagnostics import Level, Status
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.held import Stage
from fiber_msgs_py.progress import Progress
from fiber_msgs_py.rate_limit import RateLimit
from fiber_msgs_py.sessions import new_session, session_of
from fiber_msgs_py.stamps import FRAME_ID, PlanStamp
from fiber_msgs_py.topics import Service, Topic

__all__ = [
    "Attempt",
    "AttemptTable",
    "FRAME_ID",
    "Level",
    "MessageError",
    "PlanStamp",
    "Progress",
    "RateLimit",
    "Service",
    "Stage",
    "Status",
    "Topic",
    "corridors",
    "diagnostics",
    "frames",
    "guarded",
    "held",
    "images",
    "joint_states",
    "layout",
    "lights",
    "measured",
    "new_session",
    "outcome",
    "point_clouds",
    "progress",
    "report_failures_to",
    "segments",
    "session_of",
    "spots",
    "targets",
    "topics",
    "trajectory",
    "true_places",
    "turns",
]
