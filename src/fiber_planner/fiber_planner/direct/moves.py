"""Candidates: whole profiles of a robot, drawn for it to try."""

import math

import numba as nb

from fiber_core.clearance import pair_gap_below
from fiber_planner.direct.profile_sampling import (
    copy_profile,
    fold_profile,
    least_intervals,
    next_uniform,
    via_profile,
    window,
)

__all__ = ["NO_FIT", "draw_any", "draw_folded", "draw_half", "nearer_fold"]

NO_FIT = -2
_IN_TURNS = 0.4  # share of folded draws in which one joint waits for the other
_OTHER_OPTION = 0.3  # share of draws that end in another configuration on the target


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def nearer_fold(fold, phi):
    """Return which of the two folded angles, shape (2,), is nearer to phi [rad]."""
    return fold[0] if abs(fold[0] - phi) <= abs(fold[1] - phi) else fold[1]


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _option(crowd, draft, i, step_s, state):
    # The option to end in: the robot's own, or now and then another one that is in reach
    # and clear of where its neighbours end. The goals chosen at first are clear of each
    # other, and so they stay.
    own = draft.choice[i]
    if crowd.options[i] < 2 or next_uniform(state) >= _OTHER_OPTION:
        return own
    other = int(next_uniform(state) * crowd.options[i])
    last = draft.q.shape[2] - 1
    for joint in range(2):
        turn = crowd.option[i, other, joint] - crowd.start[i, joint]
        if least_intervals(turn, crowd.speed[i, joint] * step_s) > last:
            return own
    theta, phi = crowd.option[i, other]
    for e in range(crowd.offsets[i], crowd.offsets[i + 1]):
        j, required = crowd.neighbours[e], draft.required[crowd.pair[e]]
        theta_j, phi_j = draft.q[j, 0, last], draft.q[j, 1, last]
        if pair_gap_below(crowd.bodies, i, j, theta, phi, theta_j, phi_j, required) < required:
            return own
    return other


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def draw_any(crowd, draft, i, number, many, step_s, folding, state, profile):
    """Draw a whole new profile; simple ones first, then third angles farther and farther out.

    Args:
        crowd: the robots.
        draft: the plan.
        i: row of the robot.
        number, many: this is candidate `number` of `many`.
        step_s: length of a grid interval [s].
        folding: share of the candidates that fold the arm on their way.
        state: of the generator.
        profile: joint angles on the grid [rad], shape (2, k + 1), written.

    Returns:
        The option the profile ends in, -1 where the robot may end anywhere.
    """
    last = profile.shape[1] - 1
    choice = draft.choice[i]
    theta, phi = crowd.start[i]
    if choice >= 0:
        choice = _option(crowd, draft, i, step_s, state)
        theta, phi = crowd.option[i, choice]
    elif number > 0:
        ease = (number / many) ** 2
        for joint in range(2):
            span = min(crowd.speed[i, joint] * step_s * last, math.pi * ease)
            end = crowd.start[i, joint] + span * (2.0 * next_uniform(state) - 1.0)
            end = min(max(end, crowd.low[i, joint]), crowd.high[i, joint])
            if joint == 0:
                theta = end
            else:
                phi = end
    folds = next_uniform(state) < folding
    kind = next_uniform(state)
    progress = number / many
    for joint in range(2):
        s = crowd.start[i, joint]
        g = theta if joint == 0 else phi
        per_interval = crowd.speed[i, joint] * step_s
        spread = math.pi * (0.15 + progress) * (0.2 + 0.8 * next_uniform(state))
        straight = (
            progress < 0.3 or (kind < 0.3 and joint == 0) or (0.3 < kind < 0.5 and joint == 1)
        )
        if folds and joint == 1:
            fold_profile(profile[joint], s, nearer_fold(crowd.fold[i], s), g, per_interval, state)
        elif straight:
            window(profile[joint], s, g, per_interval, state)
        else:
            dwell = progress > 0.5 and next_uniform(state) < 0.5
            via_profile(
                profile[joint], s, g, crowd.low[i, joint], crowd.high[i, joint],
                per_interval, spread, dwell, state,
            )  # fmt: skip
    return choice


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def draw_half(crowd, draft, i, step_s, state, profile):
    """Draw a profile that keeps one half of the robot's own, or only its ends.

    If only its ends, it passes the middle of the time partly folded and turned anyhow.
    Arguments as for draw_any.
    """
    last = profile.shape[1] - 1
    middle = last // 2
    copy_profile(draft.q[i], profile)
    which = next_uniform(state)
    first, second = which < 0.4 or which >= 0.8, which >= 0.4
    turn = next_uniform(state) ** 2
    for joint in range(2):
        s, g = profile[joint, 0], profile[joint, last]
        per_interval = crowd.speed[i, joint] * step_s
        m = profile[joint, middle]
        if first and second:
            far, back = per_interval * middle, per_interval * (last - middle)
            low = max(crowd.low[i, joint], max(s - far, g - back))
            high = min(crowd.high[i, joint], min(s + far, g + back))
            if joint == 0:
                wanted = m + math.pi * turn * (2.0 * next_uniform(state) - 1.0)
            else:
                wanted = nearer_fold(crowd.fold[i], m)
                wanted += (0.5 * (s + g) - wanted) * next_uniform(state)
            if low <= high:
                m = min(max(wanted, low), high)
        spread = math.pi * next_uniform(state)
        for leg in range(2):
            if leg == 0:
                wanted_leg, row, begin, end = first, profile[joint, : middle + 1], s, m
            else:
                wanted_leg, row, begin, end = second, profile[joint, middle:], m, g
            if not wanted_leg:
                continue
            if next_uniform(state) < 0.55:
                window(row, begin, end, per_interval, state)
            else:
                via_profile(
                    row, begin, end, crowd.low[i, joint], crowd.high[i, joint],
                    per_interval, spread, next_uniform(state) < 0.5, state,
                )  # fmt: skip


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _least(a, b, step):
    return max(2, least_intervals(a - b, step))


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _draw_leg(row, s, g, low, high, per_interval, spread, state):
    if next_uniform(state) < 0.6:
        window(row, s, g, per_interval, state)
    else:
        dwell = next_uniform(state) < 0.5
        via_profile(row, s, g, low, high, per_interval, spread, dwell, state)


