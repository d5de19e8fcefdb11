# SPDX-License-Identifier: Apache-2.0
"""Corridors of the orders that are sent: how far each joint could turn among the others."""

import numpy as np

from fiber_core.array_types import Floats
from fiber_core.clearance import (
    Safety,
    bodies_of,
    certified_pairs,
    levers_of,
    neighbours_of,
)
from fiber_core.corridor import JointCorridors
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_discretizer.corridor import Task, free_intervals

__all__ = ["joint_corridors"]

_INSTANTS = 25
_REACH_RAD = 1.6  # a bound farther away than this is put here
_TOLERANCE_MM = 2e-6  # tolerance of the certificate: orders that touch their margin are inside


def joint_corridors(plane: FocalPlane, motion: SegmentMotion, safety: Safety) -> JointCorridors:
    """Return how far each joint could turn either way, all other joints as they are sent.

    The gap to every neighbour stays what is required while one joint turns inside its
    corridor. At an instant at which a robot is closer to a neighbour than that, the corridors of
    its joints have no width.

    Args:
        plane: the focal plane.
        motion: the motion that is sent, decoded.
        safety: gap asked for and timing errors to survive.

    Returns:
        Corridors of all robots, 25 instants each; bounds are at most 1.6 rad away.
    """
    lasts_s = motion.durations.max(axis=1, initial=0.0)
    times = lasts_s[:, None] * np.linspace(0.0, 1.0, _INSTANTS)
    sent = _angles_at(motion, times)
    pairs = certified_pairs(plane, motion, safety)
    required = safety.required_mm(plane, motion, pairs) - _TOLERANCE_MM
    table, levers = bodies_of(plane).table, levers_of(plane)
    neighbours, rows = neighbours_of(plane.n, pairs), np.arange(plane.n)
    bounds = np.empty((2, plane.n, 2, _INSTANTS))
    for joint in (0, 1):
        bounds[:, :, joint] = free_intervals(
            Task(
                table, levers, plane.limits, motion.arrays, neighbours, required,
                rows, joint, times, sent, _REACH_RAD,
            )
        )  # fmt: skip
    # a robot that stands beyond its limits is inside its own corridor
    return JointCorridors(lasts_s, np.minimum(bounds[0], sent), np.maximum(bounds[1], sent))


def _angles_at(motion: SegmentMotion, times: Floats) -> Floats:
    # joint angles of each robot at its own times, shape (n, 2, t)
    robot = motion.parts.owner // 2
    angles = np.empty((motion.n, 2, times.shape[1]))
    for k, instant in enumerate(times.T):
        passed = np.clip(instant[robot] - motion.begins_s, 0.0, motion.duration_s)
        turned = motion.parts.sums(passed * motion.velocity_rad_s)
        angles[:, :, k] = motion.start + turned.reshape(-1, 2)
    return angles
