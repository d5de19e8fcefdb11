# SPDX-License-Identifier: Apache-2.0
"""Robots that are held because of what their motors can do: id, reason, and the value."""

import numpy as np

from fiber_core import kinematics
from fiber_core.drive.told import approaches_told
from fiber_core.outcomes import Reason
from fiber_positioners.orders import Orders

__all__ = ["held_by_drive"]


def held_by_drive(orders: Orders) -> list[dict[str, object]]:
    """Return the robots that a plan holds because of their motors, by id.

    Args:
        orders: the orders of the plan.

    Returns:
        For each robot its `id`, the name of its `reason`, and `told`: the rules that its motors
        would break, with the values.
    """
    told: dict[int, list[str]] = {}
    for text in (*_approaches(orders), *orders.discretization.rules_told):
        name, sentence = text.removeprefix("robot ").split(": ", 1)
        told.setdefault(int(name), []).append(sentence)
    rows = orders.plane.index_of(np.array(list(told), dtype=np.int64))
    reasons = {robot: Reason(orders.reason[row]) for robot, row in zip(told, rows.tolist())}
    return [
        {"id": robot, "reason": reasons[robot].name.lower(), "told": "; ".join(sentences)}
        for robot, sentences in sorted(told.items())
    ]


def _approaches(orders: Orders) -> list[str]:
    # robots with ends, of which the planner found none that their approach comes to
    problem = orders.start_problem
    angles, valid = kinematics.inverse(problem.plane, problem.targets)
    beyond = orders.plan_stage.reason == Reason.OUTSIDE_JOINT_RANGE
    rows = np.flatnonzero(beyond & valid.any(axis=1))
    goals = angles[rows, valid[rows].argmax(axis=1)]
    plane = problem.plane
    return approaches_told(plane.drive.of_robots(rows), plane.limits[rows], goals, plane.ids[rows])
