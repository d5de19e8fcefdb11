"""Make a motion safe by holding a few robots where they are."""

import numpy as np

from fiber_core.clearance.bodies import bodies_of
from fiber_core.clearance.certificate import (
    Certificate,
    certificate_of,
    certified_pairs,
    limits_broken,
    moved_disabled,
)
from fiber_core.clearance.minimum import Minima, minimum_gaps, profiles_of
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
    """Hold as few robots as a greedy choice finds until the rest of a motion is certified.

    A held robot rests at its start for the whole motion. Robots that break a limit or
    move although disabled are held first. Then, as long as a pair is unsafe, the moving
    robot in most unsafe pairs is held, the lowest row among equals, until every unsafe
    pair has lost a robot; the pairs of held robots are certified again. At the end each
    held robot is tried once more, and moves again if everything stays certified. Two
    resting robots that are too close cannot be helped: the certificate says so.

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
    to_hold = faulty
    while to_hold.any() or (to_hold := search.cover()).any():
        search.apply(search.held | to_hold)
        to_hold = np.zeros(plane.n, dtype=bool)
    if not search.unsafe.any():
        for row in np.flatnonzero(search.held & ~faulty):
            search.try_release(row)
    return search.motion, search.held, search.certificate


class _Search:
    # The motion with some robots held, and what is known about the gaps of its pairs.

    def __init__(self, plane, motion, safety, pairs, tolerance_mm):
        self.plane, self.wished, self.safety, self.tolerance = plane, motion, safety, tolerance_mm
        self.pairs = np.array(pairs, dtype=np.int32).reshape(-1, 2)
        self.bodies = bodies_of(plane)
        self.moves = profiles_of(motion).fastest.any(axis=1)
        self.held = np.zeros(plane.n, dtype=bool)
        self.minima = Minima.unknown(len(self.pairs))
        self._certify(motion, np.ones(len(self.pairs), dtype=bool))

    def _certify(self, motion, changed):
        # Holding shortens the motion and so lowers what is required, releasing raises it:
        # pairs nobody touched are looked at again only where their bound is too low.
        self.motion, self.profiles = motion, profiles_of(motion)
        self.required = self.safety.required_mm(self.plane, motion, self.pairs)
        known = self.minima.lower >= np.minimum(
            self.required, self.minima.best - 2 * self.tolerance
        )
        rows = np.flatnonzero(changed | ~known)
        work = (self.bodies, self.profiles, self.pairs, rows, self.required, self.tolerance)
        minimum_gaps(*work, False, self.minima)
        self.unsafe = self.minima.lower < self.required

    def apply(self, held):
        changed = np.append(held != self.held, np.zeros(len(self.plane.obstacles), dtype=bool))
        self.held = held
        self._certify(self.wished.without(held), changed[self.pairs].any(axis=1))

    def cover(self):
        # greedy vertex cover of the unsafe pairs by robots that move
        movable = np.append(self.moves & ~self.held, np.zeros(len(self.plane.obstacles), dtype=bool))
        chosen = np.zeros(self.plane.n, dtype=bool)
        open_pairs = self.pairs[self.unsafe]
        open_pairs = open_pairs[movable[open_pairs].any(axis=1)]
        while len(open_pairs):
            times = np.bincount(open_pairs.ravel(), minlength=len(movable)) * movable
            most = np.argmax(times)
            chosen[most] = True
            open_pairs = open_pairs[(open_pairs != most).all(axis=1)]
        return chosen

    def try_release(self, row):
        before = (self.held, self.motion, self.profiles, self.required, self.unsafe, self.minima)
        self.minima = Minima(*(column.copy() for column in self.minima))
        held = self.held.copy()
        held[row] = False
        self.apply(held)
        if self.unsafe.any():
            self.held, self.motion, self.profiles, self.required, self.unsafe, self.minima = before

    @property
    def certificate(self):
        return certificate_of(
            self.plane,
            self.bodies,
            self.profiles,
            self.pairs,
            self.required,
            self.minima,
            self.tolerance,
        )
