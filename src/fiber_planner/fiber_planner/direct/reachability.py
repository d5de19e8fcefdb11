# SPDX-License-Identifier: Apache-2.0
"""Reachability test: which targets can be attained among static obstacles, by any planner."""

import math
from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from fiber_core import kinematics
from fiber_core.array_types import Bools, Floats, Mask
from fiber_core.clearance import bodies_of, levers_of, neighbours_of, pair_gap_below
from fiber_core.problem import Problem
from fiber_core.threads import share_out

__all__ = ["reachable"]

_BLOCK = 8  # cells on a side of the largest block that is decided at once
_FINER = 0.25  # of cells, where it is not sure that a way is wide enough
_HALVINGS = 3  # of a block until it is a cell
_CELL_RAD = math.radians(0.5)
_LEAST_ROBOTS = 4  # of a thread: fewer are done sooner than it begins
_MEASURED_MM = 1e-3  # a pair that starts too close must keep its gap less this, see `Safety`
_ANY_MM = 1e-9  # the slack that matters if only its sign does


class _Cells(NamedTuple):
    # A grid over the joint ranges, decided block by block: lowest angle and cell size of both
    # joints [rad]; which cells may have a point that keeps the margin, of which the middle does,
    # and which blocks are decided.
    low: Floats
    size: Floats
    is_open: Bools
    is_sure: Bools
    is_known: Bools


