# SPDX-License-Identifier: Apache-2.0
"""Fit sampled joint profiles with few straight lines that stay inside a corridor."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_core.array_types import Floats, Ints, Offsets, Times
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion
from fiber_discretizer.errors import UnknownOption
from fiber_discretizer.fit.douglas_peucker import bisection_knots
from fiber_discretizer.fit.greedy import greedy_knots
from fiber_discretizer.fit.min_link import min_link_paths, relaxed_paths

__all__ = ["LINEARIZERS", "Polylines", "linearize", "polylines_of"]

_NOISE_RAD = 1e-9  # a point this close to a bound is inside: 1/1000 of a typical wire quantum


@dataclass(frozen=True, eq=False)
class Polylines:
    """Piecewise-linear profiles as flat arrays of knots.

    Args:
        offsets: first knot of each profile, shape (p + 1,).
        time_s: times of the knots, increasing within a profile [s], shape (k,).
        angles: joint angles at the knots [rad], shape (k,).
    """

    offsets: Offsets
    time_s: Times
    angles: Floats

    def __post_init__(self):
        for name, dtype in (("offsets", np.int64), ("time_s", float), ("angles", float)):
            value = np.array(getattr(self, name), dtype=dtype, order="C")
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    @classmethod
    def of_joints(cls, theta: "Polylines", phi: "Polylines") -> "Polylines":
        """Return profiles of theta and phi in turn, as the segments of a motion are.

        Args:
            theta: the profiles of theta of n robots.
            phi: those of phi.
        """
        n = len(theta.parts)
        both = Parts.concatenate([theta.parts, phi.parts])
        parts, knots = both.select(np.arange(2 * n).reshape(2, n).T.ravel())
        times = np.concatenate([theta.time_s, phi.time_s])
        angles = np.concatenate([theta.angles, phi.angles])
        return cls(parts.offsets, times[knots], angles[knots])

    @classmethod
    def concatenate(cls, several: Sequence["Polylines"]) -> "Polylines":
        """Return all profiles of several, in order.

        Args:
            several: the profiles to put together.
        """
        parts = Parts.concatenate([each.parts for each in several])
        times = np.concatenate([each.time_s for each in several])
        return cls(parts.offsets, times, np.concatenate([each.angles for each in several]))

    @property
    def parts(self) -> Parts:
        """The knots of each profile, as parts of the flat arrays."""
        return Parts(self.offsets)

    @property
    def counts(self) -> Ints:
        """Number of straight lines of each profile, shape (p,); -1 without knots."""
        return self.parts.counts - 1

    def with_profiles(self, rows: ArrayLike, other: "Polylines") -> "Polylines":
        """Return these profiles with some of them replaced.

        Args:
            rows: the profiles that are replaced, shape (r,).
            other: r other profiles.
        """
        parts, knots = self.parts.replaced(rows, other.parts)
        times = np.concatenate([self.time_s, other.time_s])
        angles = np.concatenate([self.angles, other.angles])
        return Polylines(parts.offsets, times[knots], angles[knots])

    def of(self, rows: ArrayLike) -> "Polylines":
        """Return some of these profiles.

        Args:
            rows: the profiles, shape (r,).
        """
        parts, knots = self.parts.select(rows)
        return Polylines(parts.offsets, self.time_s[knots], self.angles[knots])

    def __call__(self, time_s: ArrayLike) -> Floats:
        """Return the joint angles at increasing times [rad], shape (p, t).

        Before its first and after its last knot a profile rests.

        Args:
            time_s: the times, the same for all profiles [s], shape (t,).
        """
        times = np.ascontiguousarray(time_s, dtype=float)
        return self.at(np.tile(times, (len(self.counts), 1)))

    def at(self, times_s: Floats) -> Floats:
        """Return the joint angles at increasing times of each profile [rad], shape (p, t).

        Args:
            times_s: the times of each profile [s], shape (p, t).
        """
        return _evaluate(self.offsets, self.time_s, self.angles, times_s)


def polylines_of(motion: WireMotion) -> Polylines:
    """Return the profiles that a motion makes, exact to the last digit at every knot."""
    parts, ticks, counts = motion.knots()
    units = motion.units
    return Polylines(parts.offsets, ticks * units.tick_s, units.to_angles(counts))


def linearize(
    time_s: ArrayLike,
    profiles: ArrayLike,
    low: ArrayLike,
    high: ArrayLike,
    method: str = "minimal",
    speed_rad_s: ArrayLike = np.inf,
    last: ArrayLike | None = None,
) -> Polylines:
    """Return a piecewise-linear path inside a corridor for each profile, ends fixed.

    A profile that rests at last is followed to where its rest begins. Between samples
    the profile and the bounds of its corridor are straight; at its two ends the corridor is
    the profile.

    Args:
        time_s: strictly increasing sample times [s], shape (t,), t >= 1.
        profiles: joint angles [rad], shape (p, t).
        low, high: bounds of the corridors [rad], shape (p, t), may be infinite. "greedy" and
            "douglas_peucker" need a profile between them.
        method: a name in LINEARIZERS. "minimal" has the fewest lines of any path; "relaxed"
            has as few and keeps away from the bounds; "greedy" takes each line as far as it
            goes; "douglas_peucker" is the bisection of Makarem et al. 2014 (SPIE, arXiv
            1410.1181). The knots of the last two are samples of the profile.
        speed_rad_s: no line of "minimal" and "relaxed" is faster [rad/s], scalar or shape
            (p,); the other methods are never faster than the profile.
        last: sample at which each path ends, shape (p,); by default where its profile
            comes to rest.

    Returns:
        Polylines; no knots where a corridor cannot be passed at that speed.

    Raises:
        UnknownOption: there is no such method.
    """
    if method not in LINEARIZERS:
        raise UnknownOption("method", method, LINEARIZERS)
    time_s = np.ascontiguousarray(time_s, dtype=float)
    profiles = np.ascontiguousarray(profiles, dtype=float)
    low = np.broadcast_to(low, profiles.shape) - _NOISE_RAD
    high = np.broadcast_to(high, profiles.shape) + _NOISE_RAD
    speed = np.broadcast_to(np.asarray(speed_rad_s, dtype=float), len(profiles))
    speed = np.ascontiguousarray(speed)
    last = _arrivals(profiles) if last is None else np.asarray(last, dtype=np.int64)
    return Polylines(*LINEARIZERS[method](time_s, profiles, low, high, last, speed))


_Knots = Callable[[Floats, Floats, Floats, Floats, Ints], tuple[Offsets, Ints]]
_Paths = Callable[[Floats, Floats, Floats, Floats, Ints, Floats], tuple[Offsets, Floats, Floats]]


def _on_profile(find_knots: _Knots) -> _Paths:
    # a method that puts its knots on samples of the profile
    def method(
        time_s: Floats, profiles: Floats, low: Floats, high: Floats, last: Ints, _: Floats
    ) -> tuple[Offsets, Floats, Floats]:
        offsets, knots = find_knots(time_s, profiles, low, high, last)
        return offsets, time_s[knots], profiles[Parts(offsets).owner, knots]

    return method


@njit(cache=True)
def _arrivals(profiles):
    # the sample from which on each profile rests
    last = np.zeros(len(profiles), np.int64)
    for i in range(len(profiles)):
        k = profiles.shape[1] - 1
        while k > 0 and profiles[i, k - 1] == profiles[i, k]:
            k -= 1
        last[i] = k
    return last


@njit(cache=True)
def _evaluate(offsets, knot_time, knot_angle, times):
    out = np.empty(times.shape)
    for i in range(len(offsets) - 1):
        k, last = offsets[i], offsets[i + 1] - 1
        for j in range(times.shape[1]):
            t = times[i, j]
            while k < last and knot_time[k + 1] <= t:
                k += 1
            if k == last or t <= knot_time[k]:
                out[i, j] = knot_angle[k]
            else:
                w = (t - knot_time[k]) / (knot_time[k + 1] - knot_time[k])
                out[i, j] = (1.0 - w) * knot_angle[k] + w * knot_angle[k + 1]
    return out


LINEARIZERS: dict[str, _Paths] = {
    "minimal": min_link_paths,
    "relaxed": relaxed_paths,
    "greedy": _on_profile(greedy_knots),
    "douglas_peucker": _on_profile(bisection_knots),
}
