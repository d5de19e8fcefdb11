# SPDX-License-Identifier: Apache-2.0
"""Other ends of neighbouring robots at once, where those that were chosen at first have no way."""

import numba as nb
import numpy as np

from fiber_core.array_types import Bools, Ints
from fiber_core.clearance import pair_gap_below
from fiber_planner.direct.local_search import fold_arms, straighten
from fiber_planner.direct.plan_state import PlanState, measure_all
from fiber_planner.direct.profile_sampling import least_intervals
from fiber_planner.direct.scene import Scene
from fiber_planner.direct.splitmix64 import next_uniform, seeded_rng

__all__ = ["change_ends", "fold_around_conflicts"]

_SHARE = 0.5  # of the robots are tried
_MOST = 12  # robots that change their ends for one of them


def fold_around_conflicts(
    scene: Scene, plan: PlanState, step_s: float, number: int, straight: bool, other_ends: bool
) -> None:
    """Let robots in conflict and their neighbours begin again, with equal weights.

    Arms that pass each other when both go straight may not be able to when both fold, and ends
    that are clear of each other may be out of reach.

    Args:
        scene: the robots and their surroundings.
        plan: the plan; written.
        step_s: length of a grid interval [s].
        number: number of a sweep that was not made yet; each has other random numbers.
        straight: whether the robots in conflict go straight.
        other_ends: whether they first get other ends.
    """
    pairs, movable = scene.pairs, scene.movable
    stuck = np.zeros(len(movable), dtype=bool)
    stuck[pairs[plan.cost > 0.0]] = True
    if other_ends:
        stuck |= change_ends(scene, plan, np.flatnonzero(stuck & movable), step_s, number)
    near = stuck.copy()
    near[pairs[near[pairs].any(axis=1)]] = True
    plan.weight[:] = 1.0
    fold_arms(scene, plan, near & movable, step_s)
    if straight:
        straighten(scene, plan, stuck & movable)
    measure_all(scene, plan)


def change_ends(scene: Scene, plan: PlanState, rows: Ints, step_s: float, number: int) -> Bools:
    """Let some robots end at other options, and neighbours that are in the way there as well.

    A move of the local search changes one robot, which can end only where the ends of all
    neighbours are out of the way already. Here each neighbour in the way changes too, and those in
    the way of that one, until all ends are clear of each other; where that fails none changes.
    Robots with other ends go straight.

    Args:
        scene: the robots and their surroundings.
        plan: the plan; choices and profiles are written, costs have to be computed again.
        rows: the robots, shape (k,).
        step_s: length of a grid interval [s].
        number: number of a sweep that was not made yet; each has other random numbers.

    Returns:
        Robots that have other ends, shape (b,).
    """
    changed = np.zeros(len(scene.movable), dtype=bool)
    choice = plan.choice.copy()
    for row in rows:
        _change(scene, plan, row, step_s, number, choice, changed)
    for row in np.flatnonzero(changed):
        plan.choice[row] = choice[row]
        plan.q[row, :, -1] = scene.options[row, choice[row]]
    straighten(scene, plan, changed)
    return changed


@nb.njit(cache=True, error_model="numpy", nogil=True)
def _change(scene, plan, first, step_s, number, choice, changed):
    # one robot and those in its way, into `choice` and `changed`; robots that have changed stay
    rng = seeded_rng(scene.key[first], 2 * number)
    if changed[first] or next_uniform(rng) >= _SHARE:
        return
    settled = np.empty(_MOST, dtype=np.int64)  # robots that have other ends for this one
    before = np.empty(_MOST, dtype=np.int64)
    count, at, failed = 0, 0, False
    own = choice[first]
    if _give_option(scene, plan, first, step_s, choice, changed, rng):
        settled[0], before[0], count = first, own, 1
    while at < count and not failed:
        i = settled[at]
        at += 1
        for e in range(scene.near.offsets[i], scene.near.offsets[i + 1]):
            j = scene.near.body[e]
            if _ends_clear(scene, plan, i, j, plan.required[scene.near.pair[e]], choice):
                continue
            if j >= len(choice) or changed[j] or count == _MOST:
                failed = True
                break
            own = choice[j]
            if not _give_option(scene, plan, j, step_s, choice, changed, rng):
                failed = True
                break
            settled[count], before[count] = j, own
            count += 1
    if failed:
        for k in range(count):
            choice[settled[k]] = before[k]
            changed[settled[k]] = False


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _give_option(scene, plan, i, step_s, choice, changed, rng):
    # Another option of robot i that it can reach in time and that is clear of all robots that have
    # changed, into `choice`; whether there is one.
    own, number, last = choice[i], scene.option_count[i], plan.q.shape[2] - 1
    if own < 0 or number < 2 or not scene.movable[i]:
        return False
    begin = int(next_uniform(rng) * number)
    for k in range(number):
        other = (begin + k) % number
        in_reach = other != own
        for joint in range(2):
            angle = scene.options[i, other, joint] - scene.start[i, joint]
            in_reach &= least_intervals(angle, scene.speed[i, joint] * step_s) <= last
        if not in_reach:
            continue
        choice[i] = other
        clear = True
        for e in range(scene.near.offsets[i], scene.near.offsets[i + 1]):
            j = scene.near.body[e]
            if changed[j] or not scene.movable[j]:
                required = plan.required[scene.near.pair[e]]
                clear &= _ends_clear(scene, plan, i, j, required, choice)
        if clear:
            changed[i] = True
            return True
    choice[i] = own
    return False


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _ends_clear(scene, plan, i, j, required, choice):
    # whether a robot and a neighbour keep the gap at the ends of their choices
    theta, phi = scene.options[i, choice[i]]
    last = plan.q.shape[2] - 1
    theta_j, phi_j = plan.q[j, 0, last], plan.q[j, 1, last]
    if j < len(choice) and choice[j] >= 0:
        theta_j, phi_j = scene.options[j, choice[j]]
    return pair_gap_below(scene.bodies, i, j, theta, phi, theta_j, phi_j, required) >= required
