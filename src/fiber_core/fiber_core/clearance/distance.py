# SPDX-License-Identifier: Apache-2.0
"""Gaps between the outlines of pairs of robots, at one instant or at many."""

import math

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Floats, Gaps, Pairs
from fiber_core.clearance.collision_bodies import (
    ARM1,
    COUNT,
    DISC,
    PHI,
    RADIUS,
    THETA,
    VERTICES,
    Bodies,
    X,
    Y,
    bodies_of,
)
from fiber_core.clearance.gjk import gjk_distance
from fiber_core.focal_plane import FocalPlane
from fiber_core.threads import share_out

__all__ = ["gaps", "pair_gap", "pair_gap_below", "posed_gap", "sampled_gaps", "swept_gap"]

_LEAST_PAIRS = 2000  # of a thread: fewer are done sooner than it begins


@nb.njit(cache=True, error_model="numpy")
def pair_gap(
    bodies: Bodies,
    a: int,
    b: int,
    theta_a: float,
    phi_a: float,
    theta_b: float,
    phi_b: float,
) -> float:
    """Return the gap between the outlines of two bodies [mm]; negative when they overlap.

    The gap is the signed separation of the nearest of the four pairs of links. It
    changes by no more than the sum of the displacements of the points of both bodies.

    Args:
        bodies: outlines, from bodies_of.
        a, b: rows of the two bodies; an obstacle ignores its angles.
        theta_a, phi_a, theta_b, phi_b: joint angles [rad].
    """
    return pair_gap_below(bodies, a, b, theta_a, phi_a, theta_b, phi_b, np.inf)


@nb.njit(cache=True, error_model="numpy")
def pair_gap_below(
    bodies: Bodies,
    a: int,
    b: int,
    theta_a: float,
    phi_a: float,
    theta_b: float,
    phi_b: float,
    cutoff: float,
) -> float:
    """Return pair_gap where it is below a cutoff, else a lower bound that is above the cutoff.

    Args:
        bodies: outlines, from bodies_of.
        a, b: rows of the two bodies; an obstacle ignores its angles.
        theta_a, phi_a, theta_b, phi_b: joint angles [rad].
        cutoff: gap above which the exact value is not needed [mm].
    """
    return table_gap(bodies.table, a, b, theta_a, phi_a, theta_b, phi_b, cutoff)


@nb.njit(cache=True, error_model="numpy")
def table_gap(
    table: Floats,
    a: int,
    b: int,
    theta_a: float,
    phi_a: float,
    theta_b: float,
    phi_b: float,
    cutoff: float,
) -> float:
    """Return pair_gap_below, from the table of the bodies."""
    psi_a, psi_b = theta_a + phi_a, theta_b + phi_b
    return posed_gap(
        table, a, b,
        math.cos(theta_a), math.sin(theta_a), math.cos(psi_a), math.sin(psi_a),
        math.cos(theta_b), math.sin(theta_b), math.cos(psi_b), math.sin(psi_b),
        cutoff,
    )  # fmt: skip


