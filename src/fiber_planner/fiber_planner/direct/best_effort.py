# SPDX-License-Identifier: Apache-2.0
"""Best effort: the robots of a plan with most conflict lose their targets, or rest."""

from collections.abc import Callable

import numpy as np

from fiber_core.array_types import Bools, Ints
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Reason
from fiber_planner.direct.initial_plan import Ends
from fiber_planner.direct.plan_state import PlanState, measure_all
from fiber_planner.direct.scene import Scene

__all__ = [
    "at_borders",
    "hold_at_start",
    "hold_idle",
    "hold_one_of_tangled",
    "hold_worst",
    "near_static_arms",
    "release_worst",
    "worst_robots",
]


def near_static_arms(scene: Scene, robots: int) -> Bools:
    """Return the robots next to an arm that cannot move, (b,); a fixed body blocks only a passage.

    Args:
        scene: the robots and their surroundings.
        robots: their number, n.
    """
    pairs, movable = scene.pairs, scene.movable
    beside = pairs[((pairs < robots) & ~movable[pairs]).any(axis=1)]
    return movable & np.isin(np.arange(len(movable)), beside)


def at_borders(scene: Scene, plane: FocalPlane) -> Bools:
    """Return the robots with a neighbour in another sector, (b,): the two keep a wider gap.

    Args:
        scene: the robots and their surroundings.
        plane: the focal plane, with its sectors.
    """
    pairs, sector = scene.pairs, plane.sector
    pairs = pairs[(pairs < plane.n).all(axis=1)]
    apart = pairs[sector[pairs[:, 0]] != sector[pairs[:, 1]]]
    return scene.movable & np.isin(np.arange(len(scene.movable)), apart)


def worst_robots(scene: Scene, plan: PlanState, bad: Bools, among: Bools) -> Ints:
    """Return, of every bad pair, the robot with most conflict, if it is among some robots.

    Args:
        scene: the robots and their surroundings.
        plan: the plan, with its weights and costs.
        bad: pairs, shape (p,).
        among: robots, shape (b,).
    """
    total = np.zeros(len(scene.movable))
    for side in range(2):
        np.add.at(total, scene.pairs[bad, side], (plan.weight * plan.cost)[bad])
    total[~among] = -1.0
    a, b = scene.pairs[bad].T
    worst = np.where(total[a] >= total[b], a, b)
    return np.unique(worst[among[worst]])


def release_worst(scene: Scene, plan: PlanState, among: Bools) -> Ints:
    """Let the robots with most conflict end anywhere, and give all pairs equal weights.

    Args:
        scene: the robots and their surroundings.
        plan: the plan; choices, weights and what is due are written.
        among: robots that may lose their targets, shape (b,).

    Returns:
        Rows of the robots that have lost their targets.
    """
    with_target = among.copy()
    with_target[: len(plan.choice)] &= plan.choice >= 0
    worst = worst_robots(scene, plan, plan.cost > 0.0, with_target)
    plan.choice[worst] = -1
    plan.shortcut_due[worst] = True
    plan.weight[:] = 1.0
    return worst


def hold_at_start(scene: Scene, plan: PlanState, rows: Ints) -> Ints:
    """Let robots rest where they start; return the rows of those that had targets.

    Args:
        scene: the robots and their surroundings.
        plan: the plan; profiles and choices are written, costs have to be computed again.
        rows: the robots, shape (k,).
    """
    plan.q[rows] = scene.start[rows][:, :, None]
    plan.changed[rows] = True
    lost = rows[plan.choice[rows] >= 0]
    plan.choice[lost] = -1
    return lost


def hold_worst(scene: Scene, plan: PlanState, unconfirmed: Callable[[], Bools]) -> Ints:
    """Let the robots with most conflict rest where they start, then those in conflict with them.

    Args:
        scene: the robots and their surroundings.
        plan: the plan; it is certified afterwards.
        unconfirmed: returns the pairs that the certificate does not confirm, shape (p,).

    Returns:
        Rows of the robots that had targets.
    """
    plan.weight[:] = 1.0
    moving = scene.movable.copy()
    lost: list[Ints] = [np.zeros(0, dtype=np.int64)]
    while True:
        in_conflict = measure_all(scene, plan) > 0
        rows = worst_robots(scene, plan, plan.cost > 0.0 if in_conflict else unconfirmed(), moving)
        if not len(rows):
            return np.concatenate(lost)
        moving[rows] = False
        lost.append(hold_at_start(scene, plan, rows))


def hold_idle(scene: Scene, plan: PlanState) -> int:
    """Let robots without a target that are in conflict rest where they start.

    Args:
        scene: the robots and their surroundings.
        plan: the plan; profiles and costs are written.

    Returns:
        How many of them did not rest.
    """
    idle = np.zeros(len(scene.movable), dtype=bool)
    idle[scene.pairs[plan.cost > 0.0]] = True
    idle &= scene.movable
    idle[: len(plan.choice)] &= plan.choice < 0
    rows = np.flatnonzero(idle)
    rows = rows[(plan.q[rows] != scene.start[rows][:, :, None]).any(axis=(1, 2))]
    hold_at_start(scene, plan, rows)
    measure_all(scene, plan)
    return len(rows)


def hold_one_of_tangled(scene: Scene, plan: PlanState, ends: Ends, tangled: Bools) -> None:
    """Let one robot of each pair that starts too close rest, preferably one without a target.

    Two that move could touch through timing errors. A robot that cannot leave without coming nearer
    rests in any case.

    Args:
        scene: the robots and their surroundings; which robots are movable is written.
        plan: the plan; profiles and choices are written.
        ends: where robots should end; written.
        tangled: pairs that start too close, shape (p,).
    """
    movable = scene.movable
    for a, b in scene.pairs[tangled]:
        if movable[a] and movable[b]:
            first = ends.choice[a] < 0 <= ends.choice[b] and not ends.waits[b]
            row = a if first or ends.waits[a] else b
            movable[row] = False
            plan.q[row] = scene.start[row][:, None]
            plan.choice[row] = ends.choice[row] = -1
            ends.angles[row] = scene.start[row]
            if ends.reason[row] == Reason.OK:
                ends.reason[row] = Reason.TANGLED
