# SPDX-License-Identifier: Apache-2.0
"""Robots that are held because of what their motors can do: id, reason, and the values."""

import numpy as np

from fiber_core import kinematics
from fiber_core.drive import Breaches, MotorRule
from fiber_core.drive.checks import approaches
from fiber_core.outcomes import Reason
from fiber_positioners.orders import Orders

__all__ = ["held_by_drive"]

_JOINTS = ("theta", "phi", None)


def held_by_drive(orders: Orders) -> list[dict[str, object]]:
    """Return the robots that a plan holds because of their motors, by id.

    Args:
        orders: the orders of the plan.

    Returns:
        For each robot its `id`, the name of its `reason`, `rules`: for each rule that it would
        break the `rule`, the `joint`, the `value` and what is allowed, `least` and `most` [rad,
        s], None where there is no limit; and `told`, the same as a sentence.
    """
    plane = orders.plane
    found = Breaches.joined([_approaches(orders), orders.discretization.breaches])
    rows, first = np.unique(found.robot, return_index=True)  # entries are in order of rows
    return [
        {
            "id": int(plane.ids[row]),
            "reason": Reason(orders.reason[row]).name.lower(),
            "rules": [_entry(found, k) for k in entries],
            "told": "; ".join(found.text(plane.drive, plane.supply, k) for k in entries),
        }
        for row, entries in zip(rows, np.split(np.arange(len(found)), first[1:]))
    ]


def _entry(found: Breaches, k: int) -> dict[str, object]:
    value, least, most = (float(x[k]) for x in (found.value, found.least, found.most))
    return {
        "rule": MotorRule(found.rule[k]).name.lower(),
        "joint": _JOINTS[found.joint[k]],
        "value": value,
        "least": least if np.isfinite(least) else None,
        "most": most if np.isfinite(most) else None,
    }


def _approaches(orders: Orders) -> Breaches:
    # robots with ends, of which the planner found none that their approach comes to
    problem = orders.start_problem
    plane = problem.plane
    angles, valid = kinematics.inverse(plane, problem.targets)
    beyond = orders.plan_stage.reason == Reason.OUTSIDE_JOINT_RANGE
    rows = np.flatnonzero(beyond & valid.any(axis=1))
    goals = np.full((plane.n, 2), np.nan)
    goals[rows] = angles[rows, valid[rows].argmax(axis=1)]
    return approaches(plane.drive, plane.limits, goals)
