# SPDX-License-Identifier: Apache-2.0
"""Slower profiles: a pair that starts close may move, but not as fast as other pairs."""

import numpy as np

from fiber_core.array_types import Bools, Floats, Ints
from fiber_core.clearance import gaps
from fiber_core.focal_plane import FocalPlane
from fiber_planner.direct.local_search import straighten
from fiber_planner.direct.plan_state import PlanState, measure_pairs
from fiber_planner.direct.scene import Scene

__all__ = ["slow_close_starts"]

_SLOWER = 0.8  # factor of a speed limit
_MEASURED_MM = 1e-3  # resolution of a gap in the certificate


def slow_close_starts(
    plane: FocalPlane, scene: Scene, plan: PlanState, among: Bools, makespan_s: float
) -> Ints:
    """Slow one robot of each pair that is required to keep more than the gap it starts with.

    The gap that safety requires grows with the speed of the slower robot of a pair. A pair whose
    requirement exceeds the gap at the start conflicts at time zero, whatever profiles its robots
    try. The robot with less to turn gets a lower speed limit, though none below that of its
    straight motion, and begins anew with that motion; a robot that may end anywhere rests.

    Args:
        plane: the focal plane.
        scene: the same robots as the search sees them; speed limits are written.
        plan: the plan; requirements, profiles and costs are written.
        among: pairs to look at, shape (p,).
        makespan_s: duration of the plan [s].

    Returns:
        Rows of the robots that were slowed.
    """
    which = np.flatnonzero(among & (plan.release == 0) & scene.movable[scene.pairs].all(axis=1))
    at_start = gaps(plane, scene.pairs[which], scene.start)
    close = plan.required[which] > at_start
    if not close.any():
        return np.zeros(0, dtype=np.int64)
    which, at_start = which[close], at_start[close]
    straight = _straight_speeds(scene, plan, makespan_s)
    can_slow = np.asarray((straight < _SLOWER * scene.speed).all(axis=1))
    pairs = scene.pairs[which]
    helped = can_slow[pairs].any(axis=1)
    pairs, which, at_start = pairs[helped], which[helped], at_start[helped]
    turn = np.where(can_slow, straight.max(axis=1), np.inf)
    rows = np.unique(np.where(turn[pairs[:, 0]] <= turn[pairs[:, 1]], pairs[:, 0], pairs[:, 1]))
    plan.required[which] = np.minimum(plan.required[which], at_start - _MEASURED_MM)
    plan.required_early[which] = np.minimum(plan.required_early[which], plan.required[which])
    _begin_slower(scene, plan, rows)
    return rows


def _straight_speeds(scene: Scene, plan: PlanState, makespan_s: float) -> Floats:
    # joint speeds of straight motions [rad/s], (n, 2); robots that may end anywhere rest
    change = np.abs(plan.q[: len(scene.start), :, -1] - scene.start)
    return np.where(plan.choice[:, None] >= 0, change, 0.0) / makespan_s


def _begin_slower(scene: Scene, plan: PlanState, rows: Ints) -> None:
    if not len(rows):
        return
    scene.speed[rows] *= _SLOWER
    scene.speed_alone[rows] *= _SLOWER
    slowed = np.zeros(len(scene.movable), dtype=bool)
    slowed[rows] = True
    straighten(scene, plan, slowed)
    resting = rows[plan.choice[rows] < 0]
    plan.q[resting] = scene.start[resting][:, :, None]
    plan.changed[resting] = plan.shortcut_due[resting] = True
    measure_pairs(scene, plan, np.flatnonzero(slowed[scene.pairs].any(axis=1)))