@nb.njit(cache=True, error_model="numpy")
def posed_gap(
    table: Floats,
    a: int,
    b: int,
    ca: float,
    sa: float,
    cpa: float,
    spa: float,
    cb: float,
    sb: float,
    cpb: float,
    spb: float,
    cutoff: float,
) -> float:
    """Return pair_gap_below for bodies that are given by cosines and sines of their angles.

    Args:
        table: outlines, the table of Bodies.
        a, b: rows of the two bodies.
        ca, sa, cb, sb: cosine and sine of theta of each body.
        cpa, spa, cpb, spb: cosine and sine of theta + phi of each body.
        cutoff: gap above which the exact value is not needed [mm].
    """
    x, y = table[b, X] - table[a, X], table[b, Y] - table[a, Y]
    elbow_a_x, elbow_a_y = table[a, ARM1] * ca, table[a, ARM1] * sa
    elbow_b_x, elbow_b_y = x + table[b, ARM1] * cb, y + table[b, ARM1] * sb
    theta_a, theta_b = int(table[a, THETA]), int(table[b, THETA])
    dx, dy = elbow_b_x - elbow_a_x, elbow_b_y - elbow_a_y
    gap = _link_gap(table, a, PHI, b, PHI, dx, dy, cpa, spa, cpb, spb, cutoff)
    has_a, has_b = table[a, theta_a + COUNT] > 0.0, table[b, theta_b + COUNT] > 0.0
    if has_a:
        dx, dy, bound = elbow_b_x, elbow_b_y, min(gap, cutoff)
        gap = min(gap, _link_gap(table, a, theta_a, b, PHI, dx, dy, ca, sa, cpb, spb, bound))
    if has_b:
        dx, dy, bound = x - elbow_a_x, y - elbow_a_y, min(gap, cutoff)
        gap = min(gap, _link_gap(table, a, PHI, b, theta_b, dx, dy, cpa, spa, cb, sb, bound))
    if has_a and has_b:
        bound = min(gap, cutoff)
        gap = min(gap, _link_gap(table, a, theta_a, b, theta_b, x, y, ca, sa, cb, sb, bound))
    return gap


@nb.njit(cache=True, error_model="numpy")
def _link_gap(
    table: Floats,
    a: int,
    p: int,
    b: int,
    q: int,
    dx: float,
    dy: float,
    ca: float,
    sa: float,
    cb: float,
    sb: float,
    cutoff: float,
) -> float:
    # Gap between two links, whose records begin at columns p and q. (dx, dy) leads from
    # the origin of the first to that of the second in the plane; (c, s) turns a link.
    x, y = ca * dx + sa * dy, ca * dy - sa * dx
    c, s = ca * cb + sa * sb, ca * sb - sa * cb
    radii = table[a, p + RADIUS] + table[b, q + RADIUS]
    p_count, q_count = int(table[a, p + COUNT]), int(table[b, q + COUNT])
    if p_count > 2 or q_count > 2:
        disc_x, disc_y = table[b, q + DISC], table[b, q + DISC + 1]
        between_x = x + c * disc_x - s * disc_y - table[a, p + DISC]
        between_y = y + s * disc_x + c * disc_y - table[a, p + DISC + 1]
        between = math.sqrt(between_x * between_x + between_y * between_y)
        bound = between - table[a, p + DISC + 2] - table[b, q + DISC + 2] - radii
        if bound > cutoff:
            return bound
    p, q = p + VERTICES, q + VERTICES
    return gjk_distance(table, a, p, p_count, b, q, q_count, x, y, c, s, cutoff + radii) - radii


@nb.njit(cache=True, error_model="numpy")
def swept_gap(
    table: Floats, a: int, joint: int, ca: float, sa: float, b: int, pose: Floats
) -> float:
    """Return a lower bound of the gap of two bodies at all angles of one joint of the first [mm].

    The links are taken as circles, that which turns as the one that it sweeps.

    Args:
        table: outlines, the table of Bodies.
        a, b: rows of the two bodies.
        joint: the joint of a that turns, 0 theta, 1 phi.
        ca, sa: cosine and sine of theta of a; they do not count where theta turns.
        pose: cosine and sine of theta of b, then of its theta + phi, shape (4,).
    """
    x, y = table[b, X] - table[a, X], table[b, Y] - table[a, Y]
    theta_a, theta_b = int(table[a, THETA]), int(table[b, THETA])
    elbow_x, elbow_y = x + table[b, ARM1] * pose[0], y + table[b, ARM1] * pose[1]
    px, py, p_radius = _circle(table, b, PHI, elbow_x, elbow_y, pose[2], pose[3])
    tx, ty, t_radius = _circle(table, b, theta_b, x, y, pose[0], pose[1])
    has_theta = table[b, theta_b + COUNT] > 0.0
    swept, still = _link_reach(table, a, PHI), -np.inf
    around_x = around_y = still_x = still_y = 0.0
    if joint == 0:
        swept = max(table[a, ARM1] + swept, _link_reach(table, a, theta_a))
    else:
        around_x, around_y = table[a, ARM1] * ca, table[a, ARM1] * sa
        if table[a, theta_a + COUNT] > 0.0:
            still_x, still_y, still = _circle(table, a, theta_a, 0.0, 0.0, ca, sa)
    gap = np.hypot(px - around_x, py - around_y) - p_radius - swept
    gap = min(gap, np.hypot(px - still_x, py - still_y) - p_radius - still)
    if has_theta:
        gap = min(gap, np.hypot(tx - around_x, ty - around_y) - t_radius - swept)
        gap = min(gap, np.hypot(tx - still_x, ty - still_y) - t_radius - still)
    return gap


