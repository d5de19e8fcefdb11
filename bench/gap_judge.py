# SPDX-License-Identifier: Apache-2.0
"""An independent judge of gaps: whole outlines, discs and walls, on true curves, at all times.

It reads the arrays of problem.npz and plan.npz and imports nothing of this project. A joint follows
the sum of its segments, each spread over its ramp. Distances are those of corners from edges. In
an interval of time no gap is smaller than half of the gaps at both ends less half of the way that
the two bodies go in it; an interval is halved until that is enough.
"""

from typing import NamedTuple

import numba as nb
import numpy as np
from scipy.spatial import cKDTree

__all__ = ["Gaps", "judge_gaps", "ramps_of_segments"]

_FINE_MM = 1e-4  # bodies that go less far in an interval are taken to rest in it
_NEARER_MM = 1e-3  # by which a pair that starts too close may come nearer: what can be measured


class Gaps(NamedTuple):
    """The figures of all pairs of neighbours.

    Args:
        contacts: pairs that touch at some instant.
        near: pairs that come nearer than the margin at some instant and do not touch.
        least_mm: smallest gap found [mm]; exact where it is less than the margin, negative where
            bodies overlap.
        pair: rows of the bodies with the smallest gap; discs and walls follow the robots.
        resting: the pairs in `near` of which neither robot moves.
        wall_contacts: pairs of a robot and a wall that touch while the robot moves.
        wall_mm: smallest gap between a wall and a robot that moves [mm].
        arm_mm: smallest gap of two robots of which one moves [mm].
        leaving: the pairs in `near` that start nearer than the margin, of which one body moves and
            comes no nearer.
        leaving_contacts: the pairs in `contacts` of which the same is true.
        nearer_mm: by how much a pair that starts too close comes nearer, at most [mm].
    """

    contacts: int
    near: int
    least_mm: float
    pair: tuple[int, int]
    resting: int = 0
    wall_contacts: int = 0
    wall_mm: float = np.inf
    arm_mm: float = np.inf
    leaving: int = 0
    leaving_contacts: int = 0
    nearer_mm: float = 0.0


class _Bodies(NamedTuple):
    # corners of the hulls of both links, their number and rounding; arms, centres, ways of points
    phi: np.ndarray
    phi_count: np.ndarray
    phi_radius: np.ndarray
    theta: np.ndarray
    theta_count: np.ndarray
    theta_radius: np.ndarray
    arm: np.ndarray
    center: np.ndarray
    lever: np.ndarray  # of theta and of phi: how far a point goes if the joint turns by 1 rad


class _Curves(NamedTuple):
    # the segments of the joints of all robots, each spread over its ramp
    offsets: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    velocity: np.ndarray
    ramp: np.ndarray
    start: np.ndarray


