"""Make a motion safe by holding a few robots where they are."""

import numpy as np

from fiber_core.clearance.certificate import (
    Certificate,
    certificate_of,
    certified_pairs,
    limits_broken,
    moved_disabled,
)
from fiber_core.clearance.collision_bodies import bodies_of
from fiber_core.clearance.minimum_distance import Minima, minimum_gaps
from fiber_core.clearance.piecewise import profiles_of
from fiber_core.clearance.safety import Safety
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion

__all__ = ["hold_until_safe"]


def hold_until_safe(
    plane: FocalPlane,
    motion: SegmentMotion,
    safety: Safety,
    pairs=None,
    tolerance_mm: float = 0.5e-3,
) -> tuple[SegmentMotion, np.ndarray, Certificate]:
    """Hold as few robots as a greedy choice finds, so that the rest of a motion is certified.

    A held robot rests at its start for the whole motion. Robots that break a limit or
    move although disabled are held first. Then, as long as pairs are unsafe, the moving
    robot in most of them is held, the lowest row among equals, until each of them has
    lost one; the pairs of held robots are certified again. At the end held robots are
    tried once more, in order and until none can go, and move again if their own pairs
    allow it. Two resting robots that are too close cannot be helped: the certificate
    says so.

    Args:
        plane: the focal plane.
        motion: joint profiles of all robots.
        safety: gap asked for and timing errors to survive.
        pairs: rows a < b to examine, shape (p, 2), as for certify.
        tolerance_mm: how closely gaps below their required value are resolved [mm].

    Returns:
        The motion that remains, which robots were held by this, shape (n,), and the
        certificate of the motion returned.
    """
    if pairs is None:
        pairs = certified_pairs(plane, motion, safety)
    search = _Search(plane, motion, safety, pairs, tolerance_mm)
    faulty = limits_broken(plane, search.profiles) | moved_disabled(plane, search.profiles)
    search.hold(faulty)
    search.hold_until_covered()
    if not search.unsafe.any():
        candidates = ~faulty
        while candidates.any():
            candidates = search.release(candidates) & ~faulty
        search.hold_until_covered()  # those released may have made the whole motion longer
    return search.motion, search.held, search.certificate()


class _Search:
    # A motion with some robots held, and what is known about the gaps of its pairs.

    def __init__(self, plane, motion, safety, pairs, tolerance_mm):
        self.plane, self.wished, self.safety = plane, motion, safety
        self.tolerance_mm = tolerance_mm
        self.pairs = np.array(pairs, dtype=np.int32).reshape(-1, 2)
        self.bodies, self.profiles = bodies_of(plane), profiles_of(motion)
        self.stop = self.profiles.stop.copy()
        self.held = np.zeros(plane.n, dtype=bool)
        self.minima = Minima.unknown(len(self.pairs))
        self.update()

    @property
    def motion(self):
        return self.wished.without(self.held)

    def update(self):
        # What is required changes with the makespan, so with every robot held or released.
        # A pair is looked at only if a gap that low was not met and is not excluded.
        self.required = self.safety.required_mm(self.plane, self.motion, self.pairs)
        lower, best, _ = self.minima
        self.prove(np.flatnonzero((lower < self.required) & (best >= self.required)))
        self.unsafe = lower < self.required

    def prove(self, rows):
        known = (self.bodies, self.profiles, self.pairs, rows, self.required, self.tolerance_mm)
        minimum_gaps(*known, False, self.minima)

    def hold(self, robots):
        # the robots, shape (n,), rest from now on; nothing is known about their pairs
        self.held |= robots
        self.profiles.stop[robots] = self.profiles.first[robots]
        touched = self._of_bodies(robots)[self.pairs].any(axis=1)
        self.minima.lower[touched], self.minima.best[touched] = -np.inf, np.inf
        self.update()

    def hold_until_covered(self):
        while (chosen := self._cover()).any():
            self.hold(chosen)

    def _cover(self):
        # greedy vertex cover of the unsafe pairs by robots that move
        movable = self._of_bodies(self.profiles.fastest.any(axis=1) & ~self.held)
        chosen = np.zeros(self.plane.n, dtype=bool)
        uncovered = self.pairs[self.unsafe & movable[self.pairs].any(axis=1)]
        while len(uncovered):
            times = np.bincount(uncovered.ravel(), minlength=len(movable))
            most = np.argmax(times * movable)
            chosen[most] = True
            uncovered = uncovered[(uncovered != most).all(axis=1)]
        return chosen

    def release(self, allowed):
        # Let those go whose own pairs stay safe; returns the neighbours of those who went.
        held_before = self.held.copy()
        # No motion with robots held requires more than the wished one does.
        self.required = self.safety.required_mm(self.plane, self.wished, self.pairs)
        order = np.argsort(self.pairs, axis=None, kind="stable")
        begin = np.searchsorted(self.pairs.ravel()[order], np.arange(self.plane.n + 1))
        for robot in np.flatnonzero(self.held & allowed):
            own = order[begin[robot] : begin[robot + 1]] // 2
            before = [column[own] for column in self.minima]
            self.profiles.stop[robot] = self.stop[robot]
            self.prove(own)
            if (self.minima.lower[own] >= self.required[own]).all():
                self.held[robot] = False
                continue
            self.profiles.stop[robot] = self.profiles.first[robot]
            for column, known in zip(self.minima, before):
                column[own] = known
        self.update()
        released = self._of_bodies(held_before & ~self.held)
        beside = np.zeros(len(released), dtype=bool)
        beside[self.pairs[released[self.pairs].any(axis=1)]] = True
        return beside[: self.plane.n]

    def _of_bodies(self, robots):
        return np.append(robots, np.zeros(len(self.plane.obstacles), dtype=bool))

    def certificate(self):
        return certificate_of(
            self.plane,
            self.bodies,
            profiles_of(self.motion),
            self.pairs,
            self.required,
            self.minima,
            self.tolerance_mm,
        )
