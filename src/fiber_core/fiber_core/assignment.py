# SPDX-License-Identifier: Apache-2.0
"""Assignments: which targets a focal plane accepts, and why it refuses the others."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from fiber_core import kinematics
from fiber_core.array_types import Angles, Codes, Floats, Ids, Mask, Pairs, Points, Rows
from fiber_core.clearance import Safety, gaps, neighbour_pairs
from fiber_core.errors import TargetsError
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Reason, holds
from fiber_core.validation import frozen_array

__all__ = ["Assignment", "assign"]

_NAMED = 10  # most robots that a message names
_ROUNDING_MM = 1e-9  # targets exactly at the spacing are allowed, whatever the last digit is
_ENCODER_RAD = 1e-5  # an encoder may read this far beyond a stop


@dataclass(frozen=True, eq=False)
class Assignment:
    """The targets of a plan: which are accepted, and why the others are refused.

    Args:
        plane: the focal plane.
        asked_mm: the targets as given [mm], shape (n, 2), nan = no target.
        reason: OK, NO_TARGET, or why the target is refused (Reason), shape (n,).
        blocker: for TARGET_TOO_CLOSE the row of the robot with the other target, for
            TARGET_ON_OBSTACLE the row of the robot, or n + obstacle, that is in the way;
            else -1, shape (n,).
        spacing_mm: least distance between two accepted targets [mm], 0 for any.
    """

    plane: FocalPlane
    asked_mm: Points
    reason: Codes
    blocker: Rows
    spacing_mm: float

    @property
    def accepted(self) -> Mask:
        """Robots with an accepted target, shape (n,)."""
        return self.reason == Reason.OK

    @property
    def refused(self) -> Mask:
        """Robots with a refused target, shape (n,)."""
        return holds(self.reason)

    @property
    def refused_ids(self) -> Ids:
        """Ids of the robots with a refused target, shape (k,)."""
        return self.plane.ids[self.refused]

    @property
    def targets(self) -> Points:
        """The accepted targets [mm], shape (n, 2), nan without a target or where it is refused."""
        return np.where(self.accepted[:, None], self.asked_mm, np.nan)

    def explain(self, robot: int) -> str:
        """Return a sentence that says whether the target of a robot is accepted, and why not.

        Args:
            robot: id of the robot.
        """
        row = int(self.plane.index_of(robot))
        if row < 0:
            return f"robot {robot} does not exist"
        x, y = self.asked_mm[row]
        reason = Reason(self.reason[row])
        if reason == Reason.NO_TARGET:
            return f"robot {robot}: no target"
        return f"robot {robot}: target ({x:.4g}, {y:.4g}) mm {self._because(row, reason)}"

    def _because(self, row: int, reason: Reason) -> str:
        nearest, farthest = (ends[row] for ends in kinematics.distance_range(self.plane))
        distance = np.hypot(*(self.asked_mm[row] - self.plane.centers[row]))
        reach = f"reach {nearest:.4g}..{farthest:.4g} mm"
        limits = np.rad2deg(self.plane.limits[row])
        ranges = "theta {:.4g}..{:.4g}, phi {:.4g}..{:.4g} deg".format(*limits.ravel())
        match reason:
            case Reason.UNREACHABLE:
                return f"is {distance:.4g} mm from its centre, {reach}"
            case Reason.OUTSIDE_JOINT_RANGE:
                return f"needs angles outside {ranges}"
            case Reason.DISABLED:
                return "refused, the robot is disabled"
            case Reason.START_OUTSIDE_LIMITS:
                return f"refused, the robot stands outside {ranges}"
            case Reason.TARGET_TOO_CLOSE:
                other = self.blocker[row]
                apart = np.hypot(*(self.asked_mm[row] - self.asked_mm[other]))
                return (
                    f"is {apart:.4g} mm from the target of robot {self.plane.ids[other]}, "
                    f"spacing {self.spacing_mm:.4g} mm"
                )
            case Reason.TARGET_ON_OBSTACLE:
                other = int(self.blocker[row])
                fixed = "" if other >= self.plane.n else ", which cannot move,"
                return f"cannot be reached: {self.plane.name_of(other)}{fixed} is in the way"
            case _:
                return "accepted"


def assign(
    plane: FocalPlane,
    start: ArrayLike,
    ids: ArrayLike,
    xy_mm: ArrayLike,
    pairs: ArrayLike | None = None,
    margin_mm: float | None = None,
    spacing_mm: float | None = None,
) -> Assignment:
    """Check targets against the focal plane; refuse the impossible ones robot by robot.

    Of two targets closer than the spacing, the robot with the lower id keeps
    its target. A robot cannot move if it is disabled or starts outside its joint limits. A
    target is refused if every configuration that reaches it comes within the margin of such
    a robot or of an obstacle. A refused target gets the first reason that applies, in the
    order DISABLED, START_OUTSIDE_LIMITS, UNREACHABLE, OUTSIDE_JOINT_RANGE,
    TARGET_ON_OBSTACLE, TARGET_TOO_CLOSE.

    Args:
        plane: the focal plane.
        start: present joint angles [rad], shape (n, 2).
        ids: ids of the robots with a target, shape (k,).
        xy_mm: their targets [mm], shape (k, 2).
        pairs: neighbour pairs of the plane, shape (p, 2); by default they are computed.
        margin_mm: gap to robots and obstacles that cannot move [mm]; by default the margin
            of Safety.
        spacing_mm: least distance between two targets [mm]; by default that of the plane,
            which is 0 (any distance) unless a layout or a planner asks for more.

    Raises:
        TargetsError: shapes do not fit, an id is unknown or given twice, or a value is
            not finite; names the robots and values.
    """
    rows, asked = _checked(plane, ids, xy_mm)
    start = frozen_array(start, np.float64, (plane.n, 2), "start", TargetsError)
    _refuse(
        ~np.all(np.isfinite(start), axis=1), plane.ids, start, Reason.NOT_FINITE, "start angles"
    )
    margin_mm = Safety().margin_mm if margin_mm is None else margin_mm
    spacing_mm = plane.spacing_mm if spacing_mm is None else spacing_mm

    low, high = np.moveaxis(plane.limits, -1, 0)
    outside = ((start < low - _ENCODER_RAD) | (start > high + _ENCODER_RAD)).any(axis=1)
    stuck = ~plane.enabled | outside
    solutions = kinematics.solutions(plane.with_fixed_joints_at(start), asked)
    distance = np.hypot(*(asked - plane.centers).T)
    nearest, farthest = kinematics.distance_range(plane)
    rim = kinematics.RIM_MM

    reason = np.full(plane.n, Reason.NO_TARGET, dtype=np.int64)
    reason[rows] = Reason.OK
    for code, applies in (
        (Reason.DISABLED, ~plane.enabled),
        (Reason.START_OUTSIDE_LIMITS, outside),
        (Reason.UNREACHABLE, (distance > farthest + rim) | (distance < nearest - rim)),
        (Reason.OUTSIDE_JOINT_RANGE, ~solutions.valid.any(axis=1)),
    ):
        reason[(reason == Reason.OK) & applies] = code
    blocker = np.full(plane.n, -1)
    pairs = neighbour_pairs(plane, max(1.0, margin_mm)) if pairs is None else np.asarray(pairs)
    _refuse_blocked(plane, start, stuck, solutions, pairs, margin_mm, reason, blocker)
    _refuse_close(spacing_mm, asked, reason, blocker)
    for value in (asked, reason, blocker):
        value.setflags(write=False)
    return Assignment(plane, asked, reason, blocker, spacing_mm)


def _checked(plane: FocalPlane, ids: ArrayLike, xy_mm: ArrayLike) -> tuple[Rows, Points]:
    # rows of the robots with a target, and the targets of all robots, nan for those without
    ids = frozen_array(ids, np.int64, (None,), "ids", TargetsError)
    xy_mm = frozen_array(xy_mm, np.float64, (len(ids), 2), "targets", TargetsError)
    rows = plane.index_of(ids)
    _refuse(rows < 0, ids, xy_mm, Reason.UNKNOWN_ROBOT, "no such robot, target")
    _, first, count = np.unique(ids, return_index=True, return_counts=True)
    repeated = np.ones(len(ids), dtype=np.bool_)
    repeated[first[count == 1]] = False
    _refuse(repeated, ids, xy_mm, Reason.DUPLICATE, "has more than one target, target")
    _refuse(~np.all(np.isfinite(xy_mm), axis=1), ids, xy_mm, Reason.NOT_FINITE, "target not finite")
    asked = np.full((plane.n, 2), np.nan)
    asked[rows] = xy_mm
    return rows, asked


def _refuse(bad: Mask, ids: Ids, values: Floats, reason: Reason, what: str) -> None:
    # raises if a robot is bad; names the first of them
    at = np.flatnonzero(bad)
    if len(at):
        named = "; ".join(f"robot {ids[i]}: {what} {values[i].tolist()}" for i in at[:_NAMED])
        more = f"; and {len(at) - _NAMED} more" if len(at) > _NAMED else ""
        raise TargetsError(named + more, ids[at], np.full(len(at), reason))


def _refuse_blocked(
    plane: FocalPlane,
    start: Angles,
    stuck: Mask,
    solutions: kinematics.Solutions,
    pairs: Pairs,
    margin_mm: float,
    reason: Codes,
    blocker: Rows,
) -> None:
    # Turns of a joint do not change the outlines: one configuration represents each elbow of each
    # fibre.
    # stuck: robots that cannot move; reason and blocker are filled in.
    fixed = np.concatenate([stuck, np.ones(plane.fixtures, dtype=np.bool_)])
    a, b = pairs.astype(np.int64).reshape(-1, 2).T
    facing = np.concatenate([np.stack([a, b], axis=1), np.stack([b, a], axis=1)])
    facing = facing[fixed[facing[:, 1]] & (facing[:, 0] < plane.n)]
    facing = facing[reason[facing[:, 0]] == Reason.OK]
    blocked = np.ones(plane.n, dtype=np.bool_)
    valid, is_left = solutions.valid, solutions.is_left
    for fibre, side in product(range(plane.fibre_offsets.shape[1]), (is_left, ~is_left)):
        elbow = valid & side & (solutions.fibre == fibre)
        has: Mask = np.any(elbow, axis=1)
        chosen = solutions.angles[np.arange(plane.n), elbow.argmax(axis=1)]
        gap = gaps(
            plane, np.sort(facing, axis=1), np.where(has[:, None] & ~stuck[:, None], chosen, start)
        )
        touched = np.zeros(plane.n, dtype=np.bool_)
        near = facing[gap < margin_mm]
        touched[near[:, 0]] = True
        blocker[near[::-1, 0]] = near[::-1, 1]
        blocked &= touched | ~has
    blocked &= reason == Reason.OK
    reason[blocked] = Reason.TARGET_ON_OBSTACLE
    blocker[~blocked] = -1


def _refuse_close(spacing_mm: float, asked: Points, reason: Codes, blocker: Rows) -> None:
    # reason and blocker are filled in
    left = np.flatnonzero(reason == Reason.OK)
    pairs = left[cKDTree(asked[left]).query_pairs(spacing_mm, output_type="ndarray")]
    low, high = np.sort(pairs, axis=1).T
    apart = np.hypot(*(asked[low] - asked[high]).T)
    low, high = (side[apart < spacing_mm - _ROUNDING_MM] for side in (low, high))
    order = np.lexsort([low, high])  # a robot is decided after all robots of lower rows
    for first, second in zip(low[order], high[order]):
        if reason[first] == Reason.OK and reason[second] == Reason.OK:
            reason[second], blocker[second] = Reason.TARGET_TOO_CLOSE, first
