# SPDX-License-Identifier: Apache-2.0
"""Make a motion safe by holding a few robots where they are."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Mask, Rows
from fiber_core.clearance.certificate import (
    Certificate,
    certificate_of,
    certified_pairs,
    fixed_pairs,
    limits_broken,
    moved_disabled,
    orders_refused,
    out_of_bounds,
)
from fiber_core.clearance.collision_bodies import bodies_of
from fiber_core.clearance.minimum_distance import Minima, minimum_gaps
from fiber_core.clearance.neighbours import neighbours_of
from fiber_core.clearance.safety import Safety
from fiber_core.drive.curves import CurveMotion, carried_out
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion

__all__ = ["hold_until_safe"]


def hold_until_safe(
    plane: FocalPlane,
    motion: SegmentMotion,
    safety: Safety,
    pairs: ArrayLike | None = None,
    tolerance_mm: float = 0.5e-3,
) -> tuple[SegmentMotion, Mask, Certificate]:
    """Hold as few robots as a greedy choice finds, so that the rest of a motion is certified.

    A held robot rests at its start for the whole motion. Robots that break a limit, have orders
    that their motors or supplies do not allow, or move although disabled are held first. Then, as
    long as pairs are unsafe, the moving robot with the most unsafe pairs is held, the lowest row
    among equals, until every unsafe pair has a held robot; the pairs of held robots are certified
    again. At the end, held robots are released in order if their own pairs stay safe, until no more
    can be released. Two resting robots that are too close stay so: the certificate shows it.

    Args:
        plane: the focal plane.
        motion: joint profiles of all robots, as ordered; their true curves are certified.
        safety: the margin and the timing errors that the motion must survive.
        pairs: rows a < b to examine, shape (p, 2), as for certify.
        tolerance_mm: resolution of the gaps below their required value [mm].

    Returns:
        The motion that remains, which robots were held, shape (n,), and the certificate of
        the motion that remains.
    """
    true_motion = carried_out(plane.drive, motion)
    wild = out_of_bounds(true_motion)
    if wild.any():
        rest, held, certificate = hold_until_safe(
            plane, motion.without(wild), safety, pairs, tolerance_mm
        )
        return rest, held | wild, certificate
    if pairs is None:
        pairs = certified_pairs(plane, true_motion, safety)
    search = _Search(plane, true_motion, safety, pairs, tolerance_mm)
    faulty = limits_broken(plane, true_motion) | moved_disabled(plane, true_motion)
    faulty |= orders_refused(plane, motion, true_motion)
    search.hold(faulty)
    search.hold_until_covered()
    if not (search.unsafe & ~fixed_pairs(plane, search.pairs)).any():
        candidates = ~faulty
        while candidates.any():
            candidates = search.release(candidates) & ~faulty
        search.hold_until_covered()  # released robots may have made the whole motion longer
    return motion.without(search.held), search.held, search.certificate()


class _Search:
    # A motion with some robots held, and the bounds of the gaps of its pairs.

    def __init__(
        self,
        plane: FocalPlane,
        motion: SegmentMotion | CurveMotion,
        safety: Safety,
        pairs: ArrayLike,
        tolerance_mm: float,
    ):
        self.plane, self.wished, self.safety = plane, motion, safety
        self.tolerance_mm = tolerance_mm
        self.pairs = np.array(pairs, dtype=np.int32).reshape(-1, 2)
        self.bodies, self.neighbours = bodies_of(plane), neighbours_of(plane.n, self.pairs)
        self.held: Mask = np.zeros(plane.n, dtype=np.bool_)
        self.minima = Minima.unknown(len(self.pairs))
        self.update()

    @property
    def motion(self) -> SegmentMotion | CurveMotion:
        return self.wished.without(self.held)

    def update(self) -> None:
        # The required gaps change with the makespan, so with every robot held or released.
        # A pair is examined only if a gap that low was not found and is not excluded.
        self.required = self.safety.required_mm(self.plane, self.motion, self.pairs)
        lower, best, _ = self.minima
        self.prove(np.flatnonzero((lower < self.required) & (best >= self.required)))
        self.unsafe = lower < self.required

    def prove(self, rows: Rows) -> None:
        # improve the bounds of some pairs until each is proven safe or found unsafe
        minimum_gaps(
            self.bodies,
            self.wished.curve_arrays,
            self.held,
            self.pairs,
            rows,
            self.required,
            self.tolerance_mm,
            False,
            self.minima,
        )

    def hold(self, robots: Mask) -> None:
        # the robots, shape (n,), rest from now on; nothing is known about their pairs
        self.held |= robots
        touched = self._of_bodies(robots)[self.pairs].any(axis=1)
        self.minima.lower[touched], self.minima.best[touched] = -np.inf, np.inf
        self.update()

    def hold_until_covered(self) -> None:
        while (chosen := self._cover()).any():
            self.hold(chosen)

    def _cover(self) -> Mask:
        # greedy vertex cover of the unsafe pairs by robots that move
        movable = self._of_bodies(self.wished.fastest.any(axis=1) & ~self.held)
        chosen = np.zeros(self.plane.n, dtype=np.bool_)
        uncovered = self.pairs[self.unsafe & movable[self.pairs].any(axis=1)]
        while len(uncovered):
            times = np.bincount(uncovered.ravel(), minlength=len(movable))
            most = np.argmax(times * movable)
            chosen[most] = True
            uncovered = uncovered[(uncovered != most).all(axis=1)]
        return chosen

    def release(self, allowed: Mask) -> Mask:
        # Release the allowed robots with pairs that stay safe; return the neighbours of the
        # released robots.
        held_before = self.held.copy()
        # No motion with robots held requires larger gaps than the wished motion.
        self.required = self.safety.required_mm(self.plane, self.wished, self.pairs)
        near = self.neighbours
        for robot in np.flatnonzero(self.held & allowed).tolist():
            own = near.pair[near.parts.slice(robot)]
            before = [column[own] for column in self.minima]
            self.held[robot] = False
            self.prove(own)
            if (self.minima.lower[own] >= self.required[own]).all():
                continue
            self.held[robot] = True
            for column, known in zip(self.minima, before):
                column[own] = known
        self.update()
        released = self._of_bodies(held_before & ~self.held)
        neighbours = np.zeros(len(released), dtype=np.bool_)
        neighbours[self.pairs[released[self.pairs].any(axis=1)]] = True
        return neighbours[: self.plane.n]

    def _of_bodies(self, robots: Mask) -> Mask:
        # the same of robots and obstacles; obstacles are never meant
        return np.append(robots, np.zeros(self.plane.fixtures, dtype=bool))

    def certificate(self) -> Certificate:
        return certificate_of(
            self.plane,
            self.motion,
            self.pairs,
            self.required,
            self.minima,
            self.tolerance_mm,
        )
