"""The corridors of the orders that are sent: how far each joint could turn beside all others."""

import numpy as np

from fiber_core.clearance import Safety, bodies_of, certified_pairs, levers_of, profiles_of
from fiber_core.corridor import JointCorridors
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_discretizer.corridor import free_corridors, neighbours_of

__all__ = ["joint_corridors"]

_INSTANTS = 25
_REACH_RAD = 1.6  # a wall farther away than this is put here
_TOLERANCE_MM = 2e-6  # the certificate's: orders that touch their margin are inside it


def joint_corridors(plane: FocalPlane, motion: SegmentMotion, safety: Safety) -> JointCorridors:
    """Return how far each joint could turn either way, everything else as it is sent.

    These are the walls between which robots choose when it is their turn (see turns.py), once
    all have chosen: the gap to every neighbour stays what is required, the other joint does
    what it was sent. A joint whose gap is less than that, which only those that stand too
    close already have, has no room at all.

    Args:
        plane: the focal plane.
        motion: what is sent, decoded.
        safety: gap asked for and timing errors to survive.

    Returns:
        Margins of all robots, 25 instants each; walls up to 1.6 rad away.
    """
    lasts_s = motion.durations.max(axis=1, initial=0.0)
    times = lasts_s[:, None] * np.linspace(0.0, 1.0, _INSTANTS)
    sent = _angles_at(motion, times)
    pairs = certified_pairs(plane, motion, safety)
    required = safety.required_mm(plane, motion, pairs) - _TOLERANCE_MM
    table, levers, rows = bodies_of(plane).table, levers_of(plane), np.arange(plane.n)
    beside, profiles = neighbours_of(plane.n, pairs), profiles_of(motion)
    walls = np.empty((2, plane.n, 2, _INSTANTS))
    for joint in (0, 1):
        low, high, is_open = free_corridors(
            table, levers, plane.limits, profiles, beside, required,
            rows, joint, times, sent, 0, _REACH_RAD,
        )  # fmt: skip
        for wall, value in zip(walls, (low, high)):
            wall[:, joint] = np.where(is_open[:, None], value, sent[:, joint])
    # a robot that stands beyond its limits is inside its own margin
    return JointCorridors(lasts_s, np.minimum(walls[0], sent), np.maximum(walls[1], sent))


def _angles_at(motion, times):
    # joint angles of each robot at its own times, shape (n, 2, t)
    lasts, turns = motion.duration_s, motion.velocity_rad_s
    profile = np.repeat(np.arange(2 * motion.n), np.diff(motion.offsets))
    ends_s = np.cumsum(lasts)
    begin_s = ends_s - lasts - np.concatenate([[0.0], ends_s])[motion.offsets[:-1]][profile]
    angles = np.empty((motion.n, 2, times.shape[1]))
    for k, at in enumerate(times.T):
        way = np.clip(at[profile // 2] - begin_s, 0.0, lasts) * turns
        moved = np.bincount(profile, way, minlength=2 * motion.n)
        angles[:, :, k] = motion.start + moved.reshape(-1, 2)
    return angles
