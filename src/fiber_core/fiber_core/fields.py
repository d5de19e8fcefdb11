# SPDX-License-Identifier: Apache-2.0
"""Random fields: a start and targets that all robots can take at the same time."""

import math
from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from fiber_core import kinematics
from fiber_core.array_types import Angles, Bools, Floats, Mask, Rows
from fiber_core.clearance import (
    Bodies,
    Neighbours,
    Safety,
    bodies_of,
    neighbour_pairs,
    neighbours_of,
    pair_gap_below,
)
from fiber_core.errors import FieldError
from fiber_core.fibres import ANY_FIBRE
from fiber_core.focal_plane import FocalPlane
from fiber_core.problem import Problem
from fiber_core.validation import frozen_array

__all__ = ["Field", "random_field", "random_problem"]

_OVER_MARGIN_MM = 0.1
_LONG_S = 30.0  # of motions with listed speeds; clocks differ by 3 ms then
_ALLOWANCE_MM = 0.02  # for the rounding of starts and goals
_TRIES = 20  # draws after which a robot takes the place of the robots in its way
_NAMED = 10  # most robots that a message names
_DRAWS_PER_ROBOT = 2000  # on average, before a field counts as impossible
_REDRAWS = 10_000  # points in the patrol region, until one lies inside the joint ranges


@dataclass(frozen=True, eq=False)
class Field:
    """A random problem and joint angles that solve it.

    Args:
        problem: the problem.
        goal: joint angles that put every fibre on its target, outlines apart [rad],
            shape (n, 2); the start angles of robots without a target.
    """

    problem: Problem
    goal: Angles


def random_field(
    plane: FocalPlane,
    rng: np.random.Generator,
    gap_mm: float | None = None,
    asked: ArrayLike | None = None,
    start: ArrayLike | None = None,
) -> Field:
    """Draw start and target configurations in which no outlines come close.

    Tips are drawn uniformly over the patrol region, then one of their configurations: each
    elbow and turn inside the joint ranges is equally likely. Only robots in conflict are drawn
    again: after some tries a robot takes its place, and the robots in its way lose theirs.
    Disabled robots start at such a place and stay there, as do robots without a target.
    On a plane with fibres each target is for a random one of those that it may have.

    Args:
        plane: the focal plane.
        rng: source of randomness; the same state gives the same field.
        gap_mm: gap between outlines at start and goal [mm]; by default the margin of
            Safety and 0.1 mm more, for motors with listed speeds what Safety requires of fast
            joints. Targets are also as
            far apart as spacing and envelope of the plane.
        asked: robots that get a target, shape (n,); by default all. Disabled robots get none.
        start: present joint angles [rad], shape (n, 2); by default they are drawn.

    Raises:
        FieldError: some robots could not be placed, or the start is not finite; names them.
    """
    gap_mm = _gap_at_ends_mm(plane) if gap_mm is None else gap_mm
    asked = np.ones(plane.n) if asked is None else asked
    asked = frozen_array(asked, np.bool_, (plane.n,), "asked", FieldError) & plane.enabled
    spacing_mm = max(plane.spacing_mm, plane.envelope_mm)
    neighbours = _neighbours(plane, max(gap_mm, spacing_mm))
    if start is None:
        moves, unplaced = np.ones(plane.n, dtype=np.bool_), np.zeros((plane.n, 2))
        start = _arrange(plane, rng, neighbours, moves, unplaced, gap_mm, 0.0, "start")
    else:
        start = frozen_array(start, np.float64, (plane.n, 2), "start", FieldError)
        not_finite = plane.ids[~np.isfinite(start).all(axis=1)]
        if len(not_finite):
            raise FieldError(f"robot {not_finite[0]}: its start is not finite", not_finite)
    goal = _arrange(plane, rng, neighbours, asked, start, gap_mm, spacing_mm, "goal")
    if plane.fibres.shape[1]:
        named = rng.integers(plane.fibres.shape[1], size=plane.n)
        plane = plane.with_fibre(np.where(plane.fibre == ANY_FIBRE, named, plane.fibre))
    places = kinematics.on_target(plane, goal, np.full((plane.n, 2), np.nan)).place
    targets = np.where(asked[:, None], places, np.nan)
    goal.setflags(write=False)
    return Field(Problem(plane, start, targets), goal)


def random_problem(
    plane: FocalPlane,
    rng: np.random.Generator,
    gap_mm: float | None = None,
    asked: ArrayLike | None = None,
    start: ArrayLike | None = None,
) -> Problem:
    """Draw a problem with targets that all robots can take at the same time.

    The arguments are those of random_field.
    """
    return random_field(plane, rng, gap_mm, asked, start).problem


def _neighbours(plane: FocalPlane, slack_mm: float) -> Neighbours:
    # the bodies that can come near each robot
    beyond = max(0.0, (plane.arms.sum(axis=1) - plane.reach_mm).max(initial=0.0))
    pairs = neighbour_pairs(plane, float(slack_mm + 2 * beyond))
    return neighbours_of(plane.n, pairs, by_row=True)


def _gap_at_ends_mm(plane: FocalPlane) -> float:
    # Motors with listed speeds run or creep: a pair must keep the gap of full speed everywhere.
    gap_mm = Safety().margin_mm + _OVER_MARGIN_MM
    if plane.drive.listed is None:
        return gap_mm
    return max(gap_mm, Safety().at_full_speed_mm(plane, _LONG_S) + _ALLOWANCE_MM)


