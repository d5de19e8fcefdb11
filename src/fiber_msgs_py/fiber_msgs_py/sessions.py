# SPDX-License-Identifier: Apache-2.0
"""The session of a bridge: an id that its messages carry, and all messages derived from them.

Stock messages have no place for an id, but all of them have names: the fields of a table, the
joints of joint states and of a trajectory, the keys of progress. The id is one more name, such as
`session_18c2f0a1b2c3d4e55f3c09a1`; the value under it has no meaning. Ids sort by the time at which
their sessions were opened.
"""

import re
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState, PointCloud2
from trajectory_msgs.msg import JointTrajectory

from fiber_msgs_py.errors import MessageError

__all__ = ["checked_session", "is_session", "new_session", "session_of"]

_PREFIX = "session_"
_PATTERN = re.compile(_PREFIX + "[0-9a-f]{24}")


def new_session(opened_ns: int, random: bytes) -> str:
    """Return the id of a new session.

    Args:
        opened_ns: time at which it is opened [ns].
        random: four random bytes.
    """
    return checked_session(f"{_PREFIX}{opened_ns:016x}{random.hex()}")


def is_session(name: str) -> bool:
    """Return whether a name is the id of a session."""
    # nearly all names are those of joints
    return name.startswith(_PREFIX) and _PATTERN.fullmatch(name) is not None


def checked_session(name: str) -> str:
    """Return the id of a session.

    Raises:
        MessageError: the name is not one.
    """
    if not is_session(name):
        raise MessageError("session", "is not the id of a session", field="name", value=repr(name))
    return name


def session_of(message: Any) -> str | None:
    """Return the session that a message belongs to; None if it names none, or more than one."""
    names = list(filter(is_session, _names(message)))
    return names[0] if len(names) == 1 else None


def _names(message: Any) -> list[str]:
    if isinstance(message, PointCloud2):
        return [field.name for field in message.fields]
    if isinstance(message, JointState):
        return list(message.name)
    if isinstance(message, JointTrajectory):
        return list(message.joint_names)
    if isinstance(message, DiagnosticStatus):
        return [pair.key for pair in message.values]
    return []
