# SPDX-License-Identifier: Apache-2.0
"""Moves of the local search: new profiles of both joints of a robot, sampled at random."""

import math

import numba as nb

from fiber_core.array_types import Floats, Ints
from fiber_core.clearance import pair_gap_below
from fiber_planner.direct.plan_state import PlanState
from fiber_planner.direct.profile_sampling import (
    copy_profile,
    least_intervals,
    sample_fold,
    sample_line,
    sample_via,
    sample_window,
)
from fiber_planner.direct.scene import Scene
from fiber_planner.direct.splitmix64 import RngState, next_uniform

__all__ = [
    "INFEASIBLE",
    "nearer_fold",
    "resample_half",
    "sample_folded",
    "sample_lines",
    "sample_profile",
]

INFEASIBLE = -2
_SEQUENTIAL = 0.4  # share of folded profiles in which one joint waits for the other
_OTHER_OPTION = 0.3  # share of moves that end at another configuration on the target
_ROUNDING = 1.0 + 1e-9  # a joint may exceed its reach by rounding


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def nearer_fold(folded_phi: Floats, phi: float) -> float:
    """Return the folded angle, of the two in folded_phi, that is nearer to phi [rad]."""
    if abs(folded_phi[0] - phi) <= abs(folded_phi[1] - phi):
        return folded_phi[0]
    return folded_phi[1]


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _clipped(value, low, high):
    return min(max(value, low), high)


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _sample_option(scene, plan, i, step_s, rng):
    # The option to end at: the robot's present one, or sometimes another one that it can
    # reach in time and that is clear of the neighbours' ends. The goals chosen at first are
    # clear of each other, and so they stay.
    own = plan.choice[i]
    if scene.option_count[i] < 2 or next_uniform(rng) >= _OTHER_OPTION:
        return own
    other = int(next_uniform(rng) * scene.option_count[i])
    last = plan.q.shape[2] - 1
    for joint in range(2):
        angle = scene.options[i, other, joint] - scene.start[i, joint]
        if least_intervals(angle, scene.speed[i, joint] * step_s) > last:
            return own
    theta, phi = scene.options[i, other]
    for e in range(scene.near.offsets[i], scene.near.offsets[i + 1]):
        j, required = scene.near.body[e], plan.required[scene.near.pair[e]]
        theta_j, phi_j = plan.q[j, 0, last], plan.q[j, 1, last]
        if pair_gap_below(scene.bodies, i, j, theta, phi, theta_j, phi_j, required) < required:
            return own
    return other


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def sample_lines(
    scene: Scene, plan: PlanState, i: int, step_s: float, rng: RngState, profile: Floats
) -> int:
    """Sample a profile that takes one segment a joint: both begin at once, one may be there early.

    Arguments as for sample_profile; the robot has a target.

    Returns:
        The option that the profile ends at.
    """
    choice = _sample_option(scene, plan, i, step_s, rng)
    which = int(3.0 * next_uniform(rng))  # the joint that takes the whole time, if one does
    for joint in range(2):
        s, g = scene.start[i, joint], scene.options[i, choice, joint]
        sample_line(
            profile[joint],
            s,
            g,
            _per_interval(scene, i, joint, g, step_s, profile),
            joint == which,
            rng,
        )
    return choice


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _per_interval(scene, i, joint, g, step_s, profile):
    # largest change of a joint in an interval while the other one rests, if it gets to g with that
    alone, last = scene.speed_alone[i, joint] * step_s, profile.shape[1] - 1
    if abs(g - scene.start[i, joint]) > alone * last:
        return scene.speed[i, joint] * step_s
    return alone


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def sample_profile(
    scene: Scene,
    plan: PlanState,
    i: int,
    number: int,
    many: int,
    step_s: float,
    folding: float,
    rng: RngState,
    profile: Floats,
) -> int:
    """Sample a whole new profile; simple ones first, then third angles farther and farther out.

    Args:
        scene: the robots and their surroundings.
        plan: the plan.
        i: row of the robot.
        number, many: this is move `number` of `many`.
        step_s: length of a grid interval [s].
        folding: share of the moves that fold the arm on its way.
        rng: of the random numbers.
        profile: joint angles on the grid [rad], shape (2, k + 1), written.

    Returns:
        The option that the profile ends at, -1 if the robot may end anywhere.
    """
    last = profile.shape[1] - 1
    choice = plan.choice[i]
    theta, phi = scene.start[i]
    if choice >= 0:
        choice = _sample_option(scene, plan, i, step_s, rng)
        theta, phi = scene.options[i, choice]
    elif number > 0:
        ease = (number / many) ** 2
        for joint in range(2):
            span = min(scene.speed[i, joint] * step_s * last, math.pi * ease)
            end = scene.start[i, joint] + span * (2.0 * next_uniform(rng) - 1.0)
            end = min(max(end, scene.low[i, joint]), scene.high[i, joint])
            if joint == 0:
                theta = end
            else:
                phi = end
    folds = next_uniform(rng) < folding
    kind = next_uniform(rng)
    progress = number / many
    for joint in range(2):
        s = scene.start[i, joint]
        g = theta if joint == 0 else phi
        per_interval = _per_interval(scene, i, joint, g, step_s, profile)
        spread = math.pi * (0.15 + progress) * (0.2 + 0.8 * next_uniform(rng))
        straight = (
            progress < 0.3 or (kind < 0.3 and joint == 0) or (0.3 < kind < 0.5 and joint == 1)
        )
        if folds and joint == 1:
            fold = nearer_fold(scene.folded_phi[i], s)
            sample_fold(profile[joint], s, fold, g, per_interval, rng)
        elif straight:
            sample_window(profile[joint], s, g, per_interval, rng)
        else:
            dwell = progress > 0.5 and next_uniform(rng) < 0.5
            sample_via(
                profile[joint], s, g, scene.low[i, joint], scene.high[i, joint],
                per_interval, spread, dwell, rng,
            )  # fmt: skip
    return choice


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def resample_half(
    scene: Scene, plan: PlanState, i: int, step_s: float, rng: RngState, profile: Floats
) -> None:
    """Sample a profile that keeps one half of the robot's present one, or only its ends.

    If it keeps only its ends, it passes the middle of the time partly folded, theta anywhere.
    Arguments as for sample_profile.
    """
    last = profile.shape[1] - 1
    middle = last // 2
    copy_profile(plan.q[i], profile)
    which = next_uniform(rng)
    first, second = which < 0.4 or which >= 0.8, which >= 0.4
    spread_middle = next_uniform(rng) ** 2
    for joint in range(2):
        s, g = profile[joint, 0], profile[joint, last]
        per_interval = scene.speed[i, joint] * step_s
        m = profile[joint, middle]
        if first and second:
            far, back = per_interval * middle, per_interval * (last - middle)
            low = max(scene.low[i, joint], max(s - far, g - back))
            high = min(scene.high[i, joint], min(s + far, g + back))
            if joint == 0:
                wanted = m + math.pi * spread_middle * (2.0 * next_uniform(rng) - 1.0)
            else:
                wanted = nearer_fold(scene.folded_phi[i], m)
                wanted += (0.5 * (s + g) - wanted) * next_uniform(rng)
            if low <= high:
                m = min(max(wanted, low), high)
        spread = math.pi * next_uniform(rng)
        for half in range(2):
            if half == 0:
                sampled, row, begin, end = first, profile[joint, : middle + 1], s, m
            else:
                sampled, row, begin, end = second, profile[joint, middle:], m, g
            if not sampled:
                continue
            if next_uniform(rng) < 0.55:
                sample_window(row, begin, end, per_interval, rng)
            else:
                sample_via(
                    row, begin, end, scene.low[i, joint], scene.high[i, joint],
                    per_interval, spread, next_uniform(rng) < 0.5, rng,
                )  # fmt: skip


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def sample_folded(
    scene: Scene,
    plan: PlanState,
    i: int,
    step_s: float,
    rng: RngState,
    profile: Floats,
    folded: Ints,
) -> int:
    """Sample a profile of three parts: fold, turn theta while the arm is folded, unfold.

    Theta may have any angle while the arm is folded. Often the first or the last part of the
    robot's present profile is kept, so that the two are searched one at a time.

    Args:
        folded: first and last grid time at which the arm is folded, shape (2,), written.

    Other arguments as for sample_profile.

    Returns:
        The option that the profile ends at; INFEASIBLE if the parts do not fit together.
    """
    last = profile.shape[1] - 1
    copy_profile(plan.q[i], profile)
    t1, t2 = plan.folded[i]
    which = next_uniform(rng)
    first, second = which < 0.55, which >= 0.45  # the parts to sample: folding, unfolding
    if t1 == 0:
        first = second = True
    choice = plan.choice[i]
    theta, phi = profile[0, last], profile[1, last]
    if second and choice >= 0:
        choice = _sample_option(scene, plan, i, step_s, rng)
        theta, phi = scene.options[i, choice]
    theta_step, phi_step = scene.speed_alone[i, 0] * step_s, scene.speed_alone[i, 1] * step_s
    theta1, theta2 = profile[0, t1], profile[0, t2]

    # the arm is folded from t1, at (theta1, phi1), to t2, at (theta2, phi2)
    phi1, phi2 = _sample_folded_phi(
        scene.folded_phi[i], scene.start[i, 1], profile, t1, t2, first, second, phi, rng
    )
    fold = max(2, least_intervals(phi1 - scene.start[i, 1], phi_step))
    unfold = max(2, least_intervals(phi - phi2, phi_step))
    t1, t2 = _sample_folded_times(first, second, t1, t2, last, fold, unfold, rng)
    if t1 < 0:
        return INFEASIBLE
    feasible, theta1, theta2 = _sample_folded_theta(
        scene.start[i, 0], scene.low[i, 0], scene.high[i, 0], theta_step,
        first, second, t1, t2, last, theta, theta1, theta2, rng,
    )  # fmt: skip
    if not feasible or abs(phi2 - phi1) > phi_step * (t2 - t1) * _ROUNDING:
        return INFEASIBLE

    # Often a robot waits before it folds, or is unfolded early: both joints together. Often
    # one joint moves first, and the other one when it is done.
    turn_out = max(2, least_intervals(theta1 - scene.start[i, 0], theta_step))
    turn_in = max(2, least_intervals(theta2 - theta, theta_step))
    begin = _sample_pause(t1 - max(fold, turn_out), rng)
    end = last - _sample_pause(last - t2 - max(unfold, turn_in), rng)
    kind = next_uniform(rng)
    sequential, theta_first = kind < _SEQUENTIAL, kind < 0.5 * _SEQUENTIAL
    for joint in range(2):
        low, high = scene.low[i, joint], scene.high[i, joint]
        step = theta_step if joint == 0 else phi_step
        s, g = scene.start[i, joint], theta if joint == 0 else phi
        m1, m2 = (theta1, theta2) if joint == 0 else (phi1, phi2)
        own_out, other_out = (turn_out, fold) if joint == 0 else (fold, turn_out)
        own_in, other_in = (turn_in, unfold) if joint == 0 else (unfold, turn_in)
        spread = math.pi * next_uniform(rng)
        if first:
            a, b = _ramp_span(
                begin, t1, own_out, other_out, sequential, theta_first == (joint == 0)
            )
            _sample_ramp(profile[joint, : t1 + 1], s, m1, a, b, low, high, step, spread, rng)
        if second:  # in the reverse order of the joints
            a, b = _ramp_span(t2, end, own_in, other_in, sequential, theta_first == (joint == 1))
            _sample_ramp(profile[joint, t2:], m2, g, a - t2, b - t2, low, high, step, spread, rng)
        for k in range(t1 + 1, t2):
            profile[joint, k] = m1 + (m2 - m1) * ((k - t1) / (t2 - t1))
    folded[0], folded[1] = t1, t2
    return choice


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _sample_folded_phi(folded_phi, start, profile, t1, t2, first, second, phi, rng):
    # The folded angles at t1 and t2: mostly the nearer one, for the way out and the way in.
    phi1, phi2 = profile[1, t1], profile[1, t2]
    if first:
        phi1 = nearer_fold(folded_phi, start)
        if next_uniform(rng) < 0.2:
            phi1 = folded_phi[int(2 * next_uniform(rng))]
    if second:
        phi2 = nearer_fold(folded_phi, phi)
        if next_uniform(rng) < 0.2:
            phi2 = phi1
    return phi1, phi2


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _sample_folded_times(first, second, t1, t2, last, fold, unfold, rng):
    # The grid times between which the arm is folded; early and late ones are more likely.
    # They leave time to fold and to unfold. (-1, -1) if there is not as much time.
    if second:
        spare = last - unfold - 1 - (fold if first else t1)
        if spare < 0:
            return -1, -1
        t2 = last - unfold - int(next_uniform(rng) ** 2 * (spare + 1))
    if first:
        spare = t2 - 1 - fold
        if spare < 0:
            return -1, -1
        t1 = fold + int(next_uniform(rng) ** 2 * (spare + 1))
    return t1, t2


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _sample_folded_theta(
    start, low, high, step, first, second, t1, t2, last, theta, theta1, theta2, rng
):  # fmt: skip
    # Theta at t1 and t2, inside the joint limits and such that the joint can go from its start
    # to theta1, to theta2 and to its end theta in time. Also returns whether there are such.
    out, between, back = step * t1, step * (t2 - t1), step * (last - t2)
    spread = 2.0 * math.pi * next_uniform(rng) ** 2
    if second:
        theta2 = theta + spread * (2.0 * next_uniform(rng) - 1.0)
        theta2 = _clipped(theta2, theta - back, theta + back)
    if first:
        theta1 = start + spread * (2.0 * next_uniform(rng) - 1.0)
        theta1 = _clipped(theta1, start - out, start + out)
        theta1 = _clipped(theta1, theta2 - between, theta2 + between)
        theta1 = _clipped(theta1, low, high)
        if abs(theta1 - start) > out * _ROUNDING:
            if not second:
                return False, theta1, theta2
            theta1 = start + math.copysign(out, theta1 - start)
    if second:
        theta2 = _clipped(theta2, theta1 - between, theta1 + between)
        theta2 = _clipped(theta2, low, high)
        if abs(theta2 - theta) > back * _ROUNDING:
            return False, theta1, theta2
    return abs(theta2 - theta1) <= between * _ROUNDING, theta1, theta2


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _sample_pause(most, rng):
    # a number of intervals in 0..most, often 0
    return int(next_uniform(rng) * (most + 1)) if next_uniform(rng) < 0.5 else 0


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _ramp_span(begin, end, own, other, sequential, goes_first):
    # The part of begin..end in which a joint moves, if the joints move one after the other and
    # need `own` and `other` intervals; all of it if they move together or have no time.
    if sequential and end - begin >= own + other:
        if goes_first:
            return begin, begin + own
        return begin + other, end
    return begin, end


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _sample_ramp(row, s, g, begin, end, low, high, per_interval, spread, rng):
    # a profile that rests at s until `begin`, goes to g until `end`, and rests
    for k in range(len(row)):
        row[k] = s if k <= begin else g
    part = row[begin : end + 1]
    if next_uniform(rng) < 0.6:
        sample_window(part, s, g, per_interval, rng)
    else:
        dwell = next_uniform(rng) < 0.5
        sample_via(part, s, g, low, high, per_interval, spread, dwell, rng)