@nb.njit(cache=True, error_model="numpy")
def _circle(
    table: Floats, a: int, link: int, x: float, y: float, c: float, s: float
) -> tuple[float, float, float]:
    # circle around a link whose origin is at (x, y), turned by (c, s), its rounding included
    u, v = table[a, link + DISC], table[a, link + DISC + 1]
    return x + c * u - s * v, y + s * u + c * v, table[a, link + DISC + 2] + table[a, link + RADIUS]


@nb.njit(cache=True, error_model="numpy")
def _link_reach(table: Floats, a: int, link: int) -> float:
    # from the origin of a link to its farthest point, or more; 0 without an outline
    if table[a, link + COUNT] == 0.0:
        return 0.0
    x, y, radius = _circle(table, a, link, 0.0, 0.0, 1.0, 0.0)
    return float(np.hypot(x, y)) + radius


def gaps(plane: FocalPlane, pairs: ArrayLike, angles: ArrayLike) -> Gaps:
    """Return the gap of each pair at one instant [mm], shape (p,).

    Args:
        plane: the focal plane.
        pairs: rows a, b as from neighbour_pairs, shape (p, 2).
        angles: joint angles [rad], shape (n, 2).
    """
    return sampled_gaps(plane, pairs, np.asarray(angles, dtype=float)[:, :, None])[:, 0]


def sampled_gaps(plane: FocalPlane, pairs: ArrayLike, angles: ArrayLike) -> Floats:
    """Return the gap of each pair at many instants [mm], shape (p, t).

    Args:
        plane: the focal plane.
        pairs: rows a, b as from neighbour_pairs, shape (p, 2).
        angles: joint angles at each instant [rad], shape (n, 2, t).
    """
    angles = np.asarray(angles, dtype=float)
    theta, both = angles[:, 0], angles[:, 0] + angles[:, 1]
    poses = np.stack([np.cos(theta), np.sin(theta), np.cos(both), np.sin(both)], axis=-1)
    obstacles = np.zeros((plane.fixtures, *poses.shape[1:]))
    obstacles[..., ::2] = 1.0  # the cosines of angles of 0
    pairs = np.array(pairs, dtype=np.int32).reshape(-1, 2)
    table, poses = bodies_of(plane).table, np.concatenate([poses, obstacles])
    found = np.empty((len(pairs), poses.shape[1]))

    def measure(first: int, last: int) -> None:
        _measure_gaps(table, pairs[first:last], poses, found[first:last])

    share_out(measure, len(pairs), _LEAST_PAIRS)
    return found


@nb.njit(cache=True, error_model="numpy", nogil=True)
def _measure_gaps(table: Floats, pairs: Pairs, poses: Floats, out: Floats) -> None:
    for i in range(len(pairs)):
        a, b = pairs[i]
        for k in range(poses.shape[1]):
            p, q = poses[a, k], poses[b, k]
            out[i, k] = posed_gap(
                table, a, b, p[0], p[1], p[2], p[3], q[0], q[1], q[2], q[3], np.inf
            )
