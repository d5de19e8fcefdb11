# SPDX-License-Identifier: Apache-2.0
"""Certificates: the proof that a motion keeps gaps, limits and speeds in continuous time."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Floats, Gaps, Mask, Pairs, Rows, Times
from fiber_core.bounds import MAX_ANGLE_RAD, MAX_SPEED_RAD_S
from fiber_core.clearance.collision_bodies import Bodies, bodies_of
from fiber_core.clearance.distance import gaps
from fiber_core.clearance.minimum_distance import FINEST_MM, Minima, minimum_gaps
from fiber_core.clearance.neighbours import neighbour_pairs
from fiber_core.clearance.safety import Safety
from fiber_core.drive.curves import CurveMotion, carried_out
from fiber_core.drive.drive import Drive
from fiber_core.drive.power import overloading
from fiber_core.drive.rules import rules_broken
from fiber_core.errors import MotionError
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_core.motors import motors_broken

__all__ = ["Certificate", "certified_pairs", "certify", "certify_arms", "smallest_gaps", "unproven"]

_TOLERANCE_MM = 0.5e-3
_AT_REQUIRED_MM = 2e-3  # above the gap required: resolved, and that of a pair that leaves


@dataclass(frozen=True, eq=False)
class Certificate:
    """The properties of a motion that are proven at every instant from its start to its end.

    Args:
        pairs: the pairs examined, rows as from neighbour_pairs, shape (p, 2).
        required_mm: gap each pair must keep [mm], shape (p,).
        gap_mm: lower bound of the smallest gap of each pair [mm], shape (p,); within the
            tolerance of that gap where it is below the required gap or the smallest of all.
        time_s: instant of the smallest gap found of each pair [s], shape (p,).
        unsafe: pairs not proven to keep their required gap, shape (p,), without those of
            close_at_rest.
        limits_broken: robots that move a joint or a coupled motor outside its limits or faster than
            it can, or a joint harder than it can, shape (n,).
        moved_disabled: disabled robots that move, shape (n,).
        close_at_rest: pairs nearer than their required gap, but apart, of bodies that may not
            move: disabled robots at rest, obstacles and walls, shape (p,). They are a fact of the
            plane that no motion can mend.
    """

    pairs: Pairs
    required_mm: Gaps
    gap_mm: Gaps
    time_s: Times
    unsafe: Mask
    limits_broken: Mask
    moved_disabled: Mask
    close_at_rest: Mask

    def __post_init__(self):
        for name, value in list(vars(self).items()):
            array = np.array(value)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def ok(self) -> bool:
        """Whether the motion may be carried out."""
        return not (self.unsafe.any() or self.limits_broken.any() or self.moved_disabled.any())

    @property
    def unsafe_robots(self) -> Mask:
        """Robots in an unsafe pair, shape (n,)."""
        return self._robots_in(self.unsafe)

    @property
    def close_at_rest_robots(self) -> Mask:
        """Disabled robots in a pair of close_at_rest, shape (n,)."""
        return self._robots_in(self.close_at_rest)

    def _robots_in(self, which: Mask) -> Mask:
        n = len(self.limits_broken)
        rows = self.pairs[which].ravel()
        found = np.zeros(n, dtype=bool)
        found[rows[rows < n]] = True
        return found

    @property
    def min_gap_mm(self) -> float:
        """Smallest gap of all pairs [mm], a lower bound within the tolerance; inf without pairs.

        Also of pairs that are too close from the start: `nearer` tells them.
        """
        return float(self.gap_mm.min(initial=np.inf))

    def nearer(self, plane: FocalPlane, start_rad: ArrayLike, margin_mm: float) -> Mask:
        """Return the pairs that are nearer than the margin and were so at the start, shape (p,).

        Both rest, or one leaves the other (decision 8): what the motion keeps apart are the others.

        Args:
            plane: the focal plane.
            start_rad: joint angles at the start [rad], shape (n, 2).
            margin_mm: the margin.
        """
        found = self.gap_mm < margin_mm
        found[found] = gaps(plane, self.pairs[found], start_rad) < margin_mm
        return found

    @property
    def min_pair(self) -> tuple[int, ...]:
        """Rows a, b of the pair with the smallest gap; empty without pairs."""
        return tuple(self.pairs[np.argmin(self.gap_mm)].tolist()) if len(self.pairs) else ()

    @property
    def min_time_s(self) -> float:
        """Instant of the smallest gap [s]; nan without pairs."""
        return float(self.time_s[np.argmin(self.gap_mm)]) if len(self.pairs) else float("nan")


def certify(
    plane: FocalPlane,
    motion: SegmentMotion,
    safety: Safety,
    pairs: ArrayLike | None = None,
    tolerance_mm: float = _TOLERANCE_MM,
) -> Certificate:
    """Prove, in continuous time, that a motion keeps every pair of outlines apart.

    The gap of a pair cannot change faster than the sum of the speeds of its fastest
    points, so gaps at finitely many instants bound it at all of them. Rest after the
    end of a profile is part of the motion. Joints follow the curve that the drive of the plane
    makes of their orders, within its uncertainty.

    Args:
        plane: the focal plane.
        motion: joint profiles of all robots, as ordered.
        safety: the margin and the timing errors that the motion must survive.
        pairs: rows a < b to examine, shape (p, 2); by default all pairs that could ever
            come closer than the largest required gap (at least 1 mm).
        tolerance_mm: resolution of the gaps below their required value and of the smallest
            of all, at least 1e-6 [mm].

    Raises:
        MotionError: a robot turns further or faster than any robot can (fiber_core.bounds), which
            would take for ever to examine; names the robot and the value.
    """
    true_motion = carried_out(plane.drive, motion)
    certificate = _judged(plane, true_motion, safety, pairs, tolerance_mm)
    refused = orders_refused(plane, motion, true_motion)
    return replace(certificate, limits_broken=certificate.limits_broken | refused)


def _judged(
    plane: FocalPlane,
    true_motion: SegmentMotion | CurveMotion,
    safety: Safety,
    pairs: ArrayLike | None,
    tolerance_mm: float,
) -> Certificate:
    wild = out_of_bounds(true_motion)
    if wild.any():
        row = int(np.argmax(wild))
        angle = float(np.abs([true_motion.lowest[row], true_motion.highest[row]]).max())
        raise MotionError(
            f"robot {plane.ids[row]} turns to {angle:g} rad at up to "
            f"{true_motion.fastest[row].max():g} rad/s: the bounds are {MAX_ANGLE_RAD:g} rad and "
            f"{MAX_SPEED_RAD_S:g} rad/s"
        )
    if pairs is None:
        pairs = certified_pairs(plane, true_motion, safety)
    pairs = np.array(pairs, dtype=np.int32).reshape(-1, 2)
    bodies = bodies_of(plane)
    required = safety.required_mm(plane, true_motion, pairs)
    minima = Minima.unknown(len(pairs))
    every = np.arange(len(pairs))
    minimum_gaps(
        bodies, true_motion.curve_arrays, np.zeros(true_motion.n, dtype=bool), pairs, every,
        required, tolerance_mm, True, minima,
    )  # fmt: skip
    return certificate_of(plane, true_motion, pairs, required, minima, tolerance_mm)


def certify_arms(
    plane: FocalPlane, motion: SegmentMotion | CurveMotion, safety: Safety, pairs: ArrayLike
) -> Certificate:
    """Return the certificate of a motion that the arms have made, and not of one that is ordered.

    The drive of the plane is not applied: nothing is delayed by a ramp, and no angle is uncertain.

    Args:
        plane: the focal plane.
        motion: true joint profiles of all robots.
        safety: the margin and the timing errors.
        pairs: rows a < b to examine, shape (p, 2).
    """
    exact = replace(plane, drive=Drive(plane.n))
    return _judged(exact, motion, safety, pairs, _TOLERANCE_MM)


def unproven(
    bodies: Bodies,
    motion: SegmentMotion | CurveMotion,
    pairs: ArrayLike,
    required_mm: ArrayLike,
) -> Mask:
    """Return which pairs are not proven to keep their gap at every instant, shape (p,).

    A certificate without figures: the search on a pair ends as soon as it is decided.

    Args:
        bodies: outlines, from bodies_of.
        motion: true joint profiles of all robots; no drive is applied to them.
        pairs: rows a, b of bodies, shape (p, 2).
        required_mm: gap that each pair must keep [mm], shape (p,).
    """
    required = np.asarray(required_mm, dtype=float)
    return _lower_bounds(bodies, motion, pairs, required, False) < required


def smallest_gaps(
    bodies: Bodies, motion: SegmentMotion | CurveMotion, pairs: ArrayLike, level_mm: ArrayLike
) -> Gaps:
    """Return a lower bound of the smallest gap of each pair in a motion [mm], shape (p,).

    It is within half a micrometre of that gap where the gap is below the level.

    Args:
        bodies: outlines, from bodies_of.
        motion: true joint profiles of all robots; no drive is applied to them.
        pairs: rows a, b of bodies, shape (p, 2).
        level_mm: gap of each pair above which no better bound is needed [mm], shape (p,).
    """
    return _lower_bounds(bodies, motion, pairs, np.asarray(level_mm, dtype=float), True)


def _lower_bounds(
    bodies: Bodies,
    motion: SegmentMotion | CurveMotion,
    pairs: ArrayLike,
    level: Floats,
    resolve: bool,
) -> Gaps:
    pairs = np.asarray(pairs, dtype=np.int32).reshape(-1, 2)
    minima, rows = Minima.unknown(len(pairs)), np.arange(len(pairs))
    minimum_gaps(
        bodies, motion.curve_arrays, np.zeros(motion.n, dtype=bool), pairs, rows,
        level, _TOLERANCE_MM, resolve, minima,
    )  # fmt: skip
    return minima.lower


def out_of_bounds(motion: SegmentMotion | CurveMotion) -> Mask:
    """Return the robots that move, further or faster than any robot can, shape (n,)."""
    furthest = np.maximum(np.abs(motion.lowest), np.abs(motion.highest))
    beyond = (furthest > MAX_ANGLE_RAD) | (motion.fastest > MAX_SPEED_RAD_S)
    return motion.moves & np.any(beyond, axis=1)


def certified_pairs(
    plane: FocalPlane, motion: SegmentMotion | CurveMotion, safety: Safety
) -> Pairs:
    """Return every pair that must be examined to certify a motion, shape (p, 2)."""
    with_itself = np.repeat(np.arange(plane.n)[:, None], 2, axis=1)
    most = safety.anywhere(plane).required_mm(plane, motion, with_itself).max(initial=0.0)
    return neighbour_pairs(plane, max(1.0, most))


def certificate_of(
    plane: FocalPlane,
    motion: SegmentMotion | CurveMotion,
    pairs: Pairs,
    required: Gaps,
    minima: Minima,
    tolerance_mm: float,
) -> Certificate:
    """Return the certificate of a motion, after the smallest gap of the plane is resolved.

    Args:
        plane: the focal plane.
        motion: true joint profiles of all robots.
        pairs: rows a, b of bodies, shape (p, 2).
        required: gap that each pair must keep [mm], shape (p,).
        minima: the smallest gaps as far as they are known; updated.
        tolerance_mm: resolution of the smallest gap [mm].
    """
    bodies = bodies_of(plane)
    _resolve_smallest(bodies, motion, pairs, required, minima, tolerance_mm)
    # the smallest gap may be that of a pair which started too close: of the others too
    others = np.flatnonzero(minima.best > required + _AT_REQUIRED_MM)
    if len(others) < len(pairs):
        _resolve_smallest(bodies, motion, pairs, required, minima, tolerance_mm, others)
    below = minima.lower < required
    fixed = below & fixed_pairs(plane, pairs) & (minima.lower > 0.0)
    fixed &= ~_with_fixtures(plane, motion.moves)[pairs].any(axis=1)
    return Certificate(
        pairs=pairs,
        required_mm=required,
        gap_mm=minima.lower,
        time_s=minima.time_s,
        unsafe=below & ~fixed,
        limits_broken=limits_broken(plane, motion),
        moved_disabled=moved_disabled(plane, motion),
        close_at_rest=fixed,
    )


def fixed_pairs(plane: FocalPlane, pairs: Pairs) -> Mask:
    """Return the pairs of bodies that may not move: disabled robots and fixtures, shape (p,)."""
    fixed: Mask = np.all(~_with_fixtures(plane, plane.enabled)[pairs], axis=1)
    return fixed


def _with_fixtures(plane: FocalPlane, robots: Mask) -> Mask:
    # a mask of bodies from one of robots; obstacles and walls are not in it
    return np.append(robots, np.zeros(plane.fixtures, dtype=bool))


def limits_broken(plane: FocalPlane, motion: SegmentMotion | CurveMotion) -> Mask:
    """Return the robots that move a joint or motor outside its limits, too fast or too hard."""
    low, high = np.moveaxis(plane.limits, -1, 0)
    outside = (motion.lowest < low - 1e-9) | (motion.highest > high + 1e-9)
    too_fast = motion.fastest > plane.speeds * (1 + 1e-9)
    too_hard = motion.hardest > plane.drive.acceleration_rad_s2 * (1 + 1e-9)
    of_joints: Mask = np.any((motion.fastest > 0.0) & outside | too_fast | too_hard, axis=1)
    return of_joints | motors_broken(plane, motion)


def orders_refused(
    plane: FocalPlane, motion: SegmentMotion, true_motion: SegmentMotion | CurveMotion
) -> Mask:
    """Return the robots with orders that their motors or power supplies do not allow, (n,).

    Args:
        plane: the focal plane.
        motion: joint profiles of all robots, as ordered.
        true_motion: the curves that its drive makes of them.
    """
    refused = rules_broken(plane.drive, motion).robots(plane.n)
    if plane.drive.motors_on < 1.0:
        kept = true_motion.without(refused)
        refused = refused | overloading(kept, plane.supply, plane.drive.motors_on)
    return refused


def moved_disabled(plane: FocalPlane, motion: SegmentMotion | CurveMotion) -> Mask:
    """Return the disabled robots that move, shape (n,)."""
    return ~plane.enabled & (motion.fastest > 0.0).any(axis=1)


def _resolve_smallest(
    bodies: Bodies,
    motion: SegmentMotion | CurveMotion,
    pairs: Pairs,
    required: Gaps,
    minima: Minima,
    tolerance_mm: float,
    among: Rows | None = None,
) -> None:
    resting = np.zeros(motion.n, dtype=bool)
    tolerance_mm = max(tolerance_mm, FINEST_MM)
    rows: Rows = np.arange(len(pairs)) if among is None else among
    smallest = minima.best[rows].min(initial=np.inf)
    level = required.copy()
    while True:
        # A pair can only have the smallest gap if its lower bound is not clear of the smallest
        # gap found; as that only falls, a pair once clear stays clear.
        level[rows] = np.maximum(required[rows], smallest + tolerance_mm)
        unclear = np.minimum(level[rows], minima.best[rows] - 2 * tolerance_mm)
        rows = rows[minima.lower[rows] < unclear]
        if len(rows) == 0:
            return
        nearest = rows[np.argmin(minima.best[rows])]
        only = np.array([nearest])
        minimum_gaps(
            bodies, motion.curve_arrays, resting, pairs, only, level, tolerance_mm, True, minima
        )
        smallest = min(smallest, minima.best[nearest])
