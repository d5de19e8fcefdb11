"""Trajectory: the sampled motion of a plan, one JointTrajectory for the whole plane."""

import array

import numpy as np
from builtin_interfaces.msg import Duration
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from fiber_core.motion import SampledMotion
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.joints import joint_columns, joint_names
from fiber_msgs_py.stamps import PlanStamp, check_frame, header

__all__ = ["decode", "encode"]

_SECOND = 1_000_000_000


def encode(ids, motion: SampledMotion, stamp: PlanStamp) -> JointTrajectory:
    """Return a sampled motion as a message, times to the nanosecond.

    The velocity of a point is that of the piece that begins there; the last is zero.

    Args:
        ids: robot ids, shape (n,).
        motion: their motion, n robots, from time zero or later.
        stamp: plan it belongs to.

    Raises:
        MessageError: an id is out of range or there twice, ids and motion differ in number,
            or a time is negative or no nanosecond after the one before.
    """
    names = joint_names(ids, "trajectory")
    if motion.n * 2 != len(names):
        raise MessageError("trajectory", f"robots move, {len(names) // 2} have ids", value=motion.n)
    times_ns = np.rint(motion.time_s * _SECOND).astype(np.int64)
    _check_times(times_ns)
    positions = np.ascontiguousarray(motion.angles.reshape(len(names), len(times_ns)).T)
    velocities = np.zeros_like(positions)
    velocities[:-1] = np.diff(positions, axis=0) / np.diff(motion.time_s)[:, None]
    return JointTrajectory(
        header=header(stamp),
        joint_names=names,
        points=[
            JointTrajectoryPoint(
                # any other type costs a Python object per number
                positions=array.array("d", position.tobytes()),
                velocities=array.array("d", velocity.tobytes()),
                time_from_start=Duration(sec=ns // _SECOND, nanosec=ns % _SECOND),
            )
            for ns, position, velocity in zip(times_ns.tolist(), positions, velocities)
        ],
    )


def decode(message: JointTrajectory) -> tuple[np.ndarray, SampledMotion, np.ndarray | None]:
    """Return what a trajectory message says; joints may come in any order.

    Returns:
        Robot ids, increasing, shape (n,); their motion; joint velocities at its times
        [rad/s], shape (n, 2, t), or None where the message has none.

    Raises:
        MessageError: a joint name is malformed, there twice, or without its other joint; a
            point has another number of values than joints; a value is not finite; times are
            negative or do not increase. Names the robot and the value.
    """
    check_frame(message, "trajectory")
    ids, columns = joint_columns(message.joint_names, "trajectory")
    if not message.points:
        raise MessageError("trajectory", "points, expected at least 1", field="has", value=0)
    times_ns = np.array(
        [p.time_from_start.sec * _SECOND + p.time_from_start.nanosec for p in message.points]
    )
    _check_times(times_ns)
    angles = _gather(message.points, "positions", ids, columns)
    velocities = None
    if any(len(point.velocities) for point in message.points):
        velocities = _gather(message.points, "velocities", ids, columns)
    return ids, SampledMotion(times_ns / _SECOND, angles), velocities


def _check_times(times_ns):
    if times_ns[0] < 0:
        raise MessageError("trajectory", "s is negative", field="time", value=times_ns[0] / _SECOND)
    late = np.diff(times_ns) <= 0
    if late.any():
        before, after = times_ns[int(np.argmax(late)) :][:2] / _SECOND
        raise MessageError("trajectory", f"s does not follow {before} s", field="time", value=after)


def _gather(points, field, ids, columns):
    table = np.empty((len(points), columns.size))
    for k, point in enumerate(points):
        values = getattr(point, field)
        if len(values) != columns.size:
            raise MessageError(
                "trajectory",
                f"values for {columns.size} joints",
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
