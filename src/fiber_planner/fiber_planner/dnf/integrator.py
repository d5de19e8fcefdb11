"""One time step of the law: how far every robot would turn, and how far it does."""

import math

import numba as nb
import numpy as np

from fiber_planner.dnf.navigation_function import attraction

__all__ = ["longest_step", "places", "turned", "turns"]


@nb.njit(cache=True)
def places(angles, swarm):
    """Return the elbows and tips at joint angles [rad], shape (n, 2): [mm], both (n, 2).

    The same as fiber_core.kinematics.forward, several times as fast.
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
def turns(angles, elbows, tips, push, swarm, law):
    """Return by how much the law turns each joint in one step, neighbours still ignored.

    Speeds are minus the gradient of the navigation function, slowed until both joints
    keep their limits, direction kept. A joint that stands on its stop does not push
    against it.

    Args:
        angles: joint angles [rad], shape (n, 2).
        elbows: the elbows there [mm], shape (n, 2).
        tips: the tips there [mm], shape (n, 2).
        push: what neighbours ask of the joints [rad/s], shape (n, 2).
        swarm: the Swarm.
        law: the Law.

    Returns:
        Turns [rad], shape (n, 2), and whether the whole turn ends on the goal, (n,).
    """
    turn, lands = np.zeros_like(angles), np.zeros(len(angles), dtype=np.bool_)
    for i in range(len(angles)):
        if not swarm.movable[i]:
            continue
        u0, u1, lands[i] = _wanted(i, angles, elbows, tips, push[i], swarm, law)
        u0 = _off_the_stop(u0, angles[i, 0], swarm.low[i, 0], swarm.high[i, 0])
        u1 = _off_the_stop(u1, angles[i, 1], swarm.low[i, 1], swarm.high[i, 1])
        excess = max(abs(u0) / swarm.speed[i, 0], abs(u1) / swarm.speed[i, 1])
        lands[i] &= excess <= 1.0 + 1e-9
        scale = law.dt / max(1.0, excess)
        for joint, u in enumerate((u0, u1)):
            low, high = swarm.low[i, joint], swarm.high[i, joint]
            turn[i, joint] = min(max(angles[i, joint] + scale * u, low), high) - angles[i, joint]
    return turn, lands


@nb.njit(cache=True)
def _off_the_stop(speed, angle, low, high):
    if (speed < 0.0 and angle <= low) or (speed > 0.0 and angle >= high):
        return 0.0
    return speed


@nb.njit(cache=True)
def _wanted(i, angles, elbows, tips, push, swarm, law):
    # The joint speeds robot i would like to have, and whether they end on its goal.
    # Far from it they are minus the gradient. Near it a step of finite length would
    # overshoot, so the step in the cone is implicit: x' = x + dt (push + pull(x')),
    # which is x + dt push shrunk by dt times the slope. The goal is met exactly, and
    # kept against any push weaker than the slope.
    _, pull0, pull1 = attraction(i, angles, elbows, tips, swarm, law)
    if not law.joint:
        part = _without_overshoot(i, elbows, tips, pull0, pull1, swarm, law)
        return part * pull0 + push[0], part * pull1 + push[1], False
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
    # Part of the attraction of the tip that leads, in one step, no further than the
    # bottom of the paraboloid along its own direction (Cauchy's step).
    tip_vx = -(tips[i, 1] - swarm.center[i, 1]) * pull0 - (tips[i, 1] - elbows[i, 1]) * pull1
    tip_vy = (tips[i, 0] - swarm.center[i, 0]) * pull0 + (tips[i, 0] - elbows[i, 0]) * pull1
    longest = pull0 * pull0 + pull1 * pull1
    step = 2.0 * law.lambda1 * law.dt * (tip_vx * tip_vx + tip_vy * tip_vy)
    return 1.0 if step <= longest else longest / step


@nb.njit(cache=True)
def longest_step(closing, bend, allowed):
    """Return the largest factor f <= 1 with f closing + f^2 bend / 2 <= allowed.

    Args:
        closing: closing displacement of the full step to first order [mm].
        bend: bound of its second derivative along the step [mm].
        allowed: what may be closed in [mm]; at zero or less only parting is allowed.
    """
    allowed = max(allowed, 0.0)
    if closing + 0.5 * bend <= allowed:
        return 1.0
    if allowed == 0.0:
        return -2.0 * closing / bend if closing < 0.0 else 0.0
    root = math.sqrt(closing * closing + 2.0 * bend * allowed)
    factor = 2.0 * allowed / (closing + root) if closing > 0.0 else (root - closing) / bend
    return min(1.0, factor)


@nb.njit(cache=True)
def turned(angles, turn, lands, factor, swarm):
    """Return the joint angles after a step [rad], shape (n, 2).

    Args:
        angles: joint angles before [rad], shape (n, 2).
        turn: the whole turn [rad], shape (n, 2).
        lands: whether the whole turn ends on the goal, shape (n,).
        factor: part of its turn each robot makes, shape (n,).
        swarm: the Swarm.
    """
    after = np.empty_like(angles)
    for i in range(len(angles)):
        if lands[i] and factor[i] == 1.0:
            after[i] = swarm.goal[i]
        else:
            after[i] = angles[i] + factor[i] * turn[i]
    return after
