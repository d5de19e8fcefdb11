# SPDX-License-Identifier: Apache-2.0
"""An independent judge of ends and motors: fibres on their targets, joints and motors in limits.

It reads the arrays of problem.npz and plan.npz and imports nothing of this project.
"""

from typing import NamedTuple

import numpy as np

__all__ = ["Ends", "judge_ends"]

_SAME = 1.0 + 1e-9
_SAME_RAD = 1e-6


class Ends(NamedTuple):
    """What was found.

    Args:
        error_um: largest distance of a fibre from its target, of robots that reached it [um].
        joints: robots that turn a joint too fast or outside its range.
        motors: robots that turn a coupled motor too fast or outside its range.
        fastest_motor: highest speed of a coupled motor by its limit, 0 without coupling.
    """

    error_um: float
    joints: int
    motors: int
    fastest_motor: float


def judge_ends(problem, plan) -> Ends:
    """Judge a plan.

    Args:
        problem, plan: the arrays of problem.npz and plan.npz.
    """
    n = len(problem["arm_mm"])
    joints, motors, fastest = 0, 0, 0.0
    end = np.empty((n, 2))
    identity = np.eye(2)
    for robot in range(n):
        times, angles = _both_joints(plan, robot)
        end[robot] = angles[-1]
        speeds, limits = problem["speed_rad_s"][robot], problem["limits_rad"][robot]
        joints += _broken(times, angles, identity, speeds, limits)[0]
        if "coupling" in problem:
            limits = problem["motor_limits_rad"][robot]
            speeds, coupling = problem["motor_speed_rad_s"][robot], problem["coupling"][robot]
            broken, speed = _broken(times, angles, coupling, speeds, limits)
            motors += broken
            fastest = max(fastest, speed)
    reached = plan["outcome_names"][plan["outcome"]] == "reached"
    error_um = 1e3 * _away_mm(problem, end)[reached].max(initial=0.0)
    return Ends(float(error_um), int(joints), int(motors), float(fastest))


def _both_joints(plan, robot: int) -> tuple[np.ndarray, np.ndarray]:
    # both angles at every change of the speed of a joint
    profiles = []
    for joint in range(2):
        part = slice(*plan["offsets"][2 * robot + joint : 2 * robot + joint + 2])
        lasts = plan["duration_s"][part]
        turns = lasts * plan["velocity_rad_s"][part]
        first = plan["start_rad"][robot, joint]
        profiles.append((np.append(0.0, np.cumsum(lasts)), first + np.append(0.0, turns.cumsum())))
    times = np.unique(np.concatenate([times for times, _ in profiles]))
    return times, np.stack([np.interp(times, *profile) for profile in profiles], axis=1)


def _broken(times, angles, coupling, speeds, limits) -> tuple[bool, float]:
    # whether a range or a speed is exceeded, and the highest speed by its limit
    turned = angles @ coupling.T
    low = np.minimum(limits[:, 0], turned[0]) - _SAME_RAD * np.abs(coupling).sum(axis=1)
    high = np.maximum(limits[:, 1], turned[0]) + _SAME_RAD * np.abs(coupling).sum(axis=1)
    outside = bool(((turned < low) | (turned > high)).any())
    steps = np.diff(times)
    long = steps > 1e-9  # two sums of the same ticks may differ in the last digit
    share = np.abs(np.diff(turned, axis=0)[long] / steps[long, None]) / speeds
    fastest = float(share.max(initial=0.0))
    return outside or fastest > _SAME + 1e-6, fastest


def _away_mm(problem, end) -> np.ndarray:
    # distance of the fibre of each robot, or of its nearest one, from its target
    theta, both = end[:, 0], end.sum(axis=1)
    arm = problem["arm_mm"]
    elbow = problem["center_mm"] + arm[:, :1] * np.stack([np.cos(theta), np.sin(theta)], axis=1)
    fibres = problem.get("fibre_mm", np.stack([arm[:, 1], 0.0 * arm[:, 1]], axis=1)[:, None])
    u, v = np.moveaxis(fibres, -1, 0)
    c, s = np.cos(both)[:, None], np.sin(both)[:, None]
    places = elbow[:, None] + np.stack([c * u - s * v, s * u + c * v], axis=-1)
    away = np.hypot(*np.moveaxis(places - problem["target_mm"][:, None], -1, 0))
    chosen = problem.get("fibre", np.full(len(arm), -1))
    other = (chosen >= 0)[:, None] & (chosen[:, None] != np.arange(fibres.shape[1]))
    return np.where(other, np.inf, away).min(axis=1)
