# SPDX-License-Identifier: Apache-2.0
"""Trajectory: the sampled motion of a plan, one JointTrajectory for the whole plane."""

import array
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Duration
from numpy.typing import ArrayLike
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from fiber_core.array_types import Floats, Ids, Ints
from fiber_core.errors import MotionError
from fiber_core.motion import SampledMotion
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.joints import joint_columns, joint_names
from fiber_msgs_py.sessions import checked_session
from fiber_msgs_py.stamps import PlanStamp, check_frame, header

__all__ = ["decode", "encode"]

_SECOND = 1_000_000_000


def encode(
    ids: ArrayLike, motion: SampledMotion, stamp: PlanStamp, session: str | None = None
) -> JointTrajectory:
    """Return a sampled motion as a message, times to the nanosecond.

    The velocity of a point is the velocity after that point; the last is zero.

    Args:
        ids: robot ids, shape (n,).
        motion: motion of these n robots, from time zero or later.
        stamp: names the plan.
        session: id of the session, a name more with the value 0; None for no session.

    Raises:
        MessageError: an id is out of range or appears twice, ids and motion differ in number,
            or a time is negative or less than a nanosecond after the one before.
    """
    names = joint_names(ids, "trajectory")
    if motion.n * 2 != len(names):
        raise MessageError("trajectory", f"robots, but {len(names) // 2} ids", value=motion.n)
    times_ns = np.rint(motion.time_s * _SECOND).astype(np.int64)
    _check_times(times_ns)
    positions = np.ascontiguousarray(motion.angles.reshape(len(names), len(times_ns)).T)
    velocities = np.zeros_like(positions)
    velocities[:-1] = np.diff(positions, axis=0) / np.diff(motion.time_s)[:, None]
    more = [] if session is None else [checked_session(session)]
    zero = bytes(8 * len(more))
    return JointTrajectory(
        header=header(stamp),
        joint_names=names + more,
        points=[
            JointTrajectoryPoint(
                # any other type costs a Python object for each number
                positions=array.array("d", position.tobytes() + zero),
                velocities=array.array("d", velocity.tobytes() + zero),
                time_from_start=Duration(sec=ns // _SECOND, nanosec=ns % _SECOND),
            )
            for ns, position, velocity in zip(times_ns.tolist(), positions, velocities)
        ],
    )


def decode(message: JointTrajectory) -> tuple[Ids, SampledMotion, Floats | None]:
    """Return the motion in a message; joints may have any order.

    Returns:
        Robot ids, increasing, shape (n,); the motion of these robots; joint velocities at its times
        [rad/s], shape (n, 2, t), or None where the message has none.

    Raises:
        MessageError: a joint name is malformed, appears twice, or has no matching other joint; a
            point has another number of values than joints; a value is not finite; times are
            negative or do not increase. Names the robot and the value.
    """
    check_frame(message, "trajectory")
    ids, columns = joint_columns(message.joint_names, "trajectory")
    points = list(message.points)
    if not points:
        raise MessageError("trajectory", "points, expected at least 1", field="has", value=0)
    times_ns = np.array(
        [p.time_from_start.sec * _SECOND + p.time_from_start.nanosec for p in points]
    )
    _check_times(times_ns)
    joints = len(message.joint_names)  # that of a session has values too
    angles = _gather(points, "positions", ids, columns, joints)
    velocities = None
    if any(len(point.velocities) for point in points):
        velocities = _gather(points, "velocities", ids, columns, joints)
    try:
        return ids, SampledMotion(times_ns / _SECOND, angles), velocities
    except MotionError as error:  # times that differ in ns and not in the precision of s
        raise MessageError("trajectory", f"is not a motion: {error}") from None


def _check_times(times_ns: Ints) -> None:
    if times_ns[0] < 0:
        raise MessageError("trajectory", "s is negative", field="time", value=times_ns[0] / _SECOND)
    late = np.diff(times_ns) <= 0
    if late.any():
        before, after = times_ns[int(np.argmax(late)) :][:2] / _SECOND
        raise MessageError("trajectory", f"s does not follow {before} s", field="time", value=after)


def _gather(
    points: Sequence[JointTrajectoryPoint], field: str, ids: Ids, columns: Ints, joints: int
) -> Floats:
    # values of one field by robot, joint and point, shape (n, 2, t)
    table = np.empty((len(points), joints))
    for k, point in enumerate(points):
        values = getattr(point, field)
        if len(values) != joints:
            raise MessageError(
                "trajectory",
                f"values for {joints} joints",
                field=f"{field} of point {k} has",
                value=len(values),
            )
        table[k] = values
    per_robot = np.ascontiguousarray(table.T[columns.ravel()]).reshape(len(ids), 2, len(points))
    bad = ~np.isfinite(per_robot)
    if bad.any():
        row, joint, k = np.argwhere(bad)[0]
        raise MessageError(
            "trajectory",
            "is not finite",
            field=f"{field} of {('theta', 'phi')[joint]} at point {k}",
            robot=int(ids[row]),
            value=per_robot[row, joint, k],
        )
    return per_robot
