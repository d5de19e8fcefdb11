# SPDX-License-Identifier: Apache-2.0
"""How far a joint may leave its planned profile: its share of the free space, as an angle.

The paper calls the result the margin of a motor.
"""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_core.array_types import Floats, Mask
from fiber_core.clearance import bodies_of, levers_of
from fiber_core.focal_plane import FocalPlane

__all__ = ["joint_shares", "lever_arms_mm", "tip_distances_mm"]


def joint_shares(
    plane: FocalPlane,
    joint: int,
    pairs: ArrayLike,
    free_mm: Floats,
    phi: Floats,
    robots: Mask,
    cap_rad: float = np.pi,
) -> Floats:
    """Return how far one joint of some robots may be from its profile [rad], shape (m, t).

    The free space of a pair is shared by halves; a robot next to an obstacle, or to
    a robot that will not leave its profile any more, has all of the space. Divided by the
    lever arm it is an angle, because every point of a robot that turns a joint by x moves by
    at most x times the lever.

    Free space is the gap between whole outlines less the required gap ("safe"): with half of
    that each, two robots never meet. The paper (Makarem et al. 2014, SPIE, arXiv 1410.1181)
    takes the distance between fibre tips instead ("printed"): it asks for no gap and ignores
    the arms, and both halves together add up to contact.

    Args:
        plane: the focal plane.
        joint: 0 theta, 1 phi.
        pairs: rows a, b as from neighbour_pairs, shape (p, 2).
        free_mm: how much each pair may approach at each sample [mm], shape (p, t).
        phi: phi angles at each sample [rad], shape (n, t).
        robots: robots that may still leave their profile, shape (n,), m of them.
        cap_rad: share of a joint without neighbours [rad].
    """
    fixed = np.append(~robots, np.ones(plane.fixtures, dtype=bool))
    row = np.where(fixed, -1, np.cumsum(~fixed) - 1)
    shares = lever_arms_mm(plane, joint, phi, robots)
    _divide_free_space(np.asarray(pairs, dtype=np.int64), free_mm, row, shares, cap_rad)
    return shares


@njit(cache=True)
def _divide_free_space(pairs, free, row, lever, cap):
    # replaces lever (m, t) by the shares: the least share over each robot's pairs / lever
    space = np.full(lever.shape, np.inf)
    for i in range(len(pairs)):
        a, b = row[pairs[i, 0]], row[pairs[i, 1]]
        share = 0.5 if a >= 0 and b >= 0 else 1.0
        for k in range(free.shape[1]):
            part = max(share * free[i, k], 0.0)
            if a >= 0:
                space[a, k] = min(space[a, k], part)
            if b >= 0:
                space[b, k] = min(space[b, k], part)
    for i in range(len(lever)):
        for k in range(lever.shape[1]):
            lever[i, k] = min(space[i, k] / lever[i, k], cap) if lever[i, k] > 0.0 else cap


def lever_arms_mm(plane: FocalPlane, joint: int, phi: Floats, robots: Mask) -> Floats:
    """Return the farthest distance of a robot's outline from a joint's axis [mm], shape (m, t).

    Args:
        plane: the focal plane.
        joint: 0 theta, 1 phi.
        phi: phi angles at each sample [rad], shape (n, t).
        robots: the robots, shape (n,), m of them.
    """
    if joint == 1:
        return np.repeat(levers_of(plane)[robots, 1:], np.shape(phi)[1], axis=1)
    x, y = np.moveaxis(plane.phi_vertices[robots], -1, 0)
    lever = np.zeros((len(x), np.shape(phi)[1]))
    if plane.theta_vertices.shape[1]:
        corners = np.hypot(*np.moveaxis(plane.theta_vertices[robots], -1, 0))
        lever[:] = (corners.max(axis=1) + plane.theta_radius[robots])[:, None]
    _reach_from_center(plane.arms[robots, 0], x, y, plane.phi_radius[robots], phi[robots], lever)
    return lever


@njit(cache=True)
def _reach_from_center(arm1, x, y, radius, phi, lever):
    # |l1 + e^(i phi) z| of a vertex z, squared, is l1^2 + |z|^2 + 2 l1 Re(e^(i phi) z)
    for i in range(len(phi)):
        reach = 0.0
        for k in range(phi.shape[1]):
            if k == 0 or phi[i, k] != phi[i, k - 1]:
                c, s = np.cos(phi[i, k]), np.sin(phi[i, k])
                square = 0.0
                for j in range(x.shape[1]):
                    along = 2.0 * arm1[i] * (c * x[i, j] - s * y[i, j])
                    square = max(square, arm1[i] ** 2 + x[i, j] ** 2 + y[i, j] ** 2 + along)
                reach = np.sqrt(square) + radius[i]
            lever[i, k] = max(lever[i, k], reach)


def tip_distances_mm(plane: FocalPlane, pairs: ArrayLike, angles: ArrayLike) -> Floats:
    """Return the distance between the fibre tips of each pair at each sample [mm], shape (p, t).

    Args:
        plane: the focal plane.
        pairs: rows a, b as from neighbour_pairs, shape (p, 2); the tip of a
            fixed body is its centre.
        angles: joint angles at each sample [rad], shape (n, 2, t).
    """
    theta, phi = np.moveaxis(np.asarray(angles, dtype=float), 1, 0)
    tips = plane.centers.T[:, :, None]
    tips = tips + _polar(plane.arms[:, :1], theta) + _polar(plane.arms[:, 1:], theta + phi)
    discs = bodies_of(plane).center[plane.n :].T[:, :, None]
    x, y = np.concatenate([tips, np.repeat(discs, tips.shape[2], axis=2)], axis=1)
    a, b = np.asarray(pairs).T
    return np.hypot(x[a] - x[b], y[a] - y[b])


def _polar(length: Floats, angle: Floats) -> Floats:
    return np.stack([length * np.cos(angle), length * np.sin(angle)])
