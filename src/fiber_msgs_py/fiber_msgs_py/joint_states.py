# SPDX-License-Identifier: Apache-2.0
"""Joint states: joint angles and velocities by the robots' encoders."""

import array

import numpy as np
from numpy.typing import ArrayLike
from sensor_msgs.msg import JointState

from fiber_core.array_types import Angles, Ids, Velocities
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.ids import refuse
from fiber_msgs_py.joints import joint_columns, joint_names
from fiber_msgs_py.sessions import checked_session
from fiber_msgs_py.stamps import PlanStamp, check_frame, header

__all__ = ["decode", "encode"]


def encode(
    ids: ArrayLike,
    angles: ArrayLike,
    velocities: ArrayLike,
    time_ns: int,
    session: str | None = None,
) -> JointState:
    """Return encoder readings as a message.

    Args:
        ids: robot ids, shape (n,).
        angles: joint angles [rad], shape (n, 2).
        velocities: joint velocities [rad/s], shape (n, 2).
        time_ns: time of the readings [ns].
        session: id of the session, a name more with the value 0; None for no session.

    Raises:
        MessageError: an id is out of range or appears twice, or shapes differ.
    """
    names = joint_names(ids, "joint_states")
    more = [] if session is None else [checked_session(session)]
    message = JointState(header=header(PlanStamp(time_ns)), name=names + more)
    for field, values in (("position", angles), ("velocity", velocities)):
        values = np.ascontiguousarray(values, dtype=float)
        if values.shape != (len(names) // 2, 2):
            raise MessageError(
                "joint_states",
                f"does not fit {len(names) // 2} ids",
                field=f"shape of {field}",
                value=values.shape,
            )
        setattr(message, field, array.array("d", values.tobytes() + bytes(8 * len(more))))
    return message


def decode(message: JointState) -> tuple[Ids, Angles, Velocities, int]:
    """Return robot ids, joint angles, joint velocities and the time of the readings.

    Returns:
        Ids, increasing, shape (n,); angles [rad] and velocities [rad/s], shape (n, 2),
        velocities zero where the message has none; time [ns].

    Raises:
        MessageError: a joint name is malformed, appears twice, or has no matching other joint;
            a value is missing or not finite.
    """
    check_frame(message, "joint_states")
    ids, columns = joint_columns(message.name, "joint_states")
    joints = len(message.name)  # that of a session has values too
    tables = []
    for field in ("position", "velocity"):
        values = np.asarray(getattr(message, field), dtype=float)
        if field == "velocity" and not len(values):
            values = np.zeros(joints)
        if len(values) != joints:
            raise MessageError(
                "joint_states",
                f"values for {joints} joints",
                field=f"{field} has",
                value=len(values),
            )
        values = values[columns]
        refuse(~np.isfinite(values), "joint_states", field, ids, values, "is not finite")
        tables.append(values)
    return ids, *tables, PlanStamp.of(message).ns