def reachable(
    problem: Problem, pairs: ArrayLike, margin_mm: float, finest_rad: float = _CELL_RAD
) -> Mask:
    """Return which robots can reach their targets if only static bodies are around them.

    Static bodies are disabled robots and obstacles. A robot is reachable when one of its
    configurations on the target keeps the margin from all static bodies, and when it can get
    there alone between them. The second is decided on a grid over the joint ranges: a
    cell is open when some point of it may keep the margin. So a target that is reported as
    unreachable is proven to be; one that is reported as reachable may still be closed off by
    a passage narrower than the grid. From a static body that is nearer than the margin at the
    start the gap at the start is kept, as `Safety` requires.

    Args:
        problem: the plane, the present joint angles and the targets.
        pairs: rows a < b that can collide, from neighbour_pairs, shape (p, 2).
        margin_mm: gap to keep from static bodies [mm].
        finest_rad: cells become smaller down to this size [rad] where a way leads through cells
            that may be open, and none through cells with a middle that keeps the margin.

    Returns:
        Flags, shape (n,); False for a robot that has no target or is disabled.
    """
    plane = problem.plane
    angles, valid = kinematics.inverse(plane, problem.targets)
    valid &= plane.enabled[:, None]
    result = np.asarray(valid.any(axis=1))
    fixed = np.concatenate([~plane.enabled, np.ones(plane.fixtures, dtype=bool)])
    pairs = np.asarray(pairs, dtype=np.int64).reshape(-1, 2)
    pairs = pairs[fixed[pairs[:, 0]] != fixed[pairs[:, 1]]]
    near = neighbours_of(plane.n, pairs, by_row=True)
    robots = np.flatnonzero(result & (near.parts.counts > 0))
    standing = np.concatenate([problem.start, np.zeros((plane.fixtures, 2))])
    bodies, levers, found = bodies_of(plane), levers_of(plane), np.zeros(len(robots), dtype=bool)

    def decide(first: int, last: int) -> None:
        _reachable(
            bodies, levers, robots[first:last], near,
            standing, plane.limits, angles, valid, margin_mm, finest_rad, found[first:last],
        )  # fmt: skip

    share_out(decide, len(robots), _LEAST_ROBOTS)
    result[robots] = found
    return result


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _slack(bodies, i, theta, phi, others, standing, margins, enough):
    # least gap to the static bodies, less their margins; `enough` or more need not be exact
    least = enough
    for k in range(len(others)):
        j, margin = others[k], margins[k]
        gap = pair_gap_below(
            bodies, i, j, theta, phi, standing[j, 0], standing[j, 1], margin + enough
        )
        least = min(least, gap - margin)
    return least


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _margins(bodies, i, others, standing, margin):
    # the gap to keep from each static body
    margins = np.empty(len(others))
    theta, phi = standing[i]
    for k in range(len(others)):
        x, y = standing[others[k]]
        gap = pair_gap_below(bodies, i, others[k], theta, phi, x, y, margin)
        margins[k] = margin if gap >= margin else gap - _MEASURED_MM
    return margins


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _cell(value, low, size, count):
    return min(count - 1, max(0, int((value - low) / size)))


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _simple_path_is_open(bodies, i, lever, angles, valid, others, standing, limits, margin, size):
    # Whether a way to one of the configurations keeps the margin at points less than a cell apart:
    # the straight one, or that of an arm which folds, turns, and unfolds. Every cell on it is
    # open then, and the flood would pass too.
    begin = standing[i]
    for option in range(len(angles)):
        if valid[option]:
            end = angles[option]
            if _leg_is_open(bodies, i, lever, begin, end, others, standing, margin, size):
                return True
    first, last = np.empty(2), np.empty(2)
    for option in range(len(angles)):
        if not valid[option]:
            continue
        end = angles[option]
        first[0], last[0] = begin[0], end[0]
        for side in (math.pi, -math.pi):
            first[1] = last[1] = min(max(side, limits[1, 0]), limits[1, 1])
            if (
                _leg_is_open(bodies, i, lever, begin, first, others, standing, margin, size)
                and _leg_is_open(bodies, i, lever, first, last, others, standing, margin, size)
                and _leg_is_open(bodies, i, lever, last, end, others, standing, margin, size)
            ):
                return True
    return False


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _leg_is_open(bodies, i, lever, begin, end, others, standing, margin, size):
    # Whether the straight line between two configurations keeps the margin, as above. No point of
    # the robot moves farther from one of these points to the next than `stride`, so the next ones
    # keep the margin by themselves for as long as the slack lasts.
    turn, bend = end[0] - begin[0], end[1] - begin[1]
    steps = 1 + int(max(abs(turn) / max(size[0], 1e-9), abs(bend) / max(size[1], 1e-9)))
    stride = (lever[0] * abs(turn) + lever[1] * abs(bend)) / steps
    k = 0
    while k <= steps:
        share = k / steps
        slack = _slack(
            bodies, i, begin[0] + share * turn, begin[1] + share * bend,
            others, standing, margin, (steps - k) * stride + _ANY_MM,
        )  # fmt: skip
        if slack < 0.0:
            return False
        k += 1 + int(min(max(0.0, slack - _ANY_MM) / max(stride, _ANY_MM), steps))
    return True


