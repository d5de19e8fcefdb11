"""Segments of every motor while they are being made, and what is proven about them."""

from typing import NamedTuple

import numpy as np

from fiber_core.clearance import (
    Profiles,
    Safety,
    bodies_of,
    gaps,
    levers_of,
    neighbour_pairs,
    point_speeds,
    profiles_of,
    unproven,
)
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_core.wire_units import WireUnits
from fiber_discretizer.corridor import neighbours_of
from fiber_discretizer.segments import Segments

__all__ = ["Draft", "profiles_of_robots"]


class Snapshot(NamedTuple):
    """Segments of everybody at some moment, and what was known about them; as in Draft."""

    segments: Segments
    settled: np.ndarray
    unsafe: np.ndarray


class Draft:
    """Segments of every motor so far. A new draft has none: everybody rests.

    Args:
        plane: the focal plane.
        units: size of tick and quantum, and the widths of the fields.
        start: where the motors are [quanta], shape (n, 2).
        safety: gap asked for and timing errors to survive.
        makespan_s: how long any motion may last [s].

    Attributes:
        segments: of profiles 2 i + j, robot i, joint j.
        settled: robots whose segments are in whole units, shape (n,).
        unsafe: pairs not proven to keep their gap, shape (p,).
        pairs: who may ever come too close, rows a, b as from neighbour_pairs, shape (p, 2).
        most_required_mm: gap each of them must keep at full speed [mm], shape (p,).
        levers_mm: from levers_of, shape (n, 2).
        bodies: outlines, from bodies_of.
        beside: who is beside whom, from neighbours_of.
    """

    def __init__(
        self, plane: FocalPlane, units: WireUnits, start, safety: Safety, makespan_s: float
    ):
        self.plane, self.units, self.start = plane, units, start
        self._safety, self._makespan_s = safety, makespan_s
        self.levers_mm = levers_of(plane)
        speeds = point_speeds(self.levers_mm, plane.speeds * plane.enabled[:, None])
        two = np.repeat(np.argsort(speeds)[-1:], 2)  # the fastest, beside one like itself
        most = safety.required_at(speeds, makespan_s, two).max(initial=0.0)
        self.pairs = neighbour_pairs(plane, max(1.0, most))
        self._at_start_mm = gaps(plane, self.pairs, units.to_angles(start))
        self.most_required_mm = safety.required_at(
            speeds, makespan_s, self.pairs, self._at_start_mm
        )
        self.bodies, self.beside = bodies_of(plane), neighbours_of(plane.n, self.pairs)
        self.segments = Segments.none(2 * plane.n)
        self.settled = np.ones(plane.n, dtype=bool)
        self.unsafe = np.zeros(len(self.pairs), dtype=bool)
        self._profiles = None

    @property
    def motion(self) -> SegmentMotion:
        """What these segments stand for."""
        return self.motion_of(np.arange(self.plane.n), self.segments)

    @property
    def profiles(self) -> Profiles:
        """The same, as profiles_of."""
        if self._profiles is None:
            self._profiles = profiles_of(self.motion)
        return self._profiles

    @property
    def in_conflict(self) -> np.ndarray:
        """Robots in an unsafe pair, shape (n,)."""
        return self.robots_in(np.flatnonzero(self.unsafe))

    def motion_of(self, rows, segments: Segments) -> SegmentMotion:
        """Return the motion some robots, shape (m,), make of segments of 2 m profiles."""
        units = self.units
        return SegmentMotion(
            units.to_angles(self.start[rows]),
            segments.offsets,
            segments.ticks * units.tick_s,
            segments.velocity * units.velocity_rad_s,
        )

    def counts(self) -> np.ndarray:
        """Number of segments, shape (n, 2)."""
        return self.segments.counts.reshape(-1, 2)

    def pairs_of(self, rows) -> np.ndarray:
        """Return the pairs with one of the robots, shape (k,), increasing."""
        first, stop = self.beside.offsets[rows], self.beside.offsets[np.asarray(rows) + 1]
        counts = stop - first
        at = np.arange(counts.sum()) + np.repeat(first - np.cumsum(counts) + counts, counts)
        return np.unique(self.beside.pair[at])

    def robots_in(self, pairs) -> np.ndarray:
        """Return the robots in some pairs, shape (k,): bool, shape (n,)."""
        found = np.zeros(self.plane.n + len(self.plane.obstacles), dtype=bool)
        found[self.pairs[pairs].ravel()] = True
        return found[: self.plane.n]

    def unproven(self, pairs, rows=(), segments: Segments | None = None) -> np.ndarray:
        """Return which pairs, shape (k,), would be unsafe with other segments of some robots.

        Args:
            pairs: which to look at, shape (k,).
            rows: robots that would have other segments, shape (m,).
            segments: theirs, of 2 m profiles.
        """
        profiles = self.profiles
        if segments is not None:
            theirs = profiles_of(self.motion_of(rows, segments))
            profiles = profiles_of_robots(profiles, rows, theirs)
        speeds = point_speeds(self.levers_mm, profiles.fastest)
        required = self._safety.required_at(
            speeds, self._makespan_s, self.pairs[pairs], self._at_start_mm[pairs]
        )
        return unproven(self.bodies, profiles, self.pairs[pairs], required)

    def give(self, rows, segments: Segments, settled: bool = True) -> None:
        """Let robots, shape (m,), have other segments, of 2 m profiles."""
        self.segments = self.segments.replaced(profile_rows(rows), segments)
        self.settled[rows] = settled
        self._profiles = None
        concerned = self.pairs_of(rows)
        self.unsafe[concerned] = self.unproven(concerned)

    def snapshot(self) -> Snapshot:
        """Return what go_back needs to undo all that is given from now on."""
        return Snapshot(self.segments, self.settled.copy(), self.unsafe.copy())

    def go_back(self, before: Snapshot) -> None:
        """Undo all that was given since a snapshot."""
        self.segments, self.settled, self.unsafe = before
        self._profiles = None

    def rest(self, robots: np.ndarray) -> None:
        """Let the robots, bool of shape (n,), stay where they are."""
        rows = np.flatnonzero(robots)
        self.give(rows, Segments.none(2 * len(rows)))


def profile_rows(rows) -> np.ndarray:
    """Return the profiles of robots, shape (m,): theta and phi of each, shape (2 m,)."""
    return (2 * np.asarray(rows)[:, None] + [0, 1]).ravel()


def profiles_of_robots(everybody: Profiles, rows, theirs: Profiles) -> Profiles:
    """Return the profiles with those of some robots, shape (m,), taken from another set."""
    segments = len(everybody.begins_s)

    def replaced(name, shift=0):
        column = getattr(everybody, name).copy()
        column[rows] = getattr(theirs, name) + shift
        return column

    def joined(name):
        return np.concatenate([getattr(everybody, name), getattr(theirs, name)])

    return Profiles(
        start=everybody.start,
        first=replaced("first", segments),
        stop=replaced("stop", segments),
        begins_s=joined("begins_s"),
        ends_s=joined("ends_s"),
        angle=joined("angle"),
        velocity=joined("velocity"),
        low=everybody.low,
        high=everybody.high,
        fastest=replaced("fastest"),
    )
