# SPDX-License-Identifier: Apache-2.0
"""Metrics: the figures of a plan, with lower bounds for comparison."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fiber_core import kinematics
from fiber_core.array_types import Codes, Floats
from fiber_core.clearance import Certificate
from fiber_core.drive import carried_out, most_motors_on, motors_allowed
from fiber_core.drive.least_time import least_time_s
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_core.motors import alone_s
from fiber_core.outcomes import Outcome, Reason
from fiber_core.problem import Problem

__all__ = [
    "ORDER_BYTES_BOUND",
    "Bounds",
    "bounds_of",
    "lower_bound_s",
    "plan_metrics",
    "power_bound_s",
]

# Information in the orders of a robot with one segment per motor: about 35 bits.
ORDER_BYTES_BOUND = 35 / 8


class Bounds(NamedTuple):
    """Times below which no motion of a plane can be [s].

    Args:
        alone_s: time that the slowest robot would need if it were alone.
        supplies_s: least time in which the supplies can feed all motors.
    """

    alone_s: float
    supplies_s: float


def lower_bound_s(problem: Problem) -> float:
    """Return the time that the slowest robot would need if it were alone [s].

    Each robot takes the elbow and turn that is fastest for it, its slowest joint or motor at full
    speed and acceleration, with its approach inside the range of the joint; collisions are
    ignored. Disabled robots and robots without a reachable target do not count.

    Args:
        problem: the problem.
    """
    return bounds_of(problem).alone_s


def power_bound_s(problem: Problem) -> float:
    """Return the least time in which the power supplies can feed all moves [s].

    It is the larger one of both bounds of `bounds_of`.

    Args:
        problem: the problem.
    """
    return max(bounds_of(problem))


def bounds_of(problem: Problem, limits: ArrayLike | None = None) -> Bounds:
    """Return the bound of one robot alone with its motors, and that of motor time over cap.

    Of a supply, it is the time that its motors are on, each robot with the elbow and turn for which
    that is least, approaches included, divided by how many of them may be on at once.

    Args:
        problem: the problem.
        limits: ranges of the joints in which robots move [rad], shape (n, 2, 2), where those of
            the plane are narrower because goals must be inside them; by default those.
    """
    plane = problem.plane
    movable = np.where(plane.enabled[:, None], problem.targets, np.nan)
    angles, valid = kinematics.inverse(plane, movable)
    turns = np.where(valid[..., None], angles - problem.start[:, None], np.nan)
    span = (plane.limits if limits is None else np.asarray(limits)) - problem.start[:, :, None]
    motor_s = least_time_s(plane.drive, plane.speeds, turns, span)
    travel_s = np.maximum(motor_s.max(axis=2), alone_s(plane, problem.start, angles))
    alone = np.where(valid, travel_s, np.inf).min(axis=1, initial=np.inf)
    moves = np.isfinite(alone)
    least_s = np.where(moves, motor_s.sum(axis=2).min(axis=1, initial=np.inf), 0.0)
    _, group = np.unique(plane.supply, return_inverse=True)
    allowed = motors_allowed(plane.supply, plane.drive.motors_on)
    of_group = np.bincount(group, least_s)
    fed = of_group[group[moves]] / np.maximum(allowed[moves], 1)
    return Bounds(float(alone[moves].max(initial=0.0)), float(fed.max(initial=0.0)))


def plan_metrics(
    problem: Problem,
    motion: SegmentMotion,
    certificate: Certificate,
    outcome: Codes,
    reason: Codes,
    margin_mm: float,
) -> dict[str, Any]:
    """Return the figures of a plan: counts, makespan, clearance, segments and end errors.

    Args:
        problem: the problem that the plan solves.
        motion: the motion decoded from the bytes.
        certificate: the certificate of that motion.
        outcome: Outcome of each robot, shape (n,).
        reason: Reason of each robot, shape (n,).
        margin_mm: gap that the certificate asks of resting robots.

    Returns:
        Plain numbers and strings, ready for JSON. The peak of motors is the largest share of
        the motors of a supply, or of a bus, that turn at once. Segments are counted per motor that
        moves. The end error is the distance from the fibre at the end of the motion to
        the target, over the robots that reached their target. Pairs that are close at rest are
        nearer than the margin and may not move. The least clearance is of pairs that are not
        nearer than the margin from the start; those that are, are named with their gaps.
    """
    plane = problem.plane
    asked = problem.asked
    reached = asked & (outcome == Outcome.REACHED)
    error_mm = kinematics.on_target(plane, motion.end, problem.targets).error_mm
    error_um: Floats = 1e3 * error_mm[reached]
    segments = motion.counts[motion.counts > 0]
    bounds = bounds_of(problem)
    bound = bounds.alone_s
    true_motion = carried_out(plane.drive, motion)
    makespan_s = true_motion.makespan_s
    codes, counts = np.unique(reason[asked], return_counts=True)
    close = certificate.pairs[certificate.close_at_rest]
    nearer = certificate.nearer(plane, motion.start, margin_mm)
    at = int(np.argmin(np.where(nearer, np.inf, certificate.gap_mm))) if not nearer.all() else -1
    return {
        "plane": plane.name,
        "drive": plane.drive.name,
        "robots": plane.n,
        "enabled": int(plane.enabled.sum()),
        "asked": int(asked.sum()),
        "reached": int(reached.sum()),
        "held": int((asked & (outcome == Outcome.HELD)).sum()),
        "failed": int((asked & (outcome == Outcome.FAILED)).sum()),
        "reasons": {
            Reason(code).name.lower(): count for code, count in zip(codes.tolist(), counts.tolist())
        },
        "makespan_s": makespan_s,
        "lower_bound_s": bound,
        "makespan_ratio": makespan_s / bound if bound else None,
        "supply_bound_s": bounds.supplies_s,
        "power_bound_s": max(bounds),
        "motors_on": plane.drive.motors_on,
        "motors_on_peak": float(most_motors_on(true_motion, plane.supply).max(initial=0.0)),
        "drive_violations": int(certificate.limits_broken.sum()),
        "certified": certificate.ok,
        "close_at_rest_ids": [_names(plane, pair) for pair in close.tolist()],
        "min_clearance_mm": float(certificate.gap_mm[at]) if at >= 0 else None,
        "min_clearance_ids": _names(plane, certificate.pairs[at].tolist()) if at >= 0 else [],
        "min_clearance_time_s": float(certificate.time_s[at]) if at >= 0 else None,
        "nearer_from_start": [
            {"ids": _names(plane, pair), "gap_mm": gap}
            for pair, gap in zip(
                certificate.pairs[nearer].tolist(), certificate.gap_mm[nearer].tolist()
            )
        ],
        "segments_mean": float(segments.mean()) if len(segments) else 0.0,
        "segments_max": int(segments.max(initial=0)),
        "segments_bound": 1.0,
        "end_error_um_rms": float(np.sqrt(np.mean(error_um**2))) if len(error_um) else 0.0,
        "end_error_um_max": float(error_um.max(initial=0.0)),
    }


def _names(plane: FocalPlane, pair: Iterable[int]) -> list[int | str]:
    # ids of robots; obstacles and walls by number
    return [int(plane.ids[row]) if row < plane.n else plane.name_of(row) for row in pair]
