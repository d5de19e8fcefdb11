# SPDX-License-Identifier: Apache-2.0
"""Collision cost: how deep and how long two moving robots are closer than they may be."""

import numba as nb

from fiber_core.array_types import Floats
from fiber_core.clearance import Bodies, pair_gap_below

__all__ = ["collision_cost", "least_cost_at"]

_FINE_MM = 0.3  # smallest relative displacement between two evaluations of a pair
# The same of a pair that starts too close, while it parts: it may not come nearer than it starts,
# and a robot that turns away can do so for its first micrometres.
_FINE_EARLY_MM = 5e-4
_DEEPEST = 15.0  # number of intervals for which the largest depth counts
_FAR_MM = 2.0  # a gap larger than required + this need not be known exactly


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _stride(lever, i, q, k):
    # The largest displacement of any point of robot i in interval k [mm]. A point of the phi
    # link turns with theta about the centre and with theta + phi about the elbow.
    theta = q[0, k + 1] - q[0, k]
    phi = q[1, k + 1] - q[1, k]
    outer = lever[i, 0] * abs(theta) + lever[i, 1] * abs(theta + phi)
    return max(outer, lever[i, 2] * abs(theta))


@nb.njit(cache=True, error_model="numpy")
def collision_cost(
    bodies: Bodies,
    lever: Floats,
    a: int,
    b: int,
    qa: Floats,
    qb: Floats,
    required: float,
    required_early: float,
    release: int,
    limit: float,
) -> tuple[float, int]:
    """Return the collision cost of two robots during a motion, and when they are nearest.

    The cost is 0 if they keep their gap.

    The cost is the integral of max(0, required - gap) over time [mm x intervals] plus
    _DEEPEST times the largest value of max(0, required - gap). Without the second term the
    cheapest way past each other would be the fastest way through each other.

    The time step is that of conservative advancement: after a gap that exceeds the required
    one by s, the pair is evaluated again when its points may have closed in by s, and not
    before they have moved by _FINE_MM, or _FINE_EARLY_MM before `release`. So a graze shorter
    than that step can be missed, and a crossing cannot. The depth at the last instant counts as
    if it lasted one interval.

    Args:
        bodies: outlines, from bodies_of.
        lever: as in Scene.
        a, b: rows of the two bodies.
        qa, qb: their joint angles on the common grid [rad], shape (2, k + 1).
        required: gap that they must keep [mm].
        required_early: gap that they must keep before the grid time `release` [mm], at most
            `required`.
        release: grid time from which they must keep `required`.
        limit: value above which the exact result does not matter.

    Returns:
        The cost, and the grid time nearest to the greatest depth that was found, -1 without.
    """
    last = qa.shape[1] - 1
    k, w = 0, 0.0  # the present instant is the fraction w of interval k
    total, deepest, when = 0.0, 0.0, -1
    while True:
        if k == last:
            theta_a, phi_a, theta_b, phi_b = qa[0, k], qa[1, k], qb[0, k], qb[1, k]
        else:
            theta_a = qa[0, k] + w * (qa[0, k + 1] - qa[0, k])
            phi_a = qa[1, k] + w * (qa[1, k + 1] - qa[1, k])
            theta_b = qb[0, k] + w * (qb[0, k + 1] - qb[0, k])
            phi_b = qb[1, k] + w * (qb[1, k + 1] - qb[1, k])
        need, fine_mm = (required_early, _FINE_EARLY_MM) if k < release else (required, _FINE_MM)
        slack = pair_gap_below(bodies, a, b, theta_a, phi_a, theta_b, phi_b, need + _FAR_MM) - need
        if k == last:
            when = last if -slack > deepest else when
            return total + max(0.0, -slack) + _DEEPEST * max(deepest, -slack), when
        if slack < 0.0:
            stride = _stride(lever, a, qa, k) + _stride(lever, b, qb, k)
            step = 1.0 - w
            if stride > 0.0:
                step = min(step, max(-slack, fine_mm) / stride)
            total -= slack * step
            if -slack > deepest:
                deepest, when = -slack, k if w < 0.5 else k + 1
            if total + _DEEPEST * deepest > limit:
                return total + _DEEPEST * deepest, when
            w += step
            if w >= 1.0 - 1e-9:
                k, w = k + 1, 0.0
        else:
            slack = max(slack, fine_mm)
            while k < last:
                stride = _stride(lever, a, qa, k) + _stride(lever, b, qb, k)
                if (1.0 - w) * stride > slack:
                    w += slack / stride
                    break
                slack -= (1.0 - w) * stride
                k, w = k + 1, 0.0
                if k == release:
                    break


@nb.njit(cache=True, error_model="numpy")
def least_cost_at(
    bodies: Bodies,
    a: int,
    b: int,
    qa: Floats,
    qb: Floats,
    required: float,
    required_early: float,
    release: int,
    k: int,
) -> float:
    """Return the collision cost that two robots have by their gap at one grid time alone.

    Arguments as for collision_cost; k is the grid time.
    """
    need = required_early if k < release else required
    gap = pair_gap_below(bodies, a, b, qa[0, k], qa[1, k], qb[0, k], qb[1, k], need)
    return _DEEPEST * max(0.0, need - gap)
