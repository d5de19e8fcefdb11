# SPDX-License-Identifier: Apache-2.0
"""An independent judge of plans for motors with ramps and uncertain joints.

It reads problem.npz and plan.npz and imports nothing of this project: the true angles come from
running integrals of the ordered ones and not from pieces of constant acceleration. The gaps of
whole outlines, discs and walls are those of `gap_judge`, at every instant. With random errors of
the joints, gaps are those of line segments at many instants, and outlines must be capsules: two
vertices and a radius.
"""

from dataclasses import dataclass

import numpy as np
from gap_judge import judge_gaps
from scipy.spatial import cKDTree

__all__ = ["Verdict", "check"]


@dataclass(frozen=True)
class Verdict:
    """The figures of a plan that was checked.

    Args:
        makespan_s: instant after which no joint moves [s].
        violations: joints that break the speed, the acceleration or the range of their motor.
        curve_error_rad: largest difference between the curves of the plan and ours [rad].
        contacts: pairs of bodies that touch at any instant, with joints as they report.
        near: pairs that come nearer than the margin and do not touch.
        true_contacts: pairs that touch with some errors of the joints inside their intervals.
        least_gap_mm: smallest gap found [mm].
        least_true_gap_mm: smallest gap with errors of the joints [mm].
        end_error_um: largest distance of a tip from its target, of robots that reached it [um].
    """

    makespan_s: float
    violations: int
    curve_error_rad: float
    contacts: int
    near: int
    true_contacts: int
    least_gap_mm: float
    least_true_gap_mm: float
    end_error_um: float


class _Ordered:
    """Ordered angles, and their running integrals, of all joints."""

    def __init__(self, plan):
        self.start = plan["start_rad"].ravel()
        self.offsets = plan["offsets"]
        self.knots, self.speeds = [], []
        for profile in range(len(self.offsets) - 1):
            part = slice(self.offsets[profile], self.offsets[profile + 1])
            self.knots.append(np.concatenate([[0.0], np.cumsum(plan["duration_s"][part])]))
            self.speeds.append(plan["velocity_rad_s"][part])

    def angle(self, profile, t):
        """The ordered angle, shape as t."""
        knots, speed = self.knots[profile], self.speeds[profile]
        angles = self.start[profile] + np.concatenate([[0.0], np.cumsum(np.diff(knots) * speed)])
        return np.interp(t, knots, angles)

    def integral(self, profile, t):
        """The integral of the ordered angle from zero to t, which may be negative."""
        knots, speed = self.knots[profile], self.speeds[profile]
        steps = np.diff(knots)
        angles = self.start[profile] + np.concatenate([[0.0], np.cumsum(steps * speed)])
        sums = np.concatenate([[0.0], np.cumsum(0.5 * steps * (angles[1:] + angles[:-1]))])
        k = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, len(knots) - 1)
        rest = t - knots[k]
        slope = np.append(speed, 0.0)[k]
        slope = np.where(t < 0.0, 0.0, slope)
        return sums[k] + rest * (angles[k] + 0.5 * slope * rest)

    def true(self, profile, t, ramp_s):
        """The true angle: the mean of the ordered one over the ramp."""
        if ramp_s == 0.0:
            return self.angle(profile, t)
        return (self.integral(profile, t) - self.integral(profile, t - ramp_s)) / ramp_s

    def speed(self, profile, t):
        """The ordered velocity, which begins with its segment."""
        knots, speed = self.knots[profile], np.append(self.speeds[profile], 0.0)
        k = np.searchsorted(knots, t + 1e-9, side="right") - 1
        return np.where(k < 0, 0.0, speed[np.clip(k, 0, len(speed) - 1)])


def check(problem_file, plan_file, step_s=2e-3, errors=0, seed=0) -> Verdict:
    """Judge a plan.

    Args:
        problem_file, plan_file: problem.npz and plan.npz.
        step_s: time between two instants at which gaps are measured [s].
        errors: number of random errors of all joints with which gaps are measured once more.
        seed: of these errors.
    """
    with np.load(problem_file) as file:
        problem = dict(file)
    with np.load(plan_file) as file:
        plan = dict(file)
    ramp_s = float(problem.get("ramp_s", 0.0))
    ordered = _Ordered(plan)
    profiles = len(ordered.start)
    n = profiles // 2
    ends = np.array([knots[-1] for knots in ordered.knots])
    makespan_s = float(ends.max() + ramp_s * (ends.max() > 0))
    times = np.arange(0.0, makespan_s + step_s, step_s)
    angles = np.stack([ordered.true(p, times, ramp_s) for p in range(profiles)]).reshape(n, 2, -1)
    pairs = _pairs(problem)
    uncertainty = problem.get("uncertainty_rad", np.zeros((n, 2)))
    surely = {"uncertainty_rad": 0.0 * uncertainty, "lost_motion_rad": 0.0 * uncertainty}
    reported = judge_gaps({**problem, **surely}, plan)
    if errors:
        pairs = pairs[_may_be_nearest(problem, pairs, angles, uncertainty)]
    true_gaps, rng = np.full(len(pairs), np.inf), np.random.default_rng(seed)
    for _ in range(errors):
        # half of the joints at an end of their interval, and every joint its own sign
        error = uncertainty * np.clip(rng.uniform(-2.0, 2.0, (n, 2)), -1.0, 1.0)
        true_gaps = np.minimum(true_gaps, _gaps(problem, pairs, angles + error[:, :, None]))
    return Verdict(
        makespan_s,
        int(_violations(problem, ordered, ramp_s, angles).sum()),
        _curve_error(ordered, plan, ramp_s),
        reported.contacts,
        reported.near,
        max(reported.contacts, int((true_gaps <= 0.0).sum())),
        reported.least_mm,
        float(true_gaps.min(initial=reported.least_mm)),
        _end_error_um(problem, plan, ordered),
    )


