"""How deep and how long two moving robots are nearer to each other than they should be."""

import numba as nb

from fiber_core.clearance import pair_gap_below

__all__ = ["penetration"]

_FINE_MM = 0.3  # least relative displacement between two looks at a pair
_DEEPEST = 15.0  # intervals that the greatest depth counts for
_FAR_MM = 2.0  # gaps beyond required + this need not be known exactly


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _stride(lever, i, q, k):
    # The most any point of a robot is displaced in interval k [mm]. A point of the phi
    # link turns with theta about the centre and with theta + phi about the elbow.
    theta = q[0, k + 1] - q[0, k]
    phi = q[1, k + 1] - q[1, k]
    outer = lever[i, 0] * abs(theta) + lever[i, 1] * abs(theta + phi)
    return max(outer, lever[i, 2] * abs(theta))


@nb.njit(cache=True, error_model="numpy")
def penetration(bodies, lever, a, b, qa, qb, required, early, release, limit):
    """Return how much two robots are in each other's way during a move; 0 where they are not.

    It is the integral of max(0, required - gap) [mm x intervals] plus some intervals of
    its largest value: without that, the cheapest way past each other would be the
    fastest way through each other.

    The pair is looked at again only after the two may have closed in by what was left
    between them (conservative advancement), but not before they are displaced by a
    small step; so a graze shorter than the step can be missed, a crossing cannot. The
    depth at the last instant counts as if it lasted one interval.

    Args:
        bodies: outlines, from bodies_of.
        lever: as in Scene.
        a, b: rows of the two bodies.
        qa, qb: their joint angles on the common grid [rad], shape (2, k + 1).
        required: gap they must keep [mm].
        early: gap they must keep before the grid time `release` [mm], at most required.
        release: grid time, 0 where they must keep all of it from the start.
        limit: value beyond which the exact result is of no interest.
    """
    last = qa.shape[1] - 1
    k, w = 0, 0.0  # at the part w of interval k
    total = deepest = 0.0
    while True:
        if k == last:
            theta_a, phi_a, theta_b, phi_b = qa[0, k], qa[1, k], qb[0, k], qb[1, k]
        else:
            theta_a = qa[0, k] + w * (qa[0, k + 1] - qa[0, k])
            phi_a = qa[1, k] + w * (qa[1, k + 1] - qa[1, k])
            theta_b = qb[0, k] + w * (qb[0, k + 1] - qb[0, k])
            phi_b = qb[1, k] + w * (qb[1, k + 1] - qb[1, k])
        need = early if k < release else required
        slack = pair_gap_below(bodies, a, b, theta_a, phi_a, theta_b, phi_b, need + _FAR_MM) - need
        if k == last:
            return total + max(0.0, -slack) + _DEEPEST * max(deepest, -slack)
        if slack < 0.0:
            stride = _stride(lever, a, qa, k) + _stride(lever, b, qb, k)
            step = 1.0 - w
            if stride > 0.0:
                step = min(step, max(-slack, _FINE_MM) / stride)
            total -= slack * step
            deepest = max(deepest, -slack)
            if total + _DEEPEST * deepest > limit:
                return total + _DEEPEST * deepest
            w += step
            if w >= 1.0 - 1e-9:
                k, w = k + 1, 0.0
        else:
            slack = max(slack, _FINE_MM)
            while k < last:
                stride = _stride(lever, a, qa, k) + _stride(lever, b, qb, k)
                if (1.0 - w) * stride > slack:
                    w += slack / stride
                    break
                slack -= (1.0 - w) * stride
                k, w = k + 1, 0.0
                if k == release:
                    break