@nb.njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def draw_folded(crowd, draft, i, step_s, state, profile, legs):
    """Draw a profile in three parts: fold, turn while folded, unfold.

    Theta is anywhere when the arm is folded. Often the first or the last part of the
    robot's own profile is kept, so that the two are searched one at a time.

    Args:
        legs: grid times at which the arm is folded and unfolds, shape (2,), written.

    Other arguments as for draw_any.

    Returns:
        The option the profile ends in; NO_FIT if the parts drawn do not fit together.
    """
    last = profile.shape[1] - 1
    copy_profile(draft.q[i], profile)
    t1, t2 = draft.legs[i]
    which = next_uniform(state)
    first, second = which < 0.55, which >= 0.45
    if t1 == 0:
        first = second = True
    choice = draft.choice[i]
    turn_step, bend_step = crowd.speed[i, 0] * step_s, crowd.speed[i, 1] * step_s
    theta, phi = profile[0, last], profile[1, last]
    if second and choice >= 0:
        choice = _option(crowd, draft, i, step_s, state)
        theta, phi = crowd.option[i, choice]
    v1, v2 = profile[1, t1], profile[1, t2]
    theta1, theta2 = profile[0, t1], profile[0, t2]
    if first:
        v1 = nearer_fold(crowd.fold[i], crowd.start[i, 1])
        if next_uniform(state) < 0.2:
            v1 = crowd.fold[i, int(2 * next_uniform(state))]
    if second:
        v2 = nearer_fold(crowd.fold[i], phi)
        if next_uniform(state) < 0.2:
            v2 = v1
    there = max(2, least_intervals(v1 - crowd.start[i, 1], bend_step))
    back = max(2, least_intervals(phi - v2, bend_step))
    if second:
        room = last - back - 1 - (there if first else t1)
        if room < 0:
            return NO_FIT
        t2 = last - back - int(next_uniform(state) ** 2 * (room + 1))
    if first:
        room = t2 - 1 - there
        if room < 0:
            return NO_FIT
        t1 = there + int(next_uniform(state) ** 2 * (room + 1))
    spread = 2.0 * math.pi * next_uniform(state) ** 2
    if second:
        theta2 = theta + spread * (2.0 * next_uniform(state) - 1.0)
        reach = turn_step * (last - t2)
        theta2 = min(max(theta2, theta - reach), theta + reach)
    if first:
        theta1 = crowd.start[i, 0] + spread * (2.0 * next_uniform(state) - 1.0)
        reach = turn_step * t1
        theta1 = min(max(theta1, crowd.start[i, 0] - reach), crowd.start[i, 0] + reach)
        between = turn_step * (t2 - t1)
        theta1 = min(max(theta1, theta2 - between), theta2 + between)
        theta1 = min(max(theta1, crowd.low[i, 0]), crowd.high[i, 0])
        if abs(theta1 - crowd.start[i, 0]) > reach * (1.0 + 1e-9):
            if not second:
                return NO_FIT
            theta1 = crowd.start[i, 0] + math.copysign(reach, theta1 - crowd.start[i, 0])
    if second:
        between = turn_step * (t2 - t1)
        reach = turn_step * (last - t2)
        theta2 = min(max(theta2, theta1 - between), theta1 + between)
        theta2 = min(max(theta2, crowd.low[i, 0]), crowd.high[i, 0])
        if abs(theta2 - theta) > reach * (1.0 + 1e-9):
            return NO_FIT
    if abs(theta2 - theta1) > turn_step * (t2 - t1) * (1.0 + 1e-9):
        return NO_FIT
    if abs(v2 - v1) > bend_step * (t2 - t1) * (1.0 + 1e-9):
        return NO_FIT
    # often a robot waits before it folds, or is unfolded early: both joints together
    wait = early = 0
    if next_uniform(state) < 0.5:
        wait = int(
            next_uniform(state)
            * (t1 - max(there, _least(theta1, crowd.start[i, 0], turn_step)) + 1)
        )
    if next_uniform(state) < 0.5:
        early = int(
            next_uniform(state) * (last - t2 - max(back, _least(theta2, theta, turn_step)) + 1)
        )
    # often one joint turns first and the other when it is done
    out_turn, out_bend = _least(theta1, crowd.start[i, 0], turn_step), there
    in_turn, in_bend = _least(theta2, theta, turn_step), back
    kind = next_uniform(state)
    in_turns = kind < _IN_TURNS
    turn_first = kind < 0.5 * _IN_TURNS
    for joint in range(2):
        low, high = crowd.low[i, joint], crowd.high[i, joint]
        step = turn_step if joint == 0 else bend_step
        m1, m2 = (theta1, theta2) if joint == 0 else (v1, v2)
        wide = math.pi * next_uniform(state)
        if first:
            s = crowd.start[i, joint]
            begin, end = wait, t1
            if in_turns and t1 - wait >= out_turn + out_bend:
                if turn_first == (joint == 0):
                    end = wait + (out_turn if joint == 0 else out_bend)
                else:
                    begin = wait + (out_bend if joint == 0 else out_turn)
            for k in range(t1 + 1):
                profile[joint, k] = s if k <= begin else m1
            _draw_leg(profile[joint, begin : end + 1], s, m1, low, high, step, wide, state)
        if second:
            g = theta if joint == 0 else phi
            begin, end = t2, last - early
            if in_turns and last - early - t2 >= in_turn + in_bend:
                if turn_first == (joint == 1):  # the way out, backwards
                    end = t2 + (in_turn if joint == 0 else in_bend)
                else:
                    begin = t2 + (in_bend if joint == 0 else in_turn)
            for k in range(t2, last + 1):
                profile[joint, k] = m2 if k <= begin else g
            _draw_leg(profile[joint, begin : end + 1], m2, g, low, high, step, wide, state)
        for k in range(t1 + 1, t2):
            profile[joint, k] = m1 + (m2 - m1) * ((k - t1) / (t2 - t1))
    legs[0], legs[1] = t1, t2
    return choice