def _arrange(
    plane: FocalPlane,
    rng: np.random.Generator,
    neighbours: Neighbours,
    moves: Mask,
    standing: Angles,
    gap_mm: float,
    spacing_mm: float,
    what: str,
) -> Angles:
    # places for the robots `moves`, all others standing where they are
    fixed = np.zeros(plane.fixtures, dtype=np.bool_)
    moves_all = np.concatenate([moves, fixed])
    angles = np.concatenate([standing, np.zeros((len(fixed), 2))])
    queue = rng.permutation(np.flatnonzero(moves))
    options = np.empty((kinematics.most_configurations(plane), 2))
    bodies, limits = bodies_of(plane), plane.limits
    left = _place_all(
        rng, bodies, limits, neighbours, moves_all, angles, queue, options, gap_mm, spacing_mm
    )
    if len(left):
        ids = np.sort(plane.ids[left])
        more = ", ..." if len(ids) > _NAMED else ""
        tips = f", with tips {spacing_mm:g} mm apart" if spacing_mm else ""
        raise FieldError(
            f"{len(ids)} of {plane.n} robots found no {what} {gap_mm:g} mm from the others{tips}: "
            f"robot {', '.join(map(str, ids[:_NAMED]))}{more}",
            ids,
        )
    return angles[: plane.n]


@nb.njit(cache=True)
def _draw(
    rng: np.random.Generator, arm1: float, arm2: float, limits: Floats, options: Angles
) -> int:
    # Draws a point uniform in the annulus, then one of its configurations: its row in
    # options, or -1 if no point has one.
    inner, outer = (arm1 - arm2) ** 2, (arm1 + arm2) ** 2
    for _ in range(_REDRAWS):
        distance = math.sqrt(inner + (outer - inner) * rng.random())
        direction = 2 * math.pi * rng.random()
        x, y = distance * math.cos(direction), distance * math.sin(direction)
        count = kinematics.configurations(arm1, arm2, x, y, limits, options)
        if count:
            return int(count * rng.random())
    return -1


@nb.njit(cache=True)
def _tip(bodies: Bodies, i: int, theta: float, phi: float) -> tuple[float, float]:
    x = bodies.arm1[i] * math.cos(theta) + bodies.arm2[i] * math.cos(theta + phi)
    y = bodies.arm1[i] * math.sin(theta) + bodies.arm2[i] * math.sin(theta + phi)
    return bodies.center[i, 0] + x, bodies.center[i, 1] + y


@nb.njit(cache=True)
def _conflicts(
    bodies: Bodies,
    moves: Bools,
    placed: Bools,
    angles: Angles,
    near: Rows,
    i: int,
    theta: float,
    phi: float,
    gap_mm: float,
    spacing_mm: float,
    enough: int,
    found: Rows,
) -> int:
    # Writes the rows in conflict with robot i at these angles, at most `enough`; returns their
    # number, or the number of all rows if one of them cannot be moved. Only robots with a
    # target keep the spacing.
    count = 0
    x, y = _tip(bodies, i, theta, phi)
    j: int
    for j in near:
        if not placed[j]:
            continue
        other_theta, other_phi = angles[j]
        crowded = False
        if moves[j] and spacing_mm > 0.0:
            other_x, other_y = _tip(bodies, j, other_theta, other_phi)
            crowded = math.hypot(x - other_x, y - other_y) < spacing_mm
        if not crowded:
            gap = pair_gap_below(bodies, i, j, theta, phi, other_theta, other_phi, gap_mm)
            crowded = gap < gap_mm
        if crowded:
            if not moves[j]:
                return len(placed)
            found[count] = j
            count += 1
            if count >= enough:
                break
    return count


@nb.njit(cache=True)
def _place_all(
    rng: np.random.Generator,
    bodies: Bodies,
    limits: Floats,
    neighbours: Neighbours,
    moves: Bools,
    angles: Angles,
    queue: Rows,
    options: Angles,
    gap_mm: float,
    spacing_mm: float,
) -> Rows:
    # Writes the angles of all robots of the queue; returns the rows that found no place.
    size, head, waiting = len(queue), 0, len(queue)
    other, offsets = neighbours.body, neighbours.offsets
    placed = ~moves
    found = np.empty(len(other), dtype=np.int64)
    leaving = np.empty(len(other), dtype=np.int64)
    budget = _DRAWS_PER_ROBOT * size + 1000 * _TRIES
    while waiting and budget > 0:
        i: int = queue[head % size]
        head += 1
        waiting -= 1
        near = other[offsets[i] : offsets[i + 1]]
        least = len(placed)
        for _ in range(_TRIES):
            budget -= 1
            pick = _draw(rng, bodies.arm1[i], bodies.arm2[i], limits[i], options)
            if pick < 0:
                return np.array([i])
            theta, phi = options[pick]
            count = _conflicts(
                bodies, moves, placed, angles, near, i, theta, phi, gap_mm, spacing_mm, least, found
            )
            if count < least:
                least = count
                angles[i, 0], angles[i, 1] = theta, phi
                found, leaving = leaving, found
            if least == 0:
                break
        if least == len(placed):
            queue[(head + waiting) % size] = i
            waiting += 1
            continue
        placed[i] = True
        for j in leaving[:least]:
            placed[j] = False
            queue[(head + waiting) % size] = j
            waiting += 1
    return np.flatnonzero(~placed)
