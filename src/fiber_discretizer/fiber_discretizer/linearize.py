"""Replace sampled joint profiles by few straight lines that stay inside a margin."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from fiber_core.errors import FiberError

__all__ = ["LINEARIZERS", "Polylines", "UnknownOption", "linearize"]

_NOISE_RAD = 1e-9  # samples this close to a line lie on it: 1/1000 of a typical wire quantum


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
        return _evaluate(self.offsets, self.time_s, self.angles, times)


def linearize(time_s, profiles, margins, method: str = "paper") -> Polylines:
    """Return a piecewise-linear path inside profile +- margin for each profile, ends fixed.

    A profile that rests at last is followed to where its rest begins. Between samples
    the profile and its margin are straight, and every knot is at a sample, so a path
    inside at all samples is inside everywhere.

    Args:
        time_s: strictly increasing sample times [s], shape (t,), t >= 1.
        profiles: joint angles [rad], shape (p, t).
        margins: how far a path may be from its profile [rad], shape (p, t), >= 0, may be
            infinite; the ends are met exactly whatever the margin there.
        method: a name in LINEARIZERS. "paper" is the bisection of Makarem et al. 2014
            (SPIE, arXiv 1410.1181): a straight line from end to end, cut at the sample
            where it leaves the margin by most, both parts treated the same.

    Raises:
        UnknownOption: there is no such method.
    """
    if method not in LINEARIZERS:
        raise UnknownOption(f"linearization {method!r} is not one of {', '.join(LINEARIZERS)}")
    time_s = np.ascontiguousarray(time_s, dtype=float)
    profiles = np.ascontiguousarray(profiles, dtype=float)
    margins = np.ascontiguousarray(margins, dtype=float)
    offsets, knots = LINEARIZERS[method](time_s, profiles, margins, _arrivals(profiles))
    row = np.repeat(np.arange(len(profiles)), np.diff(offsets))
    return Polylines(offsets, time_s[knots], profiles[row, knots])


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
def _bisect(time_s, profiles, margins, last):
    p, t = profiles.shape
    offsets = np.zeros(p + 1, np.int64)
    flat = np.empty(4 * p + t, np.int64)
    used = 0
    rights = np.empty(t, np.int64)  # right ends of the parts still to do, nearest on top
    for i in range(p):
        if used + t > len(flat):
            grown = np.empty(2 * len(flat) + t, np.int64)
            for k in range(used):  # a slice assignment compiles for seconds
                grown[k] = flat[k]
            flat = grown
        flat[used] = 0
        used += 1
        rights[0] = last[i]
        left, depth = 0, 1 if last[i] > 0 else 0
        while depth > 0:
            right = rights[depth - 1]
            cut = _worst_sample(time_s, profiles[i], margins[i], left, right)
            if cut >= 0:
                rights[depth] = cut
                depth += 1
            else:
                flat[used] = right
                used += 1
                left = right
                depth -= 1
        offsets[i + 1] = used
    return offsets, flat[:used].copy()


@njit(cache=True)
def _worst_sample(time_s, profile, margin, left, right):
    # the sample between left and right where their chord leaves the margin by most, or -1
    slope = (profile[right] - profile[left]) / (time_s[right] - time_s[left])
    worst, at = _NOISE_RAD, -1
    for k in range(left + 1, right):
        chord = profile[left] + slope * (time_s[k] - time_s[left])
        excess = abs(profile[k] - chord) - margin[k]
        if excess > worst:
            worst, at = excess, k
    return at


@njit(cache=True)
def _evaluate(offsets, knot_time, knot_angle, times):
    out = np.empty((len(offsets) - 1, len(times)))
    for i in range(len(offsets) - 1):
        k, last = offsets[i], offsets[i + 1] - 1
        for j in range(len(times)):
            t = times[j]
            while k < last and knot_time[k + 1] <= t:
                k += 1
            if k == last or t <= knot_time[k]:
                out[i, j] = knot_angle[k]
            else:
                w = (t - knot_time[k]) / (knot_time[k + 1] - knot_time[k])
                out[i, j] = (1.0 - w) * knot_angle[k] + w * knot_angle[k + 1]
    return out


LINEARIZERS = {"paper": _bisect}
