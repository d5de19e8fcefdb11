"""Which targets can be reached at all among what cannot move: a rule, not a planner's opinion."""

import math

import numba as nb
import numpy as np

from fiber_core import kinematics
from fiber_core.clearance import bodies_of, pair_gap_below
from fiber_core.problem import Problem

__all__ = ["reachable"]

_CELL_RAD = math.radians(4.0)


def reachable(problem: Problem, pairs, margin_mm: float) -> np.ndarray:
    """Return which robots could reach their targets if only those that cannot move were there.

    A robot with a target is reachable when one of its configurations on the target keeps
    the margin from all disabled robots and obstacles, and when it could get there alone
    between them. The second is decided on a grid over the robot's joint ranges: a cell
    is open when some point of it may keep the margin, so a target called unreachable is
    proven to be; one called reachable may still be closed off by a gap finer than the
    grid (4 degrees).

    Args:
        problem: the plane, where its robots are, where their fibres should go.
        pairs: rows a < b that can meet, from neighbour_pairs, shape (p, 2).
        margin_mm: gap to keep from what cannot move [mm].

    Returns:
        Flags, shape (n,); False where nothing is asked or the robot is disabled.
    """
    plane = problem.plane
    angles, valid = kinematics.inverse(plane, problem.targets)
    valid &= plane.enabled[:, None]
    result = valid.any(axis=1)
    fixed = np.concatenate([~plane.enabled, np.ones(len(plane.obstacles), dtype=bool)])
    pairs = np.asarray(pairs, dtype=np.int64).reshape(-1, 2)
    both = np.concatenate([pairs, pairs[:, ::-1]])
    both = both[~fixed[both[:, 0]] & fixed[both[:, 1]]]
    both = both[result[both[:, 0]]]
    if not len(both):
        return result
    both = both[np.lexsort(both.T[::-1])]
    robots, first = np.unique(both[:, 0], return_index=True)
    standing = np.concatenate([problem.start, np.zeros((len(plane.obstacles), 2))])
    bodies = bodies_of(plane)
    lever = np.stack([plane.reach_mm, bodies.phi_reach[: plane.n] + plane.phi_radius], axis=1)
    result[robots] = _reachable(
        bodies, lever, robots, np.append(first, len(both)), np.ascontiguousarray(both[:, 1]),
        standing, plane.limits, angles, valid, margin_mm,
    )  # fmt: skip
    return result


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _slack(bodies, i, theta, phi, others, standing, margin, enough):
    # least gap to what stands around, less the margin; `enough` or more need not be exact
    least = enough
    for j in others:
        gap = pair_gap_below(
            bodies, i, j, theta, phi, standing[j, 0], standing[j, 1], margin + enough
        )
        least = min(least, gap - margin)
    return least


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _cell(value, low, size, count):
    return min(count - 1, max(0, int((value - low) / size)))


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _straight_there(bodies, i, angles, valid, others, standing, margin, size):
    # Whether the straight line to one of the configurations keeps the margin at points less
    # than a cell apart: every cell it passes is open then, and the flood would get through.
    for option in range(len(angles)):
        if not valid[option]:
            continue
        theta, phi = standing[i]
        turn, bend = angles[option, 0] - theta, angles[option, 1] - phi
        steps = 1 + int(max(abs(turn) / max(size[0], 1e-9), abs(bend) / max(size[1], 1e-9)))
        free = True
        for k in range(steps + 1):
            share = k / steps
            slack = _slack(
                bodies, i, theta + share * turn, phi + share * bend, others, standing, margin, 1e-9
            )
            if slack < 0.0:
                free = False
                break
        if free:
            return True
    return False


@nb.njit(cache=True, error_model="numpy")
def _reachable(bodies, lever, robots, first, other, standing, limits, angles, valid, margin):
    result = np.zeros(len(robots), dtype=np.bool_)
    for r in range(len(robots)):
        i = robots[r]
        others = other[first[r] : first[r + 1]]
        low = np.empty(2)
        size = np.empty(2)
        count = np.empty(2, dtype=np.int64)
        for joint in range(2):
            low[joint] = min(limits[i, joint, 0], standing[i, joint])
            span = max(limits[i, joint, 1], standing[i, joint]) - low[joint]
            count[joint] = max(1, int(math.ceil(span / _CELL_RAD)))
            size[joint] = span / count[joint]
        # from the middle of a cell to its corner no point of the robot moves farther
        corner = 0.5 * (size[0] * lever[i, 0] + size[1] * lever[i, 1])
        wanted = np.zeros((count[0], count[1]), dtype=np.bool_)
        left = 0
        for option in range(angles.shape[1]):
            if valid[i, option]:
                theta, phi = angles[i, option]
                if _slack(bodies, i, theta, phi, others, standing, margin, 1e-9) >= 0.0:
                    wanted[
                        _cell(theta, low[0], size[0], count[0]),
                        _cell(phi, low[1], size[1], count[1]),
                    ] = True
                    left += 1
        if left == 0:
            continue
        if _straight_there(bodies, i, angles[i], valid[i], others, standing, margin, size):
            result[r] = True
            continue
        # flood the open cells from the start until a wanted one is met
        seen = np.zeros((count[0], count[1]), dtype=np.bool_)
        stack = np.empty((count[0] * count[1], 2), dtype=np.int64)
        stack[0, 0] = _cell(standing[i, 0], low[0], size[0], count[0])
        stack[0, 1] = _cell(standing[i, 1], low[1], size[1], count[1])
        seen[stack[0, 0], stack[0, 1]] = True
        top = 1
        while top > 0 and not result[r]:
            top -= 1
            u, v = stack[top]
            if wanted[u, v]:
                result[r] = True
                break
            for du in range(-1, 2):
                for dv in range(-1, 2):
                    x, y = u + du, v + dv
                    if 0 <= x < count[0] and 0 <= y < count[1] and not seen[x, y]:
                        seen[x, y] = True
                        theta = low[0] + (x + 0.5) * size[0]
                        phi = low[1] + (y + 0.5) * size[1]
                        if _slack(bodies, i, theta, phi, others, standing, margin, 1e-9) >= -corner:
                            stack[top] = x, y
                            top += 1
    return result