def judge_gaps(problem, plan, margin_mm: float = 0.05) -> Gaps:
    """Measure the gaps of all neighbours over the whole motion.

    Outlines are grown by as much as the uncertainty and the lost motion of their joints displace
    them.

    Args:
        problem, plan: the arrays of problem.npz and plan.npz.
        margin_mm: gap above which no more needs to be known [mm].
    """
    bodies, curves = _bodies_of(problem), _curves_of(problem, plan)
    pairs = _pairs_of(bodies, len(curves.start) // 2, margin_mm)
    last_s = float((curves.end + curves.ramp).max(initial=0.0))
    least, at_start = _least_gaps(bodies, curves, pairs, last_s, margin_mm)
    if not len(pairs):
        return Gaps(0, 0, np.inf, (-1, -1))
    first = int(np.argmin(least))
    touching = least <= 0.0
    near = (least < margin_mm - _FINE_MM) & ~touching
    a, b = pairs[first].tolist()
    turns = np.diff(curves.offsets[::2]) > 0
    fixed = np.zeros(len(bodies.arm) - len(turns), dtype=bool)
    moves = np.append(turns, fixed)[pairs]
    moving, one_moves = moves.any(axis=1), moves[:, 0] != moves[:, 1]
    close = moving & (at_start < margin_mm - _FINE_MM)
    leaving = close & one_moves & (least >= at_start - _NEARER_MM - _FINE_MM)
    walls = pairs[:, 1] >= len(bodies.arm) - len(problem.get("wall_mm", ()))
    arms = pairs[:, 1] < len(turns)
    return Gaps(
        int(touching.sum()),
        int(near.sum()),
        float(least[first]),
        (a, b),
        int((~moving & near).sum()),
        int((moving & walls & touching).sum()),
        float(least[moving & walls].min(initial=np.inf)),
        float(least[moving & arms].min(initial=np.inf)),
        int((leaving & near).sum()),
        int((leaving & touching).sum()),
        float((at_start - least)[close].max(initial=0.0)),
    )


def ramps_of_segments(problem, plan) -> np.ndarray:
    """Return the ramp of each segment of a plan [s], shape (m,).

    Args:
        problem, plan: the arrays of problem.npz and plan.npz.
    """
    velocity = plan["velocity_rad_s"]
    if "listed_speeds" not in problem:
        return np.full(len(velocity), float(problem.get("ramp_s", 0.0)))
    k = int(problem["listed_speeds"][0])
    speeds, ramps = problem["listed_speeds"][1 : 1 + 2 * k].reshape(2, k)
    profile = np.repeat(np.arange(len(plan["offsets"]) - 1), np.diff(plan["offsets"]))
    scale = problem["motor_scale"].reshape(-1, 2)[profile, (velocity > 0.0).astype(int)]
    nearest = np.abs(np.abs(velocity / scale)[:, None] - speeds).argmin(axis=1)
    return np.where(velocity != 0.0, ramps[nearest], 0.0)


def _curves_of(problem, plan) -> _Curves:
    offsets, duration = plan["offsets"].astype(np.int64), plan["duration_s"]
    sums = np.concatenate([[0.0], np.cumsum(duration)])
    begin = sums[:-1] - np.repeat(sums[offsets[:-1]], np.diff(offsets))
    ramp, start = ramps_of_segments(problem, plan), plan["start_rad"].ravel()
    return _Curves(offsets, begin, begin + duration, plan["velocity_rad_s"], ramp, start)


def _bodies_of(problem) -> _Bodies:
    arm, center = problem["arm_mm"], problem["center_mm"]
    n = len(arm)
    tip = np.stack([np.zeros_like(arm), np.stack([arm[:, 1], np.zeros(n)], axis=1)], axis=1)
    phi, theta = problem.get("phi_outline_mm", tip), problem.get("theta_outline_mm", tip[:, :0])
    radius = problem["radius_mm"]
    theta_radius = problem.get("theta_radius_mm", np.zeros(n))
    discs = problem.get("disc_mm", np.zeros((0, 3)))
    walls = problem.get("wall_mm", np.zeros((0, 1, 2)))
    fixed = len(discs) + len(walls)
    # the farthest corners from the axes; a rounding goes where its corner goes
    corner = np.hypot(*np.moveaxis(phi, -1, 0)).max(axis=1)
    body = np.zeros(n)
    if theta.shape[1]:
        body = np.hypot(*np.moveaxis(theta, -1, 0)).max(axis=1)
    nowhere = np.zeros((n, 2))
    off = problem.get("uncertainty_rad", nowhere) + problem.get("lost_motion_rad", nowhere)
    turned = np.maximum(arm[:, 0] + corner, body)
    grown = radius + off[:, 0] * (arm[:, 0] + corner) + off[:, 1] * corner
    outlines = [*phi, *discs[:, None, :2], *walls]
    corners, count = _hulls(outlines)
    own, own_count = _hulls([*theta, *np.zeros((fixed, 0, 2))])
    nothing = np.zeros(fixed)
    return _Bodies(
        corners,
        count,
        np.concatenate([grown, discs[:, 2], np.zeros(len(walls))]),
        own,
        own_count,
        np.concatenate([theta_radius + off[:, 0] * body, nothing]),
        np.concatenate([arm[:, 0], nothing]),
        np.concatenate([center, np.zeros((fixed, 2))]),
        np.concatenate([np.stack([turned, corner], axis=1), np.zeros((fixed, 2))]),
    )


def _hulls(outlines) -> tuple[np.ndarray, np.ndarray]:
    # corners of the convex hulls, counter-clockwise, and their number
    hulls = [_hull(np.unique(outline, axis=0)) for outline in outlines]
    most = max((len(hull) for hull in hulls), default=0)
    corners = np.zeros((len(hulls), max(most, 1), 2))
    for row, hull in enumerate(hulls):
        if len(hull):
            corners[row, : len(hull)] = hull
    return corners, np.array([len(hull) for hull in hulls], dtype=np.int64)


def _hull(points) -> list:
    # Andrew's monotone chain of points that are sorted, which ends on any input
    if len(points) < 3:
        return list(points)
    return _chain(points)[:-1] + _chain(points[::-1])[:-1]


def _chain(points) -> list:
    kept = []
    for point in points:
        while len(kept) > 1:
            (ax, ay), (bx, by) = kept[-1] - kept[-2], point - kept[-1]
            if ax * by - ay * bx > 0.0:
                break
            kept.pop()
        kept.append(point)
    return kept


def _pairs_of(bodies: _Bodies, n: int, margin_mm: float) -> np.ndarray:
    # robots with circles that come near, and robots with every disc or wall that may
    reach = bodies.lever[:n, 0] + np.maximum(bodies.phi_radius[:n], bodies.theta_radius[:n])
    tree = cKDTree(bodies.center[:n])
    close = tree.query_pairs(2.0 * reach.max(initial=0.0) + margin_mm, output_type="ndarray")
    found = [np.sort(close.reshape(-1, 2), axis=1)]
    for row in range(n, len(bodies.arm)):
        corners = bodies.phi[row, : bodies.phi_count[row]]
        middle = corners.mean(axis=0)
        around = np.hypot(*(corners - middle).T).max() + bodies.phi_radius[row]
        near = tree.query_ball_point(middle, around + reach.max(initial=0.0) + margin_mm)
        found.append(np.array([(robot, row) for robot in near], dtype=np.int64).reshape(-1, 2))
    return np.concatenate(found).astype(np.int64)


@nb.njit
def _spread(passed: float, ramp: float) -> float:
    # how long a segment that began `passed` ago has been followed, the ramp in half
    if passed <= 0.0:
        return 0.0
    return passed - 0.5 * ramp if passed >= ramp else 0.5 * passed * passed / ramp


@nb.njit
def _joint(curves, profile, t):
    # angle of a joint, and the sum of all its turns until then
    angle, way = curves.start[profile], 0.0
    for k in range(curves.offsets[profile], curves.offsets[profile + 1]):
        ramp = curves.ramp[k]
        turn = curves.velocity[k] * (
            _spread(t - curves.begin[k], ramp) - _spread(t - curves.end[k], ramp)
        )
        angle += turn
        way += abs(turn)
    return angle, way


@nb.njit
def _pose(bodies, curves, row, t, phi, theta):
    # Writes the corners of both links; returns how far a point of the body has gone at most.
    if 2 * row >= len(curves.start):
        for k in range(bodies.phi_count[row]):
            phi[k] = bodies.phi[row, k]
        return 0.0
    first, way = _joint(curves, 2 * row, t)
    second, way_phi = _joint(curves, 2 * row + 1, t)
    x, y = bodies.center[row]
    c, s = np.cos(first), np.sin(first)
    for k in range(bodies.theta_count[row]):
        u, v = bodies.theta[row, k]
        theta[k, 0], theta[k, 1] = x + c * u - s * v, y + s * u + c * v
    x, y = x + bodies.arm[row] * c, y + bodies.arm[row] * s
    c, s = np.cos(first + second), np.sin(first + second)
    for k in range(bodies.phi_count[row]):
        u, v = bodies.phi[row, k]
        phi[k, 0], phi[k, 1] = x + c * u - s * v, y + s * u + c * v
    return bodies.lever[row, 0] * way + bodies.lever[row, 1] * way_phi


@nb.njit
def _from_edges(a, m, b, n):
    # least distance of the corners of a from the edges of b
    least = np.inf
    for i in range(m):
        for j in range(n):
            p, q = b[j], b[(j + 1) % n]
            dx, dy = q[0] - p[0], q[1] - p[1]
            ex, ey = a[i, 0] - p[0], a[i, 1] - p[1]
            long = dx * dx + dy * dy
            share = 0.0 if long == 0.0 else min(max((ex * dx + ey * dy) / long, 0.0), 1.0)
            ex, ey = ex - share * dx, ey - share * dy
            least = min(least, np.sqrt(ex * ex + ey * ey))
    return least


@nb.njit
def _overlap(a, m, b, n):
    # by how much two convex polygons overlap at least, seen along the normals of the edges of a
    least = np.inf
    for i in range(m):
        p, q = a[i], a[(i + 1) % m]
        dx, dy = q[0] - p[0], q[1] - p[1]
        long = np.sqrt(dx * dx + dy * dy)
        if long == 0.0:
            continue
        last, first = -np.inf, np.inf  # of a, of b along the normal that points out of a
        for k in range(m):
            last = max(last, (dy * a[k, 0] - dx * a[k, 1]) / long)
        for k in range(n):
            first = min(first, (dy * b[k, 0] - dx * b[k, 1]) / long)
        least = min(least, last - first)
    return least


@nb.njit
def _apart(a, m, b, n):
    # distance of two convex polygons; where they overlap, less the shortest way to part them
    overlap = min(_overlap(a, m, b, n), _overlap(b, n, a, m))
    if 0.0 < overlap < np.inf:
        return -overlap
    return min(_from_edges(a, m, b, n), _from_edges(b, n, a, m))


@nb.njit
def _gap(bodies, curves, a, b, t, work):
    # gap of two bodies, and how far their points have gone
    way = _pose(bodies, curves, a, t, work[0], work[1])
    way += _pose(bodies, curves, b, t, work[2], work[3])
    gap = np.inf
    for i in range(2):
        m = bodies.phi_count[a] if i == 0 else bodies.theta_count[a]
        for j in range(2):
            n = bodies.phi_count[b] if j == 0 else bodies.theta_count[b]
            if m == 0 or n == 0:
                continue
            round_a = bodies.phi_radius[a] if i == 0 else bodies.theta_radius[a]
            round_b = bodies.phi_radius[b] if j == 0 else bodies.theta_radius[b]
            gap = min(gap, _apart(work[i], m, work[2 + j], n) - round_a - round_b)
    return gap, way


@nb.njit
def _least_gaps(bodies, curves, pairs, last_s, margin):
    most = max(bodies.phi.shape[1], bodies.theta.shape[1])
    work = np.zeros((4, most, 2))
    least, at_start = np.empty(len(pairs)), np.empty(len(pairs))
    for row in range(len(pairs)):
        a, b = pairs[row]
        g0, w0 = _gap(bodies, curves, a, b, 0.0, work)
        g1, w1 = _gap(bodies, curves, a, b, last_s, work)
        at_start[row], found = g0, min(g0, g1)
        stack = [(0.0, g0, w0, last_s, g1, w1)]
        while len(stack):
            t0, g0, w0, t1, g1, w1 = stack.pop()
            # what is not known to be wider than the margin or than the least gap found
            if 0.5 * (g0 + g1 - (w1 - w0)) >= min(margin, found) or w1 - w0 < _FINE_MM:
                continue
            t = 0.5 * (t0 + t1)
            g, w = _gap(bodies, curves, a, b, t, work)
            found = min(found, g)
            stack.append((t0, g0, w0, t, g, w))
            stack.append((t, g, w, t1, g1, w1))
        least[row] = found
    return least, at_start