def _violations(problem, ordered, ramp_s, angles):
    # joints that break a rule of their motor, shape (2 n,)
    most_speed = problem["speed_rad_s"].ravel() * (1 + 1e-9)
    most = problem.get("acceleration_rad_s2", np.full((len(angles), 2), np.inf)).ravel()
    low, high = problem["limits_rad"].reshape(-1, 2).T
    broken = (angles.min(axis=2).ravel() < low - 1e-9) | (angles.max(axis=2).ravel() > high + 1e-9)
    for profile, (knots, speeds) in enumerate(zip(ordered.knots, ordered.speeds)):
        broken[profile] |= bool((np.abs(speeds) > most_speed[profile]).any())
        if ramp_s > 0.0 and len(speeds):
            # between two changes of the law the acceleration is constant
            changes = np.unique(np.round(np.concatenate([knots, knots + ramp_s]), 9))
            middle = 0.5 * (changes[1:] + changes[:-1])
            change = ordered.speed(profile, middle) - ordered.speed(profile, middle - ramp_s)
            broken[profile] |= bool((np.abs(change) / ramp_s > most[profile] * (1 + 1e-6)).any())
        elif len(speeds):
            broken[profile] |= bool(np.isfinite(most[profile]))
    return broken


def _curve_error(ordered, plan, ramp_s):
    # the curves that the plan holds, against ours, at each change of the law and between
    if "curve_offsets" not in plan:
        return 0.0
    worst = 0.0
    for profile in range(len(ordered.start)):
        part = slice(plan["curve_offsets"][profile], plan["curve_offsets"][profile + 1])
        time_s, angle, speed, acceleration = (
            plan[f"curve_{name}"][part]
            for name in ("time_s", "angle_rad", "velocity_rad_s", "acceleration_rad_s2")
        )
        for share in (0.0, 0.37):
            passed = share * np.diff(time_s, append=time_s[-1] + 1.0)
            theirs = angle + passed * (speed + 0.5 * acceleration * passed)
            ours = ordered.true(profile, time_s + passed, ramp_s)
            worst = max(worst, float(np.abs(theirs - ours).max()))
    return worst


def _pairs(problem):
    reach = problem["arm_mm"].sum(axis=1) + problem["radius_mm"]
    tree = cKDTree(problem["center_mm"])
    return tree.query_pairs(2 * reach.max() + 0.1, output_type="ndarray")


def _may_be_nearest(problem, pairs, angles, uncertainty):
    # Pairs that can have a smaller gap with errors than the smallest one without, shape (p,): no
    # point of an arm is displaced by more than the errors of its joints times their levers.
    lever = np.stack([problem["arm_mm"].sum(axis=1), problem["arm_mm"][:, 1]], axis=1)
    displaced = (uncertainty * (lever + problem["radius_mm"][:, None])).sum(axis=1)
    gap = _gaps(problem, pairs, angles)
    return gap - displaced[pairs].sum(axis=1) <= gap.min(initial=np.inf)


def _gaps(problem, pairs, angles):
    # smallest gap of each pair over all instants, shape (p,)
    outline = problem.get("phi_outline_mm")
    if outline is not None and outline.shape[1] != 2:
        raise ValueError(f"outlines have {outline.shape[1]} vertices, only capsules are checked")
    theta, both = angles[:, 0], angles.sum(axis=1)
    arm, center = problem["arm_mm"][:, :, None], problem["center_mm"][:, :, None]
    elbow = center + arm[:, :1] * np.stack([np.cos(theta), np.sin(theta)], axis=1)
    tip = elbow + arm[:, 1:] * np.stack([np.cos(both), np.sin(both)], axis=1)
    radius = problem["radius_mm"]
    least = np.empty(len(pairs))
    for begin in range(0, len(pairs), 200):
        a, b = pairs[begin : begin + 200].T
        apart = _distance(elbow[a], tip[a], elbow[b], tip[b])
        least[begin : begin + 200] = apart.min(axis=1) - radius[a] - radius[b]
    return least


def _distance(p, q, r, s):
    # between the segments p q and r s, 0 where they cross; each (k, 2, t)
    ends = [_to_segment(p, r, s), _to_segment(q, r, s), _to_segment(r, p, q), _to_segment(s, p, q)]
    cross = (_side(p, q, r) * _side(p, q, s) < 0) & (_side(r, s, p) * _side(r, s, q) < 0)
    return np.where(cross, 0.0, np.minimum.reduce(ends))


def _to_segment(x, p, q):
    way = q - p
    share = ((x - p) * way).sum(axis=1) / np.maximum((way * way).sum(axis=1), 1e-30)
    away = x - p - np.clip(share, 0.0, 1.0)[:, None] * way
    return np.hypot(away[:, 0], away[:, 1])


def _side(p, q, x):
    return (q - p)[:, 0] * (x - p)[:, 1] - (q - p)[:, 1] * (x - p)[:, 0]


def _end_error_um(problem, plan, ordered):
    end = np.array([ordered.angle(p, np.inf) for p in range(len(ordered.start))]).reshape(-1, 2)
    both = end.sum(axis=1)
    arm = problem["arm_mm"]
    x = arm[:, 0] * np.cos(end[:, 0]) + arm[:, 1] * np.cos(both)
    y = arm[:, 0] * np.sin(end[:, 0]) + arm[:, 1] * np.sin(both)
    reached = plan["outcome_names"][plan["outcome"]] == "reached"
    away = np.stack([x, y], axis=1) + problem["center_mm"] - problem["target_mm"]
    return float(1e3 * np.hypot(*away[reached].T).max(initial=0.0))
