"""Fewer segments: robots drop the breaks of their profiles that nobody needs."""

import numba as nb
import numpy as np

from fiber_planner.direct.plan_state import adopt, most_neighbours, weigh, worst_first
from fiber_planner.direct.profile_sampling import copy_profile, trapezoid

__all__ = ["simplify"]

_STRAIGHT_RAD = 1e-9


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _breaks(row, out):
    # grid times at which a profile changes its speed, start and arrival included; how many
    last = len(row) - 1
    while last > 0 and row[last - 1] == row[last]:
        last -= 1
    out[0] = 0
    count = 1
    for k in range(1, last):
        if abs(row[k + 1] - 2.0 * row[k] + row[k - 1]) > _STRAIGHT_RAD:
            out[count] = k
            count += 1
    out[count] = last
    return count + 1 if last > 0 else 0


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _is_straight(draft, i):
    # whether a robot goes on one line per motor to where it should end
    last = draft.q.shape[2] - 1
    for joint in range(2):
        s, g = draft.q[i, joint, 0], draft.q[i, joint, last]
        if draft.choice[i] < 0 and g != s:
            return False
        slope = (g - s) / last
        for k in range(1, last):
            if abs(s + slope * k - draft.q[i, joint, k]) > _STRAIGHT_RAD:
                return False
    return True


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _whole(crowd, draft, i, profile, order, depths):
    # straight lines all the way; False where the robot meets somebody
    last = profile.shape[1] - 1
    for joint in range(2):
        s = draft.q[i, joint, 0]
        g = draft.q[i, joint, last] if draft.choice[i] >= 0 else s
        trapezoid(profile[joint], s, g, g, 0, last, last, last)
    return weigh(crowd, draft, i, profile, 0.0, order, depths) == 0.0


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _without_one(crowd, draft, i, joint, at, breaks, profile, order, depths):
    # the profile without its break number `at`: a line from the one before to the one after
    copy_profile(draft.q[i], profile)
    row = profile[joint]
    begin, end = breaks[at - 1], breaks[at + 1]
    for k in range(begin + 1, end):
        row[k] = row[begin] + (row[end] - row[begin]) * ((k - begin) / (end - begin))
    return weigh(crowd, draft, i, profile, 0.0, order, depths) == 0.0


@nb.njit(cache=True, error_model="numpy")
def simplify(crowd, draft):
    """Let robots of a plan without conflict go straight where that is clear, piece by piece.

    A robot first tries one line per motor over the whole time. Where that meets somebody
    it tries to drop its breaks one at a time. A line that joins two pieces is never faster
    than the faster of them, and stays between their ends. Who was tried before is tried
    again only where something around changed since.

    Args:
        crowd: the robots.
        draft: the plan; profiles, depths and legs are written.

    Returns:
        Number of robots that were simplified.
    """
    steps = draft.q.shape[2]
    profile = np.empty((2, steps))
    depths = np.empty(most_neighbours(crowd))
    order = np.empty(len(depths), dtype=np.int64)
    breaks = np.empty(steps + 1, dtype=np.int64)
    changed = 0
    for i in range(len(crowd.start)):
        if not (crowd.movable[i] and draft.around[i]):
            continue
        draft.around[i] = False
        if _is_straight(draft, i):
            continue
        worst_first(crowd, draft, i, order)
        simpler = False
        if _whole(crowd, draft, i, profile, order, depths):
            adopt(crowd, draft, i, profile, depths)
            simpler = True
        for joint in range(2):
            count = _breaks(draft.q[i, joint], breaks)
            at = 1
            while at < count - 1:
                if _without_one(crowd, draft, i, joint, at, breaks, profile, order, depths):
                    adopt(crowd, draft, i, profile, depths)
                    simpler = True
                    count = _breaks(draft.q[i, joint], breaks)
                    at = max(1, at - 1)
                else:
                    at += 1
        if simpler:
            draft.legs[i, 0] = draft.legs[i, 1] = 0
            changed += 1
    return changed