@nb.njit(cache=True, error_model="numpy", nogil=True)
def _reachable(
    bodies, levers, robots, near, standing, limits, angles, valid, margin_mm, finest_rad, result
):  # fmt: skip
    for k in range(len(robots)):
        i = robots[k]
        others = near.body[near.offsets[i] : near.offsets[i + 1]]
        margin = _margins(bodies, i, others, standing, margin_mm)
        cell = _CELL_RAD
        goal = np.zeros(angles.shape[1], dtype=np.bool_)  # configurations that keep the margin
        for option in range(angles.shape[1]):
            if valid[i, option]:
                theta, phi = angles[i, option]
                slack = _slack(bodies, i, theta, phi, others, standing, margin, _ANY_MM)
                goal[option] = slack >= 0.0
        while goal.any():
            low, size, count = _grid(limits[i], standing[i], cell)
            if cell == _CELL_RAD and _simple_path_is_open(
                bodies, i, levers[i], angles[i], valid[i], others, standing, limits[i], margin, size
            ):
                result[k] = True
                break
            cells = _unknown_cells(low, size, count)
            u = _cell(standing[i, 0], low[0], size[0], count[0])
            v = _cell(standing[i, 1], low[1], size[1], count[1])
            goals = np.zeros(cells.is_open.shape, dtype=np.bool_)  # with such a configuration
            for option in np.flatnonzero(goal):
                theta, phi = angles[i, option]
                goals[
                    _cell(theta, low[0], size[0], count[0]), _cell(phi, low[1], size[1], count[1])
                ] = True
            about = bodies, i, levers[i], others, standing, margin
            result[k] = _flood(cells, False, about, u, v, goals)
            if not result[k] or cell <= finest_rad or _flood(cells, True, about, u, v, goals):
                break
            cell *= _FINER


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _grid(limits, standing, cell_rad):
    # lowest angle, cell size [rad] and number of cells of both joints; the start is on the grid
    low, size, count = np.empty(2), np.empty(2), np.empty(2, dtype=np.int64)
    for joint in range(2):
        low[joint] = min(limits[joint, 0], standing[joint])
        span = max(limits[joint, 1], standing[joint]) - low[joint]
        count[joint] = _BLOCK * max(1, int(math.ceil(span / (_BLOCK * cell_rad))))
        size[joint] = span / count[joint]
    return low, size, count


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _unknown_cells(low, size, count):
    is_open = np.zeros((count[0], count[1]), dtype=np.bool_)
    is_known = np.zeros((count[0] // _BLOCK, count[1] // _BLOCK), dtype=np.bool_)
    return _Cells(low, size, is_open, np.zeros_like(is_open), is_known)


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _decide_block(cells, about, u, v):
    # Which cells of a block may have a point that keeps the margin, and of which the middle does. A
    # block that is open or closed as a whole is decided at once, others are quartered.
    bodies, i, lever, others, standing, margin = about
    low, size = cells.low, cells.size
    stack = np.empty((4 * _HALVINGS + 1, 3), dtype=np.int64)
    stack[0], top = (u, v, _BLOCK), 1
    while top > 0:
        top -= 1
        x, y, width = stack[top]
        theta, phi = low[0] + (x + 0.5 * width) * size[0], low[1] + (y + 0.5 * width) * size[1]
        # from the middle of a block to its corner no point of the robot moves farther
        corner = 0.5 * width * (size[0] * lever[0] + size[1] * lever[1])
        slack = _slack(bodies, i, theta, phi, others, standing, margin, corner + _ANY_MM)
        if slack < -corner:
            continue
        if slack >= corner or width == 1:
            cells.is_open[x : x + width, y : y + width] = True
            cells.is_sure[x : x + width, y : y + width] = slack >= 0.0
            continue
        half = width // 2
        for part in range(4):
            stack[top] = x + half * (part // 2), y + half * (part % 2), half
            top += 1


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _flood(cells, sure, about, u, v, goals):
    # Flood open cells, or sure ones and goals, from one of them; whether a goal cell is met. Blocks
    # are decided when the flood comes to them, and it goes towards a goal first.
    passable = cells.is_sure if sure else cells.is_open
    visited = np.zeros(passable.shape, dtype=np.bool_)
    stack = np.empty((passable.size, 2), dtype=np.int64)
    aims_u, aims_v = np.nonzero(goals)
    stack[0], top = (u, v), 1
    visited[u, v] = True
    while top > 0:
        top -= 1
        u, v = stack[top]
        if goals[u, v]:
            return True
        to_u, to_v = 1 if aims_u[0] >= u else -1, 1 if aims_v[0] >= v else -1
        for x in (u - to_u, u, u + to_u):
            for y in (v - to_v, v, v + to_v):
                outside = x < 0 or y < 0 or x >= passable.shape[0] or y >= passable.shape[1]
                if outside or visited[x, y]:
                    continue
                visited[x, y] = True
                m, n = x // _BLOCK, y // _BLOCK
                if not cells.is_known[m, n]:
                    cells.is_known[m, n] = True
                    _decide_block(cells, about, m * _BLOCK, n * _BLOCK)
                if passable[x, y] or (sure and goals[x, y]):
                    stack[top] = x, y
                    top += 1
    return False
