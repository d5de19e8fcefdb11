"""Replace sampled joint profiles by few straight lines that stay inside a tube."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from fiber_core.errors import FiberError
from fiber_discretizer.fit.douglas_peucker import bisection_knots
from fiber_discretizer.fit.greedy import greedy_knots
from fiber_discretizer.fit.min_link import min_link_paths, relaxed_paths

__all__ = ["LINEARIZERS", "Polylines", "UnknownOption", "linearize"]

_NOISE_RAD = 1e-9  # what is this close to a wall is inside: 1/1000 of a typical wire quantum


class UnknownOption(FiberError):
    """An option names something the discretizer does not have."""


@dataclass(frozen=True, eq=False)
class Polylines:
    """Piecewise-linear profiles as flat arrays of knots.

    Args:
        offsets: first knot of each profile, shape (p + 1,).
        time_s: times of the knots, increasing within a profile [s], shape (k,).
        angles: joint angles at the knots [rad], shape (k,).
    """

    offsets: np.ndarray
    time_s: np.ndarray
    angles: np.ndarray

    def __post_init__(self):
        for name, dtype in (("offsets", np.int64), ("time_s", float), ("angles", float)):
            value = np.array(getattr(self, name), dtype=dtype, order="C")
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    @property
    def counts(self) -> np.ndarray:
        """Number of straight lines of each profile, shape (p,)."""
        return np.diff(self.offsets) - 1

    def __call__(self, time_s) -> np.ndarray:
        """Joint angles at increasing times [s], shape (t,): [rad], shape (p, t).

        Before its first and after its last knot a profile rests.
        """
        times = np.ascontiguousarray(time_s, dtype=float)
        return self.at(np.tile(times, (len(self.counts), 1)))

    def at(self, times_s) -> np.ndarray:
        """As a call, with increasing times for each profile [s], shape (p, t)."""
        return _evaluate(self.offsets, self.time_s, self.angles, times_s)


def linearize(
    time_s, profiles, low, high, method: str = "minimal", speed_rad_s=np.inf, last=None
) -> Polylines:
    """Return a piecewise-linear path inside a tube for each profile, ends fixed.

    A profile that rests at last is followed to where its rest begins. Between samples
    the profile and the walls of its tube are straight; at its two ends the tube is the
    profile.

    Args:
        time_s: strictly increasing sample times [s], shape (t,), t >= 1.
        profiles: joint angles [rad], shape (p, t).
        low, high: walls of the tubes [rad], shape (p, t), may be infinite. The profile is
            between them; only "minimal" and "relaxed" do without.
        method: a name in LINEARIZERS. "paper" is the bisection of Makarem et al. 2014
            (SPIE, arXiv 1410.1181); "greedy" takes each line as far as it goes; both
            have their knots on the profile, at samples. "minimal" has the fewest lines of
            any path; "relaxed" has as few and keeps away from the walls.
        speed_rad_s: no line of the last two is faster [rad/s], scalar or shape (p,); the
            others are never faster than the profile.
        last: sample at which each path ends, shape (p,); by default where its profile
            comes to rest.

    Returns:
        Polylines; no knots where there is no path in a tube at that speed.

    Raises:
        UnknownOption: there is no such method.
    """
    if method not in LINEARIZERS:
        raise UnknownOption(f"linearization {method!r} is not one of {', '.join(LINEARIZERS)}")
    time_s = np.ascontiguousarray(time_s, dtype=float)
    profiles = np.ascontiguousarray(profiles, dtype=float)
    low = np.broadcast_to(low, profiles.shape) - _NOISE_RAD
    high = np.broadcast_to(high, profiles.shape) + _NOISE_RAD
    speed = np.broadcast_to(np.asarray(speed_rad_s, dtype=float), len(profiles))
    speed = np.ascontiguousarray(speed)
    last = _arrivals(profiles) if last is None else np.asarray(last, dtype=np.int64)
    return Polylines(*LINEARIZERS[method](time_s, profiles, low, high, last, speed))


def _on_profile(find_knots):
    # a method whose knots are samples of the profile
    def method(time_s, profiles, low, high, last, _):
        offsets, knots = find_knots(time_s, profiles, low, high, last)
        row = np.repeat(np.arange(len(profiles)), np.diff(offsets))
        return offsets, time_s[knots], profiles[row, knots]

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


LINEARIZERS = {
    "minimal": min_link_paths,
    "relaxed": relaxed_paths,
    "greedy": _on_profile(greedy_knots),
    "paper": _on_profile(bisection_knots),
}
