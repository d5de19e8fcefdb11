"""The first draft of a plan: who ends where, everybody straight, what must stay apart."""

from typing import NamedTuple

import numba as nb
import numpy as np

from fiber_core.clearance import gaps, levers_of, point_speeds
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_planner.direct.parameters import DirectParameters
from fiber_planner.direct.plan_state import Draft
from fiber_planner.direct.reachability import reachable
from fiber_planner.direct.scene import Scene
from fiber_planner.direct.time_grid import TimeGrid
from fiber_planner.goal_selection import choose_goals

__all__ = ["Ends", "choose_ends", "straight_draft"]

_EPS_MM = 1e-6
_UNTANGLING = 0.25  # share of the time alone in which a pair has to get apart
_LEAST_TURN_RAD = 0.1  # where nobody has to move: time to get out of the way


class Ends(NamedTuple):
    """Where robots should end, and who cannot.

    Args:
        reason: Reason of each robot as far as it is known, shape (n,).
        choice: the option each ends in, -1 where it may end anywhere, shape (n,).
        angles: joint angles there; the start where it may end anywhere [rad], shape (n, 2).
        alone_s: time the slowest robot needs if it is alone [s].
    """

    reason: np.ndarray
    choice: np.ndarray
    angles: np.ndarray
    alone_s: float


def choose_ends(problem: Problem, crowd: Scene, parameters: DirectParameters) -> Ends:
    """Choose a clear option for every robot whose target can be reached.

    Args:
        problem: the plane, where its robots are, where their fibres should go.
        crowd: the same as the search sees it.
        parameters: what to keep apart.
    """
    rows = np.arange(problem.plane.n)
    reason = _reasons(problem, crowd, parameters.margin_mm)
    seeking = reason == Reason.OK
    time = (np.abs(crowd.option - problem.start[:, None]) / crowd.speed[:, None]).max(axis=2)
    alone_s = float(time[seeking, 0].max(initial=0.0))
    if alone_s == 0.0:
        alone_s = float((_LEAST_TURN_RAD / crowd.speed).max(initial=0.0))
    choice = _clear_options(problem, crowd, parameters, alone_s)
    choice[time[rows, choice] > alone_s] = 0
    choice[~seeking] = -1
    angles = np.where(seeking[:, None], crowd.option[rows, choice], problem.start)
    return Ends(reason, choice, angles, alone_s)


def straight_draft(
    problem: Problem, crowd: Scene, parameters: DirectParameters, ends: Ends, grid: TimeGrid
) -> tuple[Draft, np.ndarray]:
    """Let every robot go straight to its end, all in the same time.

    Args:
        problem: the plane, where its robots are, where their fibres should go.
        crowd: the same as the search sees it.
        parameters: what to keep apart.
        ends: where robots should end.
        grid: the instants of the draft.

    Returns:
        The draft, not measured, and the pairs that start closer than they should be, (p,).
    """
    plane, n = problem.plane, problem.plane.n
    # numpy asks the system for huge pages, numba does not
    q = np.empty((len(crowd.movable), 2, grid.intervals + 1))
    _go_straight(problem.start, ends.angles, q)

    # What safety asks at the speeds of this draft. Who goes faster later may need more, which
    # the certificate tells; to ask it of all would leave many pairs no room at their ends.
    speeds = np.minimum(np.abs(ends.angles - problem.start) / grid.makespan_s, plane.speeds)
    least = _least_mm(crowd, parameters, plane, speeds, grid.makespan_s)
    at_start = gaps(plane, crowd.pairs, problem.start) - _EPS_MM
    at_end = gaps(plane, crowd.pairs, ends.angles) - _EPS_MM
    tangled = at_start < least
    wanted = np.minimum(least + parameters.allowance_mm, at_end)
    wanted = np.where(tangled, wanted, np.minimum(wanted, at_start))
    required = np.maximum(wanted, least)
    required[~crowd.movable[crowd.pairs].any(axis=1)] = -np.inf  # nothing can be done there
    release = max(1, round(_UNTANGLING * ends.alone_s / grid.step_s))
    draft = Draft(
        q=q,
        choice=ends.choice.astype(np.int64),
        required=required,
        early=np.minimum(required, at_start),
        release=np.where(tangled, min(release, grid.intervals), 0),
        weight=np.ones(len(required)),
        depth=np.zeros(len(required)),
        legs=np.zeros((n, 2), dtype=np.int64),
        changed=np.ones(len(q), dtype=bool),
        around=np.zeros(len(q), dtype=bool),  # there is nothing simpler
    )
    return draft, tangled


@nb.njit(cache=True)
def _go_straight(start, end, q):
    # angles on the way from start to end, (b, 2, k + 1); obstacles have none
    intervals = q.shape[2] - 1
    for i in range(len(q)):
        for joint in range(2):
            s = start[i, joint] if i < len(start) else 0.0
            g = end[i, joint] if i < len(start) else 0.0
            for k in range(intervals):
                q[i, joint, k] = s + (g - s) * (k / intervals)
            q[i, joint, intervals] = g


def _reasons(problem, crowd, margin_mm):
    plane, asked = problem.plane, problem.asked
    reason = np.full(plane.n, int(Reason.OK))
    reason[~asked] = Reason.NO_TARGET
    reason[asked & ~plane.enabled] = Reason.DISABLED
    blocked = asked & plane.enabled & ~reachable(problem, crowd.pairs, margin_mm)
    reason[blocked] = Reason.GOAL_BLOCKED
    return reason


def _clear_options(problem, crowd, parameters, alone_s):
    # The option of each robot nearest to what choose_goals would have it end in. Goals that
    # leave the allowance are better, unless robots would have to be given up for it.
    least = parameters.margin_mm + parameters.allowance_mm
    plane = problem.plane
    most = _least_mm(crowd, parameters, plane, plane.speeds, 2.0 * alone_s).max(initial=0.0)
    goal, reason = choose_goals(problem, max(least, most + parameters.allowance_mm))
    if (reason == Reason.GOAL_BLOCKED).any():
        other, other_reason = choose_goals(problem, least)
        if (other_reason == Reason.GOAL_BLOCKED).sum() < (reason == Reason.GOAL_BLOCKED).sum():
            goal = other
    away = np.abs(crowd.option - goal[:, None]).max(axis=2)
    away[np.arange(crowd.option.shape[1]) >= crowd.options[:, None]] = np.inf
    return away.argmin(axis=1)


def _least_mm(crowd, parameters, plane, speed_rad_s, makespan_s):
    # the gap Safety asks of each pair at some joint speeds, were nobody too close at the start
    speeds = point_speeds(levers_of(plane), speed_rad_s * crowd.movable[: plane.n, None])
    return parameters.safety.required_at(speeds, makespan_s, crowd.pairs)
