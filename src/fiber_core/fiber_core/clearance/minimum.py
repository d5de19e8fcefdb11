"""Smallest gap of a pair over a whole motion, bracketed from below and from above."""

import heapq
from typing import NamedTuple

import numba as nb
import numpy as np

from fiber_core.clearance.pair_gaps import table_gap
from fiber_core.motion import SegmentMotion

__all__ = ["Minima", "Profiles", "minimum_gaps", "profiles_of"]

_ROUNDING_MM = 1e-9  # far above the rounding of a gap, far below anything that matters


class Profiles(NamedTuple):
    """A SegmentMotion with the instant and the angle at which each segment begins.

    A robot is made to rest by ``stop[i] = first[i]``.

    Args:
        start: joint angles at time zero [rad], shape (n, 2).
        first: first segment of each joint, shape (n, 2).
        stop: the one after its last segment, shape (n, 2).
        begins_s: when each segment begins [s], shape (m,).
        ends_s: when it ends [s], shape (m,).
        angle: joint angle at its begin [rad], shape (m,).
        velocity: joint speed in it [rad/s], shape (m,).
        low: lowest angle of each joint [rad], shape (n, 2).
        high: highest angle of each joint [rad], shape (n, 2).
        fastest: highest speed of each joint [rad/s], shape (n, 2).
    """

    start: np.ndarray
    first: np.ndarray
    stop: np.ndarray
    begins_s: np.ndarray
    ends_s: np.ndarray
    angle: np.ndarray
    velocity: np.ndarray
    low: np.ndarray
    high: np.ndarray
    fastest: np.ndarray


class Minima(NamedTuple):
    """What is known about the smallest gap of each pair: lower <= smallest gap <= best.

    Args:
        lower: proven lower bound [mm], shape (p,).
        best: smallest gap met [mm], shape (p,).
        time_s: when it was met [s], shape (p,).
    """

    lower: np.ndarray
    best: np.ndarray
    time_s: np.ndarray

    @classmethod
    def unknown(cls, p: int) -> "Minima":
        """Return that nothing is known about p pairs."""
        return cls(np.full(p, -np.inf), np.full(p, np.inf), np.zeros(p))


def profiles_of(motion: SegmentMotion) -> Profiles:
    """Return the instant and angle at which each segment of a motion begins."""
    first, stop = motion.offsets[:-1].reshape(-1, 2), motion.offsets[1:].reshape(-1, 2)
    segments = _unrolled(motion.start, first, stop, motion.duration_s, motion.velocity_rad_s)
    return Profiles(motion.start.copy(), first.copy(), stop.copy(), *segments)


@nb.njit(cache=True, error_model="numpy")
def _unrolled(start, first, stop, duration, velocity):
    m = len(duration)
    begins, ends, angles = np.empty(m), np.empty(m), np.empty(m)
    low, high = start.copy(), start.copy()
    fastest = np.zeros(start.shape)
    for i in range(len(start)):
        for joint in range(2):
            time, angle = 0.0, start[i, joint]
            for k in range(first[i, joint], stop[i, joint]):
                begins[k], angles[k] = time, angle
                time += duration[k]
                angle += velocity[k] * duration[k]
                ends[k] = time
                low[i, joint] = min(low[i, joint], angle)
                high[i, joint] = max(high[i, joint], angle)
                fastest[i, joint] = max(fastest[i, joint], abs(velocity[k]))
    return begins, ends, angles, velocity.copy(), low, high, fastest


@nb.njit(cache=True, error_model="numpy")
def _speed(arm1, phi_reach, theta_reach, w_theta, w_phi):
    # No vertex of a body moves faster [mm/s]. The phi link is bounded in two ways: elbow
    # plus turning about it, or theta about the centre plus phi about the elbow.
    phi_link = min(
        abs(w_theta) * arm1 + abs(w_theta + w_phi) * phi_reach,
        abs(w_theta) * (arm1 + phi_reach) + abs(w_phi) * phi_reach,
    )
    return max(phi_link, abs(w_theta) * theta_reach)


@nb.njit(cache=True, error_model="numpy")
def _lowest(g0, g1, way):
    # Piyavskii (1972), Shubert (1972): no gap between two instants is below this when
    # the gap can change by at most `way` in between. g0 and g1 may be lower bounds.
    return max(0.5 * (g0 + g1 - way), max(g0, g1) - way)


