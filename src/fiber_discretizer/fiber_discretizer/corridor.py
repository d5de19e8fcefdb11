"""The tube of a joint: how far it may turn either way, sample by sample, beside its neighbours."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from fiber_core.clearance import posed_gap

__all__ = ["Neighbours", "free_corridors", "neighbours_of"]

_STEPS = 24  # a wall is approached in at most so many steps
_FINEST_RAD = 2e-3  # and no closer than this
_OUT_RAD = 0.02  # least step out of a neighbour


class Neighbours(NamedTuple):
    """Who is beside each robot, ragged by robot.

    Args:
        offsets: first neighbour of each robot, shape (n + 1,).
        body: rows of neighbours, robots and obstacles, shape (2 p,).
        pair: the pair each comes from, shape (2 p,).
    """

    offsets: np.ndarray
    body: np.ndarray
    pair: np.ndarray


def neighbours_of(n: int, pairs) -> Neighbours:
    """Return who is beside each of n robots, from pairs of rows, shape (p, 2)."""
    pairs = np.asarray(pairs, dtype=np.int64).reshape(-1, 2)
    me, other = np.concatenate([pairs, pairs[:, ::-1]]).T
    pair = np.tile(np.arange(len(pairs)), 2)
    keep = np.flatnonzero(me < n)
    keep = keep[np.argsort(me[keep], kind="stable")]
    offsets = np.searchsorted(me[keep], np.arange(n + 1))
    return Neighbours(offsets, other[keep], pair[keep])


@njit(cache=True)
def free_corridors(
    table, levers, limits, profiles, beside, required, rows, joint, times, wish, side, reach
):
    """Return the walls of the free space of one joint, with everything else as it is.

    The gap changes by no more than the lever times the turn, so a step of gap / lever
    touches nobody: the walls are approached in such steps (sphere tracing, Hart 1996) and
    never crossed. Where the joint is not free as wished, the tube passes on one side of
    what is in the way. Between samples nothing is known.

    Args:
        table: outlines, from bodies_of.
        levers: farthest point of a robot from the axis of each joint [mm], shape (n, 2).
        limits: joint limits [rad], shape (n, 2, 2).
        profiles: motion of everybody else, from profiles_of.
        beside: from neighbours_of.
        required: gap each pair must keep [mm], shape (p,).
        rows: robots concerned, shape (m,).
        joint: whose tube, 0 theta, 1 phi.
        times: sample times of each robot [s], shape (m, t).
        wish: its angles there [rad], shape (m, 2, t).
        side: where to pass what is in the way: +1 at higher angles, -1 at lower ones, 0 not
            at all.
        reach: how far the walls may be from the wish, or from where it is free [rad].

    Returns:
        Low and high walls [rad], shape (m, t), and whether each tube is open, shape (m,).
    """
    m, t = times.shape
    low, high = wish[:, joint].copy(), wish[:, joint].copy()
    is_open = np.ones(m, np.bool_)
    most = np.diff(beside.offsets).max()
    poses, work = np.empty((most, 4)), np.empty((2, most))
    for r in range(m):
        i = rows[r]
        first, count = beside.offsets[i], beside.offsets[i + 1] - beside.offsets[i]
        bodies, pairs = beside.body[first : first + count], beside.pair[first : first + count]
        there = (table, i, bodies, required[pairs], poses, work)
        lever, bottom, top = levers[i, joint], limits[i, joint, 0], limits[i, joint, 1]
        away, begin = False, wish[r, joint, 0]
        for k in range(t):
            # Free as wished, or else where the sample before was free.
            wished = wish[r, joint, k]
            begin = begin if away and k < t - 1 else wished
            for q in range(count):
                _pose(profiles, bodies[q], times[r, k], poses[q])
            way = side if 0 < k < t - 1 else 0
            other = wish[r, 1 - joint, k]
            begin, low[r, k], high[r, k] = _free_interval(
                there, joint, other, begin, lever, bottom, top, way, reach
            )
            away = not low[r, k] <= wished <= high[r, k]
            if begin == np.inf:
                is_open[r] = False
                break
            # If that is on the other side of something, it had to be so before.
            back, begin_back = k, begin
            while back > 0 and (
                low[r, back] > high[r, back - 1] or high[r, back] < low[r, back - 1]
            ):
                back -= 1
                for q in range(count):
                    _pose(profiles, bodies[q], times[r, back], poses[q])
                begin_back, low[r, back], high[r, back] = _free_interval(
                    there,
                    joint,
                    wish[r, 1 - joint, back],
                    begin_back,
                    lever,
                    bottom,
                    top,
                    side,
                    reach,
                )
                if begin_back == np.inf or back == 0:
                    is_open[r] = False
                    break
            if not is_open[r]:
                break
    return low, high, is_open


@njit(cache=True)
def _free_interval(there, joint, other, begin, lever, bottom, top, side, reach):
    # Free angles of a joint at one instant around the first free one from `begin` on, in the
    # direction `side`: that one and the walls, or infinity where there is none.
    table, i, bodies, required, poses, work = there
    room, bound = work[0], work[1]
    count = len(bodies)
    angles = np.empty(2)
    angles[joint], angles[1 - joint] = begin, other
    nearest = np.inf
    for q in range(count):
        room[q] = _room(table, i, bodies[q], angles, poses[q], required[q])
        nearest = min(nearest, room[q])
    while nearest < 0.0:
        if side == 0:
            return np.inf, begin, begin
        q = np.argmin(room[:count])  # out of the worst, then see who is left
        while room[q] < 0.0:
            if not bottom <= angles[joint] <= top:
                return np.inf, begin, begin
            angles[joint] += side * max(-room[q] / lever, _OUT_RAD)
            room[q] = _room(table, i, bodies[q], angles, poses[q], required[q])
        nearest = np.inf
        for q in range(count):
            room[q] = _room(table, i, bodies[q], angles, poses[q], required[q])
            nearest = min(nearest, room[q])
    here = angles[joint]
    if not bottom <= here <= top:
        return (here, here, here) if here == begin else (np.inf, begin, begin)
    low, high = here, here
    for way in (-1, 1):
        # Each neighbour allows some way; only who allows least is looked at again.
        far = min(here - bottom if way < 0 else top - here, reach)
        for q in range(count):
            bound[q] = room[q] / lever
        steps, gone = 0, far
        while True:
            q, gone = -1, far
            for o in range(count):
                if bound[o] < gone:
                    q, gone = o, bound[o]
            if q < 0 or steps == _STEPS:
                break
            steps += 1
            angles[joint] = here + way * gone
            more = _room(table, i, bodies[q], angles, poses[q], required[q]) / lever
            if more < _FINEST_RAD:
                break
            bound[q] = gone + more
        if way < 0:
            low = here - gone
        else:
            high = here + gone
    return here, low, high


@njit(cache=True)
def _pose(profiles, body, time, pose):
    # cosine and sine of theta, then of theta + phi, of a body at a time
    angle = 0.0
    for j in range(2):
        if body < len(profiles.start):
            here = profiles.start[body, j]
            for k in range(profiles.first[body, j], profiles.stop[body, j]):
                if profiles.begins_s[k] > time:
                    break
                passed = min(time, profiles.ends_s[k]) - profiles.begins_s[k]
                here = profiles.angle[k] + passed * profiles.velocity[k]
            angle += here
        pose[2 * j], pose[2 * j + 1] = math.cos(angle), math.sin(angle)


@njit(cache=True)
def _room(table, i, body, angles, pose, required):
    # gap to a neighbour less the gap required
    both = angles[0] + angles[1]
    return (
        posed_gap(
            table, i, body,
            math.cos(angles[0]), math.sin(angles[0]), math.cos(both), math.sin(both),
            pose[0], pose[1], pose[2], pose[3], np.inf,
        )
        - required
    )  # fmt: skip
