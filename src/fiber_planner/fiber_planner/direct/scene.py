# SPDX-License-Identifier: Apache-2.0
"""The scene of the local search: outlines, limits, neighbours and goal options of all robots."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fiber_core import kinematics
from fiber_core.array_types import Angles, Bools, Floats, Gaps, Ints, Pairs
from fiber_core.clearance import Bodies, Neighbours, bodies_of, neighbour_pairs, neighbours_of
from fiber_core.focal_plane import FocalPlane
from fiber_core.motors import alone_s, longest_move_s, speeds_alone
from fiber_core.problem import Problem
from fiber_planner.direct.parameters import DirectParameters
from fiber_planner.direct.splitmix64 import place_keys

__all__ = ["Scene", "allowances_mm", "scene_of"]

_MOST_OPTIONS = 6
_FOLDED_RAD = np.deg2rad(135.0)
_ON_TARGET_MM = 1e-3  # a fibre this near to its target stays where it is
_SPEED = 0.998  # share of the speed limits that is planned with: rounding takes from the rest
# The orders follow both joints of a detour within a micrometre, not its times: coupled motors need
# more than rounding takes.
_MOTOR_SPEED = 0.99
_SAME_RAD = 1e-9  # a joint this near to its end stays where it is
_BESIDE_STATIC = 1.0 / 3.0  # share of the allowance of a pair of which one body never moves


class Scene(NamedTuple):
    """What does not change during a search; robots are rows 0..n-1, obstacles follow.

    Args:
        bodies: outlines of robots and obstacles.
        lever: lengths that turn angles into displacements [mm], shape (b, 3): the theta arm,
            the farthest point of the phi link from the elbow, the farthest point of the theta
            link from the centre.
        near: neighbours of every body, by row.
        pairs: rows a < b of which at least one can move, shape (p, 2).
        start: joint angles now [rad], shape (n, 2).
        low: lower joint limits [rad], shape (n, 2).
        high: upper joint limits [rad], shape (n, 2).
        speed: highest joint speeds to plan with [rad/s], shape (n, 2).
        speed_alone: the same while the other joint of the robot rests; less where they are coupled.
        folded_phi: phi of the arm folded clockwise and counter-clockwise; twice the same if
            the limits allow only one of them [rad], shape (n, 2).
        coupling: motor angles by joint angles, k = 0 where joints are not coupled, shape (n, k, 2).
        motor_speed: highest speeds of coupled motors to plan with [rad/s], shape (n, k).
        motor_range: ranges of coupled motors [rad], shape (n, k, 2).
        ramp_s: time over which motors spread each change of velocity [s], 0 for ideal ones.
        largest_step: largest change of velocity of each joint within a ramp [rad/s], shape (n, 2).
        movable: robots that may be moved, shape (b,).
        key: a number that depends only on a robot's place, for its random numbers, shape (n,).
        options: configurations that put a fibre on its target, fastest first [rad],
            shape (n, s, 2).
        option_count: number of options of each robot, shape (n,).
    """

    bodies: Bodies
    lever: Floats
    near: Neighbours
    pairs: Pairs
    start: Angles
    low: Angles
    high: Angles
    speed: Floats
    speed_alone: Floats
    folded_phi: Floats
    coupling: Floats
    motor_speed: Floats
    motor_range: Floats
    ramp_s: float
    largest_step: Floats
    movable: Bools
    key: NDArray[np.uint64]
    options: Floats
    option_count: Ints


def scene_of(problem: Problem, parameters: DirectParameters | None = None) -> Scene:
    """Collect what the search needs to know about a problem.

    Args:
        problem: the plane, the present joint angles and the targets.
        parameters: clearance to keep and seed; pairs that can never come as close are left out.
    """
    parameters = parameters or DirectParameters()
    plane = problem.plane
    bodies = bodies_of(plane)
    movable = np.concatenate([plane.enabled, np.zeros(plane.fixtures, dtype=bool)])
    pairs = neighbour_pairs(plane, max(1.0, _largest_gap_mm(plane, parameters))).astype(np.int64)
    pairs = pairs[movable[pairs].any(axis=1)]
    options, option_count = _options(problem)
    return Scene(
        bodies=bodies,
        lever=np.stack(
            [
                bodies.arm1,
                bodies.phi_reach + bodies.phi_radius,
                np.where(bodies.theta_count > 0, bodies.theta_reach + bodies.theta_radius, 0.0),
            ],
            axis=1,
        ),
        near=neighbours_of(len(movable), pairs, by_row=True),
        pairs=pairs,
        start=problem.start,
        low=np.ascontiguousarray(plane.limits[:, :, 0]),
        high=np.ascontiguousarray(plane.limits[:, :, 1]),
        speed=_SPEED * plane.speeds,
        speed_alone=np.minimum(_SPEED * plane.speeds, _motor_share(plane) * speeds_alone(plane)),
        folded_phi=_folded_phi(plane),
        coupling=plane.coupling,
        motor_speed=_MOTOR_SPEED * plane.motor_speeds,
        motor_range=plane.motor_limits,
        ramp_s=plane.drive.ramp_s,
        largest_step=plane.drive.largest_step_rad_s,
        movable=movable,
        key=place_keys(plane, parameters.seed),
        options=options,
        option_count=option_count,
    )


def allowances_mm(scene: Scene, parameters: DirectParameters) -> Gaps:
    """Return the gap to plan with beyond the one that safety requires of each pair [mm], (p,).

    A body that never moves is where it is: it uses up nothing by discretization and rounding, and
    a way past it is often no wider than the margin.

    Args:
        scene: the robots and their surroundings.
        parameters: clearance to keep.
    """
    both_move = scene.movable[scene.pairs].all(axis=1)
    return parameters.allowance_mm * np.where(both_move, 1.0, _BESIDE_STATIC)


def _largest_gap_mm(plane: FocalPlane, parameters: DirectParameters) -> float:
    # that pairs must keep in the longest motion: its arms also fold and unfold
    longest_s = (parameters.stretch + 2.0) * longest_move_s(plane)[plane.enabled].max(initial=0.0)
    return parameters.safety.at_full_speed_mm(plane, float(longest_s))


def _motor_share(plane: FocalPlane) -> float:
    return _MOTOR_SPEED if plane.coupling.shape[1] else _SPEED


def _folded_phi(plane: FocalPlane) -> Floats:
    # -180 and +180 degrees, each moved into the limits; less than _FOLDED_RAD is not folded
    low, high = plane.limits[:, 1].T
    either = np.stack([np.clip(-np.pi, low, high), np.clip(np.pi, low, high)], axis=1)
    flat = np.abs(either) < _FOLDED_RAD
    best = np.take_along_axis(either, np.abs(either).argmax(axis=1)[:, None], axis=1)
    return np.where(flat, best, either)


def _options(problem: Problem) -> tuple[Floats, Ints]:
    # Configurations on the target, fastest first. A robot that is on its target already has
    # its start as the only one.
    plane = problem.plane
    angles, valid = kinematics.inverse(plane, problem.targets)
    valid &= plane.enabled[:, None]
    start = problem.start[:, None]
    angles = np.where(np.abs(angles - start) <= _SAME_RAD, start, angles)
    time = alone_s(plane, problem.start, angles)
    order = np.argsort(np.where(valid, time, np.inf), axis=1, kind="stable")[:, :_MOST_OPTIONS]
    options = np.take_along_axis(angles, order[:, :, None], axis=1)
    count = np.minimum(valid.sum(axis=1), _MOST_OPTIONS)
    error_mm = kinematics.on_target(plane, problem.start, problem.targets).error_mm
    on_target = (count > 0) & (error_mm <= _ON_TARGET_MM)
    options[on_target, 0] = problem.start[on_target]
    count[on_target] = 1
    options[count == 0, 0] = problem.start[count == 0]
    return np.ascontiguousarray(options), count
