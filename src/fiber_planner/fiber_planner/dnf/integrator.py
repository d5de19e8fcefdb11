# SPDX-License-Identifier: Apache-2.0
"""One time step of the control law: the wanted steps of all joints, and the steps made."""

import math

import numba as nb
import numpy as np

from fiber_core.array_types import Angles, Bools, Floats, Points
from fiber_planner.dnf.navigation_function import ControlLaw, Swarm, attraction

__all__ = ["apply_steps", "arm_points", "joint_steps", "longest_step"]


@nb.njit(cache=True)
def arm_points(angles: Angles, swarm: Swarm) -> tuple[Points, Points]:
    """Return the elbows and tips of all robots [mm], both of shape (n, 2).

    Forward kinematics as in fiber_core.kinematics.forward, several times as fast.

    Args:
        angles: joint angles [rad], shape (n, 2).
        swarm: the robots.
    """
    elbows, tips = np.empty_like(angles), np.empty_like(angles)
    for i in range(len(angles)):
        theta, to_tip = angles[i, 0], angles[i, 0] + angles[i, 1]
        l1, l2 = swarm.arms[i]
        elbows[i, 0] = swarm.center[i, 0] + l1 * math.cos(theta)
        elbows[i, 1] = swarm.center[i, 1] + l1 * math.sin(theta)
        tips[i, 0] = elbows[i, 0] + l2 * math.cos(to_tip)
        tips[i, 1] = elbows[i, 1] + l2 * math.sin(to_tip)
    return elbows, tips


@nb.njit(cache=True)
def joint_steps(
    angles: Angles, elbows: Points, tips: Points, push: Angles, swarm: Swarm, law: ControlLaw
) -> tuple[Angles, Bools]:
    """Return the step that the control law wants of each joint, before it is shortened.

    Speeds are minus the gradient of the navigation function. If one exceeds its limit both
    are reduced by one factor, so the direction stays. A joint on its stop does not move
    against it.

    Args:
        angles: joint angles [rad], shape (n, 2).
        elbows: the elbows at those angles [mm], shape (n, 2).
        tips: the tips at those angles [mm], shape (n, 2).
        push: joint speeds that the neighbours' repulsion causes [rad/s], shape (n, 2).
        swarm: the robots, with the goals that they aim at.
        law: the control law.

    Returns:
        Steps [rad], shape (n, 2), and whether the whole step ends on the goal, shape (n,).
    """
    step, arrives = np.zeros_like(angles), np.zeros(len(angles), dtype=np.bool_)
    for i in range(len(angles)):
        if not swarm.movable[i]:
            continue
        u0, u1, arrives[i] = _wanted_speeds(i, angles, elbows, tips, push[i], swarm, law)
        u0 = _stopped_at_limit(u0, angles[i, 0], swarm.low[i, 0], swarm.high[i, 0])
        u1 = _stopped_at_limit(u1, angles[i, 1], swarm.low[i, 1], swarm.high[i, 1])
        excess = max(abs(u0) / swarm.speed[i, 0], abs(u1) / swarm.speed[i, 1])
        arrives[i] &= excess <= 1.0 + 1e-9
        scale = law.dt / max(1.0, excess)
        for joint, u in enumerate((u0, u1)):
            low, high = swarm.low[i, joint], swarm.high[i, joint]
            step[i, joint] = min(max(angles[i, joint] + scale * u, low), high) - angles[i, joint]
    return step, arrives


@nb.njit(cache=True)
def _stopped_at_limit(speed, angle, low, high):
    if (speed < 0.0 and angle <= low) or (speed > 0.0 and angle >= high):
        return 0.0
    return speed


@nb.njit(cache=True)
def _wanted_speeds(i, angles, elbows, tips, push, swarm, law):
    # The joint speeds of robot i before limits, and whether they end on its goal.
    # Far from the goal they are minus the gradient. Near it a step of finite length would
    # overshoot, so the step in the cone is implicit: x' = x + dt (push + pull(x')),
    # which is x + dt push shrunk by dt times the slope. The robot meets the goal exactly, and
    # stays there against any push weaker than the slope.
    _, pull0, pull1 = attraction(i, angles, elbows, tips, swarm, law)
    if not law.joint:
        fraction = _without_overshoot(i, elbows, tips, pull0, pull1, swarm, law)
        return fraction * pull0 + push[0], fraction * pull1 + push[1], False
    a0, a1 = angles[i, 0] - swarm.goal[i, 0], angles[i, 1] - swarm.goal[i, 1]
    slope = _length(swarm.speed[i, 0], swarm.speed[i, 1])
    farther_than_one_step = _length(a0, a1) >= law.dt * slope
    if farther_than_one_step and _length(pull0, pull1) > slope * (1.0 + 1e-12):
        return pull0 + push[0], pull1 + push[1], False
    x0, x1 = a0 + law.dt * push[0], a1 + law.dt * push[1]
    size = _length(x0, x1)
    if size <= law.dt * slope:
        return -a0 / law.dt, -a1 / law.dt, True
    keep = 1.0 - law.dt * slope / size
    return (keep * x0 - a0) / law.dt, (keep * x1 - a1) / law.dt, False


@nb.njit(cache=True)
def _length(x, y):
    return math.sqrt(x * x + y * y)


@nb.njit(cache=True)
def _without_overshoot(i, elbows, tips, pull0, pull1, swarm, law):
    # Fraction of the attraction of the tip that leads, in one step, no farther than the
    # bottom of the paraboloid along its own direction (Cauchy's step).
    tip_vx = -(tips[i, 1] - swarm.center[i, 1]) * pull0 - (tips[i, 1] - elbows[i, 1]) * pull1
    tip_vy = (tips[i, 0] - swarm.center[i, 0]) * pull0 + (tips[i, 0] - elbows[i, 0]) * pull1
    longest = pull0 * pull0 + pull1 * pull1
    step = 2.0 * law.lambda1 * law.dt * (tip_vx * tip_vx + tip_vy * tip_vy)
    return 1.0 if step <= longest else longest / step


@nb.njit(cache=True)
def longest_step(closing: float, bend: float, allowed: float) -> float:
    """Return the largest fraction f <= 1 with f closing + f^2 bend / 2 <= allowed.

    Args:
        closing: closing displacement of the full step to first order [mm].
        bend: bound of its second derivative along the step [mm].
        allowed: distance by which the step may close in [mm]; at zero or less the step may
            only part.
    """
    allowed = max(allowed, 0.0)
    if closing + 0.5 * bend <= allowed:
        return 1.0
    if allowed == 0.0:
        return -2.0 * closing / bend if closing < 0.0 else 0.0
    root = math.sqrt(closing * closing + 2.0 * bend * allowed)
    fraction = 2.0 * allowed / (closing + root) if closing > 0.0 else (root - closing) / bend
    return min(1.0, fraction)


@nb.njit(cache=True)
def apply_steps(
    angles: Angles, step: Angles, arrives: Bools, fraction: Floats, swarm: Swarm
) -> Angles:
    """Return the joint angles after a step [rad], shape (n, 2).

    Args:
        angles: joint angles before [rad], shape (n, 2).
        turn: the whole step [rad], shape (n, 2).
        arrives: whether the whole step ends on the goal, shape (n,).
        fraction: fraction of its step that each robot makes, shape (n,).
        swarm: the robots, with the goals that they aim at.
    """
    after = np.empty_like(angles)
    for i in range(len(angles)):
        if arrives[i] and fraction[i] == 1.0:
            after[i] = swarm.goal[i]
        else:
            after[i] = angles[i] + fraction[i] * step[i]
    return after
