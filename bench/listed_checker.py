# SPDX-License-Identifier: Apache-2.0
"""An independent judge of plans for motors with listed speeds: rules, supplies and gaps.

It reads problem.npz and plan.npz and imports nothing of this project.
"""

from dataclasses import dataclass

import numpy as np
from gap_judge import Gaps, judge_gaps

__all__ = ["ListedVerdict", "check_listed"]

_SLACK = 1 + 1e-9


@dataclass(frozen=True)
class ListedVerdict:
    """What was found in a plan.

    Args:
        speeds: segments at a speed that is not listed.
        short: moves shorter than the least of their speed.
        approaches: joints that move and do not end with back and forth in creep.
        ramps: moves that begin before the ramp of the move before has ended.
        beyond: joints that leave their range.
        peak: largest share of the motors of a supply that are on at once.
        makespan_s: when the last motor stops [s].
        end_error_um: largest distance from tip to target of a robot that reached it [um].
        gaps: contacts and gaps of whole outlines, discs and walls, at every instant.
    """

    speeds: int
    short: int
    approaches: int
    ramps: int
    beyond: int
    peak: float
    makespan_s: float
    end_error_um: float
    gaps: Gaps

    @property
    def violations(self) -> int:
        """Number of all rules that are broken; supplies and gaps are not counted."""
        return self.speeds + self.short + self.approaches + self.ramps + self.beyond


def check_listed(problem_file, plan_file) -> ListedVerdict:
    """Judge a plan.

    Args:
        problem_file, plan_file: problem.npz and plan.npz.
    """
    with np.load(problem_file) as file:
        problem = dict(file)
    with np.load(plan_file) as file:
        plan = dict(file)
    numbers = problem["listed_speeds"]
    k = int(numbers[0])
    lists = numbers[1 : 1 + 3 * k].reshape(3, k)
    tolerance, approach, sign = (
        numbers[1 + 3 * k],
        numbers[2 + 3 * k :][:2],
        numbers[4 + 3 * k :][:2],
    )
    creep, returns = int(numbers[6 + 3 * k]), bool(numbers[7 + 3 * k])
    broken = np.zeros(5, dtype=int)
    on, supply = [], problem.get("supply", problem["bus"])
    for profile in range(2 * len(supply)):
        part = slice(plan["offsets"][profile], plan["offsets"][profile + 1])
        robot, joint = divmod(profile, 2)
        ordered = plan["duration_s"][part], plan["velocity_rad_s"][part]
        scale = problem["motor_scale"][robot, joint]
        moves, faulty = _moves(*ordered, scale, lists, float(tolerance))
        broken[0] += faulty
        angle = low = high = plan["start_rad"][robot, joint]
        ends = -np.inf
        for begin, end, turn, which, gear in moves:
            broken[1] += abs(turn) * _SLACK < lists[2, which] * gear
            broken[3] += begin < ends - 1e-9
            ends = end + lists[1, which]
            on.append((robot, begin, ends))
            angle += turn
            low, high = min(low, angle), max(high, angle)
        if moves:
            _, _, turn, which, _ = moves[-1]
            good = which == creep and turn * sign[joint] * _SLACK >= approach[joint]
            if returns:
                _, _, turn, which, _ = moves[-2] if len(moves) > 1 else (0, 0, 0.0, -1, 0)
                good &= which == creep and -turn * sign[joint] * _SLACK >= approach[joint]
            broken[2] += not good
            least, most = problem["limits_rad"][robot, joint]
            broken[4] += low < least - 1e-9 or high > most + 1e-9
    makespan_s = float(max((end for _, _, end in on), default=0.0))
    peak = _peak(on, supply, len(plan["offsets"]) // 2)
    speeds, short, approaches, ramps, beyond = broken.tolist()
    return ListedVerdict(
        speeds, short, approaches, ramps, beyond, peak, makespan_s, _end_error_um(problem, plan),
        judge_gaps(problem, plan),
    )  # fmt: skip


def _moves(lasts, velocity, scale, lists, tolerance):
    # (begin, end, turn, number of its speed, scale) of each run of one velocity; and wrong speeds
    moves, wrong, now, before = [], 0, 0.0, 0.0
    for duration, v in zip(lasts.tolist(), velocity.tolist()):
        if v != 0.0:
            gear = scale[int(v > 0.0)]
            away = np.abs(lists[0] * gear - abs(v))
            wrong += away.min() > tolerance * _SLACK
            if v == before:
                begin, _, turn, which, _ = moves.pop()
            else:
                begin, turn, which = now, 0.0, int(np.argmin(away))
            moves.append((begin, now + duration, turn + v * duration, which, gear))
        before = v
        now += duration
    return moves, int(wrong)


def _peak(on, supply, robots) -> float:
    # events in order of time, ends before begins at the same microsecond
    events = sorted(
        event
        for robot, begin, end in on
        for event in ((round(begin * 1e6), 1, supply[robot]), (round(end * 1e6), -1, supply[robot]))
    )
    count, worst = {}, 0.0
    motors = {group: 2 * int((supply == group).sum()) for group in np.unique(supply).tolist()}
    assert robots == len(supply)
    for _, change, group in events:
        count[int(group)] = count.get(int(group), 0) + change
        worst = max(worst, count[int(group)] / motors[int(group)])
    return worst


def _end_error_um(problem, plan) -> float:
    turns = plan["duration_s"] * plan["velocity_rad_s"]
    sums = np.concatenate([[0.0], np.cumsum(turns)])
    angles = plan["start_rad"] + np.diff(sums[plan["offsets"]]).reshape(-1, 2)
    arm, both = problem["arm_mm"], angles.sum(axis=1)
    x = arm[:, 0] * np.cos(angles[:, 0]) + arm[:, 1] * np.cos(both)
    y = arm[:, 0] * np.sin(angles[:, 0]) + arm[:, 1] * np.sin(both)
    reached = plan["outcome_names"][plan["outcome"]] == "reached"
    away = np.stack([x, y], axis=1) + problem["center_mm"] - problem["target_mm"]
    return float(1e3 * np.hypot(*away[reached].T).max(initial=0.0))