@nb.njit(cache=True, error_model="numpy")
def minimum_gaps(bodies, profiles, pairs, rows, level, tolerance, resolve, minima):
    """Bracket the smallest gap of some pairs until it is proven or resolved.

    A pair's interval with the lowest bound is halved until that bound reaches the
    level (proven), or is within the tolerance of the smallest gap met (resolved).

    Args:
        bodies: outlines, from bodies_of.
        profiles: the motion, from profiles_of.
        pairs: rows a, b of bodies, shape (p, 2).
        rows: pairs to work on, shape (r,).
        level: gap of each pair that is enough to know [mm], shape (p,).
        tolerance: how closely a gap below its level is resolved [mm].
        resolve: whether to go on with a pair after a gap below its level was met.
        minima: filled in at the rows.
    """
    # Fields are read once: each reading of a tuple's array costs two atomic operations.
    table, arm1 = bodies.table, bodies.arm1
    phi_reach, theta_reach = bodies.phi_reach, bodies.theta_reach
    start, first, last = profiles.start, profiles.first, profiles.stop
    begins, ends, angle, velocity = (
        profiles.begins_s, profiles.ends_s, profiles.angle, profiles.velocity
    )  # fmt: skip
    robots = len(start)
    longest = 0
    for i in range(robots):
        for joint in range(2):
            longest = max(longest, last[i, joint] - first[i, joint])
    # the pieces of a pair's motion on which all four speeds are constant
    piece_t = np.empty(4 * longest + 1)
    piece_q, piece_w = np.empty((4 * longest + 1, 4)), np.empty((4 * longest + 1, 4))
    cursor, stop = np.empty(4, dtype=np.int64), np.empty(4, dtype=np.int64)
    q, w = np.empty(4), np.empty(4)
    for row in rows:
        a, b = pairs[row]
        for j in range(4):
            body, joint = (a, j) if j < 2 else (b, j - 2)
            q[j], cursor[j], stop[j] = 0.0, 0, 0
            if body < robots:
                q[j] = start[body, joint]
                cursor[j], stop[j] = first[body, joint], last[body, joint]
        t, pieces = 0.0, 0
        gap = table_gap(table, a, b, q[0], q[1], q[2], q[3], np.inf)
        best, when, lower = gap, t, gap
        enough = level[row] + _ROUNDING_MM
        queue = [(np.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0)]
        while True:
            until = np.inf
            for j in range(4):
                w[j] = 0.0
                if cursor[j] < stop[j]:
                    w[j] = velocity[cursor[j]]
                    until = min(until, ends[cursor[j]])
            if until == np.inf:
                break
            piece_t[pieces] = t
            for j in range(4):
                piece_q[pieces, j], piece_w[pieces, j] = q[j], w[j]
                if cursor[j] < stop[j]:
                    k = cursor[j]
                    q[j] = angle[k] + w[j] * (until - begins[k])
                    if ends[k] <= until:
                        cursor[j] += 1
            speed = _speed(arm1[a], phi_reach[a], theta_reach[a], w[0], w[1])
            speed += _speed(arm1[b], phi_reach[b], theta_reach[b], w[2], w[3])
            if speed > 0.0:
                way = speed * (until - t)
                cutoff = enough + way
                after = table_gap(table, a, b, q[0], q[1], q[2], q[3], cutoff)
                if after < min(best, cutoff):
                    best, when = after, until
                bound = _lowest(gap, after, way)
                if bound >= enough:
                    lower = min(lower, bound)
                else:
                    heapq.heappush(queue, (bound, t, gap, until, after, speed, pieces))
                gap = after
                pieces += 1
            t = until
        while queue[0][0] < min(enough, best - tolerance) and (resolve or best >= enough):
            _, t0, g0, t1, g1, speed, k = heapq.heappop(queue)
            t = 0.5 * (t0 + t1)
            for j in range(4):
                q[j] = piece_q[k, j] + piece_w[k, j] * (t - piece_t[k])
            way = speed * (t - t0)
            cutoff = enough + way
            gap = table_gap(table, a, b, q[0], q[1], q[2], q[3], cutoff)
            if gap < min(best, cutoff):
                best, when = gap, t
            bound = _lowest(g0, gap, way)
            if bound >= enough:
                lower = min(lower, bound)
            else:
                heapq.heappush(queue, (bound, t0, g0, t, gap, speed, k))
            bound = _lowest(gap, g1, way)
            if bound >= enough:
                lower = min(lower, bound)
            else:
                heapq.heappush(queue, (bound, t, gap, t1, g1, speed, k))
        minima.lower[row] = min(min(lower, best), queue[0][0]) - _ROUNDING_MM
        minima.best[row] = best
        minima.time_s[row] = when
