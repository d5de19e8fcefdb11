# SPDX-License-Identifier: Apache-2.0
"""The navigation function of a robot: attraction to its goal, repulsion between neighbours.

Equations 1 to 4 of Makarem et al. (SPIE 2014, arXiv 1410.1181), errata handled as
docs/dnf.md lists:

    psi_i = lambda1 |q_i - q_iT|^2 + lambda2 sum_j max(0, (D^2 - r_ij^2) / (r_ij^2 - d^2))
    u_i   = - grad_(theta, phi) psi_i

q is a tip, r_ij the distance of two tips. The gradient passes through the Jacobian
of the arm. With attraction in joint space |q_i - q_iT|^2 becomes L^2 |a_i - a_iT|^2,
a the two joint angles and L^2 = l1^2 + l2^2 the mean square distance of a tip from
its axis, so that lambda1 keeps its unit.
"""

import math
from typing import NamedTuple, TypeAlias

import numba as nb
import numpy as np

from fiber_core import kinematics
from fiber_core.array_types import Angles, Floats, Mask, Points
from fiber_core.focal_plane import FocalPlane
from fiber_planner.dnf.parameters import DnfParameters

__all__ = ["Contacts", "ControlLaw", "Swarm", "attraction", "repulsion", "to_joints"]

# Geometry of one step that `repel` computes and `step_fractions` uses again.
Contacts: TypeAlias = tuple[Floats, ...]

_SOFTEST = 1e-6  # [d^2] below d^2 (1 + this) the barrier goes on as a straight line


class ControlLaw(NamedTuple):
    """The control law: joint speeds are minus the gradient of the navigation function.

    Args:
        lambda1: weight of the attraction [1/(mm^2 s)].
        lambda2: weight of the repulsion [1/s], negative for the sign as printed.
        outer: D [mm].
        inner: d [mm].
        joint: whether attraction acts in joint space, else on the tip.
        adaptive: whether steps are shortened near neighbours.
        dt: time step [s].
    """

    lambda1: float
    lambda2: float
    outer: float
    inner: float
    joint: bool
    adaptive: bool
    dt: float

    @classmethod
    def of(cls, plane: FocalPlane, parameters: DnfParameters) -> "ControlLaw":
        """Return the control law with the values that the parameters have on a plane."""
        outer, inner = parameters.radii_mm(plane)
        return cls(
            parameters.lambda1,
            parameters.lambda2 * (1 if parameters.sign == "corrected" else -1),
            outer,
            inner,
            parameters.attraction == "joint",
            bool(parameters.adaptive),
            parameters.step_s(plane),
        )


class Swarm(NamedTuple):
    """All robots as arrays for the control law; constant during a plan.

    Args:
        center: theta axes [mm], shape (n, 2).
        arms: arm lengths [mm], shape (n, 2).
        low: lower joint limits [rad], shape (n, 2).
        high: upper joint limits [rad], shape (n, 2).
        speed: highest joint speeds [rad/s], shape (n, 2).
        movable: robots that may move, shape (n,).
        goal: joint angles aimed at [rad], shape (n, 2).
        goal_tip: the tip at those angles [mm], shape (n, 2).
    """

    center: Points
    arms: Floats
    low: Angles
    high: Angles
    speed: Floats
    movable: Mask
    goal: Angles
    goal_tip: Points

    @classmethod
    def of(cls, plane: FocalPlane, start: Angles, goal: Angles, movable: Mask) -> "Swarm":
        """Collect the robots of a plane.

        Args:
            plane: the focal plane.
            start: joint angles now [rad], shape (n, 2). A robot that starts outside its
                joint limits may move back into them but not farther out.
            goal: joint angles that each robot aims at [rad], shape (n, 2).
            movable: robots that may move, shape (n,).
        """
        return cls(
            plane.centers,
            plane.arms,
            np.minimum(plane.limits[:, :, 0], start),
            np.maximum(plane.limits[:, :, 1], start),
            plane.speeds,
            np.array(movable, dtype=bool),
            np.array(goal, dtype=float),
            kinematics.forward(plane, goal)[1],
        )


@nb.njit(cache=True)
def repulsion(square: float, lambda2: float, outer: float, inner: float) -> tuple[float, float]:
    """Return the repulsion between two neighbours [1/s] and its derivative by r^2.

    (D^2 - r^2) / (r^2 - d^2) = (D^2 - d^2) / (r^2 - d^2) - 1. At d and below, which
    only pairs that start there can reach, the barrier is continued as a straight line
    in r^2: it still parts the two and stays finite. As printed, with the wrong sign, it is
    zero below d.

    Args:
        square: r^2 [mm^2].
        lambda2: weight [1/s], negative for the sign as printed.
        outer: D [mm].
        inner: d [mm].
    """
    inner2 = inner * inner
    if square >= outer * outer or (lambda2 < 0.0 and square <= inner2):
        return 0.0, 0.0
    width = outer * outer - inner2
    above = max(square - inner2, _SOFTEST * inner2)
    slope = -width / (above * above)
    value = width / above - 1.0 + slope * (square - inner2 - above)
    return lambda2 * value, lambda2 * slope


@nb.njit(cache=True)
def to_joints(
    fx: float, fy: float, x: float, y: float, center: Floats, elbow: Floats
) -> tuple[float, float]:
    """Return the joint speeds that a force (fx, fy) at the point (x, y) of the phi arm causes.

    J^T f: the columns of J are the vectors from the centre and from the elbow to the point,
    turned by 90 degrees.
    """
    return (
        (x - center[0]) * fy - (y - center[1]) * fx,
        (x - elbow[0]) * fy - (y - elbow[1]) * fx,
    )


@nb.njit(cache=True)
def attraction(
    i: int, angles: Angles, elbows: Points, tips: Points, swarm: Swarm, law: ControlLaw
) -> tuple[float, float, float]:
    """Return the potential of the goal of robot i [1/s] and minus its gradient [rad/s].

    In joint space the paraboloid lambda1 L^2 |a|^2 ends in a cone at its centre whose
    slope c, the hypotenuse of both speed limits, drives at full speed up to the goal.
    The cone begins where the paraboloid is as steep, at c / (2 lambda1 L^2).

    Args:
        i: row of the robot.
        angles: joint angles of all robots [rad], shape (n, 2).
        elbows: their elbows [mm], shape (n, 2).
        tips: their tips [mm], shape (n, 2).
        swarm: the Swarm.
        law: the ControlLaw.
    """
    if not law.joint:
        ex, ey = tips[i, 0] - swarm.goal_tip[i, 0], tips[i, 1] - swarm.goal_tip[i, 1]
        gain = -2.0 * law.lambda1
        pull0, pull1 = to_joints(
            gain * ex, gain * ey, tips[i, 0], tips[i, 1], swarm.center[i], elbows[i]
        )
        return law.lambda1 * (ex * ex + ey * ey), pull0, pull1
    a0, a1 = angles[i, 0] - swarm.goal[i, 0], angles[i, 1] - swarm.goal[i, 1]
    away = math.sqrt(a0 * a0 + a1 * a1)
    if away == 0.0:
        return 0.0, 0.0, 0.0
    slope = math.sqrt(swarm.speed[i, 0] ** 2 + swarm.speed[i, 1] ** 2)
    gain = 2.0 * law.lambda1 * (swarm.arms[i, 0] ** 2 + swarm.arms[i, 1] ** 2)
    if gain * away >= slope:
        value = 0.5 * gain * away * away + 0.5 * slope * slope / gain
        return value, -gain * a0, -gain * a1
    return slope * away, -slope * a0 / away, -slope * a1 / away
