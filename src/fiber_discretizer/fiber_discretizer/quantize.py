# SPDX-License-Identifier: Apache-2.0
"""Round piecewise-linear profiles to whole wire units without losing their goals."""

from dataclasses import astuple, dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_core.array_types import Counts
from fiber_core.bounds import check_number
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_discretizer.errors import OptionError
from fiber_discretizer.fit.linearize import Polylines

__all__ = ["Rounding", "quantize"]

_ENDLESS = 2**40  # more ticks than any motion takes


@dataclass(frozen=True)
class Rounding:
    """Limits of the search for a last segment in whole units that meets the end of a profile.

    Args:
        good_quanta: end error at which the search ends [quanta].
        worst_quanta: largest end error of a single last segment [quanta]; with a larger error
            the segment is cut in two, which meets the end more closely.
        later_ticks: how many ticks the last segment may become longer, where that does not
            make the whole motion longer.
        sooner_ticks: how many ticks the last segment may become shorter.
        nudge_units: how many velocity units the segment before it may change.

    Raises:
        OptionError: a value is negative, no whole number, or out of bounds; names it.
    """

    good_quanta: int = 6
    worst_quanta: int = 60
    later_ticks: int = 8
    sooner_ticks: int = 64
    nudge_units: int = 8

    def __post_init__(self) -> None:
        for name, high in (
            ("good_quanta", 2**31),
            ("worst_quanta", 2**31),
            ("later_ticks", 10_000),
            ("sooner_ticks", 10_000),
            ("nudge_units", 10_000),
        ):
            check_number(getattr(self, name), name, 0, high, OptionError, whole=True)


def quantize(
    paths: Polylines,
    start: Counts,
    goal: ArrayLike,
    range_counts: ArrayLike,
    speed_rad_s: ArrayLike,
    slack_rad: ArrayLike,
    units: WireUnits,
    rounding: Rounding = Rounding(),
    latest_s: float = np.inf,
) -> WireMotion:
    """Return the whole-number motion nearest to piecewise-linear profiles.

    Break times are rounded to ticks and the profile is evaluated there, so no segment
    becomes faster than the profile. Velocities are rounded so that each segment ends
    nearest to the profile, which carries the rounding error of one segment into the
    next. For the last segment every duration and change of the velocity before it that
    the search allows is tried, nearest first, until the end error is small enough; the
    best is kept. Where a profile is faster than the speed limit, its motion takes longer.

    Args:
        paths: profiles of theta and phi of n robots in turn, the first knot at time >= 0; before
            it a profile rests.
        start: encoder count of each joint at the start [quanta], shape (n, 2).
        goal: encoder count at the end [quanta], shape (n, 2).
        range_counts: lowest and highest count allowed [quanta], shape (n, 2, 2); a joint
            that starts outside may come back in, but not go farther out.
        speed_rad_s: speed limits [rad/s], shape (n, 2); velocities are cut below them.
        slack_rad: how far each profile may be shifted by the search [rad], shape (n, 2).
        units: size of tick and quantum, and the widths of the fields.
        rounding: limits of the search.
        latest_s: end of the whole motion [s]; the search lets no profile end later, a profile
            that ends then takes one segment more.

    Returns:
        The motion; a segment longer than its duration field holds is split, and segments that
        rest at the end of a profile, or last no time, are left out.
    """
    fastest = np.floor(np.ravel(speed_rad_s) / units.velocity_rad_s)
    segments = _quantize(
        paths.offsets,
        paths.time_s / units.tick_s,
        paths.angles / units.quantum_rad,
        np.array(start, dtype=np.int64).ravel(),
        np.array(goal, dtype=np.int64).ravel(),
        np.array(range_counts, dtype=np.int64).reshape(-1, 2),
        np.minimum(fastest, units.max_velocity).astype(np.int64),
        np.ravel(slack_rad) / units.quantum_rad,
        units.max_ticks,
        tuple(map(int, astuple(rounding))),  # one type: 8.0 is a whole number too
        min(np.ceil(latest_s / units.tick_s - 1e-6), float(_ENDLESS)),
    )
    return WireMotion(units, start, *segments)


@njit(cache=True)
def _quantize(
    offsets, time, position, start, goal, ranges, fastest, slack, max_ticks, limits, latest
):
    # times in ticks, positions in quanta, velocities in quanta per tick
    p = len(offsets) - 1
    first = np.zeros(p + 1, np.int64)
    ticks, velocity = [np.int64(0) for _ in range(0)], [np.int64(0) for _ in range(0)]
    for i in range(p):
        first[i] = len(ticks)
        knot, last = offsets[i], offsets[i + 1] - 1
        while last > knot and abs(position[last - 1] - position[offsets[i + 1] - 1]) < 1.0:
            last -= 1  # a rest at the end needs no segment
        bounds = (fastest[i], min(ranges[i, 0], start[i]), max(ranges[i, 1], start[i]))
        count, now = start[i], np.int64(0)
        for k in range(offsets[i], last):
            tick = np.int64(np.rint(time[k]))
            if tick <= now:
                continue
            while knot + 1 < last and time[knot + 1] <= tick:
                knot += 1
            along = (tick - time[knot]) / (time[knot + 1] - time[knot])
            wanted = position[knot] + max(along, 0.0) * (position[knot + 1] - position[knot])
            while now < tick:
                left = tick - now
                span = left // -(-left // max_ticks)
                v = _nearest_velocity(count, wanted - count, left, span, bounds)
                if k == last - 1 and span == left:
                    rest = np.int64(np.ceil(time[last] - 1e-6)) - tick
                    v = _in_time(v, count, goal[i], span, rest, bounds)
                ticks.append(span)
                velocity.append(v)
                count += v * span
                now += span
        if fastest[i] > 0:
            span = max(np.int64(np.ceil(time[last] - 1e-6)) - now, 1)
            left = np.int64(latest) - now
            _append_last_segment(
                ticks, velocity, first[i], count, goal[i] - count, span, left,
                bounds, slack[i], max_ticks, limits,
            )  # fmt: skip
        while len(ticks) > first[i] and velocity[-1] == 0:
            ticks.pop()
            velocity.pop()
    first[p] = len(ticks)
    return first, np.array(ticks, np.int64), np.array(velocity, np.int64)


@njit(cache=True)
def _nearest_velocity(count, travel, left, span, bounds):
    # whole velocity for `span` of the `left` ticks in which to travel, within all bounds
    fastest, low, high = bounds
    v = np.int64(np.rint(travel / left))
    v = min(max(v, -fastest), fastest)
    return min(max(v, -((count - low) // span)), (high - count) // span)


@njit(cache=True)
def _in_time(v, count, goal, span, rest, bounds):
    # The velocity before the last segment, rounded the other way where the goal would else be too
    # far for the `rest` ticks of that one: a whole tick more of all robots.
    fastest, low, high = bounds
    left = goal - (count + v * span)
    if abs(left) <= fastest * rest:
        return v
    other = v + (1 if left > 0 else -1)
    after = count + other * span
    if abs(other) > fastest or not low <= after <= high or abs(goal - after) > fastest * rest:
        return v
    return other


@njit(cache=True)
def _append_last_segment(
    ticks, velocity, first, count, travel, span, left, bounds, slack, max_ticks, limits
):
    # Travel to the goal in about `span` ticks and as few segments as the fields allow; the
    # whole motion has `left` ticks left.
    fastest, worst = bounds[0], limits[1]
    span = max(span, -(-abs(travel) // fastest))
    while True:
        if span <= max_ticks:
            alone = len(ticks) == first
            before = (np.int64(0), np.int64(0)) if alone else (ticks[-1], velocity[-1])
            later = min(limits[2], max(left - span, 0))
            error, last_ticks, last_velocity, nudge = _search_last_segment(
                count, travel, span, later, bounds, before, slack, max_ticks, limits
            )
            if error <= worst or span == 1:
                break
            part = max(np.int64(0.382 * span), 1)  # golden section: halves share their errors
        else:
            part = span // -(-span // max_ticks)
        v = _nearest_velocity(count, travel, span, part, bounds)
        ticks.append(part)
        velocity.append(v)
        count += v * part
        travel -= v * part
        left -= part
        span = max(span - part, -(-abs(travel) // fastest))
    if not alone:
        velocity[-1] += nudge
    ticks.append(last_ticks)
    velocity.append(last_velocity)


@njit(cache=True)
def _search_last_segment(count, travel, span, later, bounds, before, slack, max_ticks, limits):
    # Error, ticks and velocity of the best last segment, and the change of velocity of
    # the segment before it. The smallest changes come first: 0, -1, +1, -2, +2, ...
    fastest, low, high = bounds
    good, _, _, sooner, nudges = limits
    before_ticks, before_velocity = before
    if before_ticks == 0:
        nudges = 0
    best = (np.int64(2**62), span, np.int64(0), np.int64(0))
    for a in range(2 * max(later, sooner) + 1):
        shift = a // 2 if a % 2 == 0 else -(a // 2) - 1
        t = span + shift
        if a > 0 and abs(shift) * abs(travel) > slack * span:
            break
        if t < 1 or t > max_ticks or shift > later or -shift > sooner:
            continue
        for b in range(2 * nudges + 1):
            nudge = b // 2 if b % 2 == 0 else -(b // 2) - 1
            moved = nudge * before_ticks
            if b > 0 and (
                abs(moved) > slack
                or abs(before_velocity + nudge) > fastest
                or not low <= count + moved <= high
            ):
                continue
            v = _nearest_velocity(count + moved, travel - moved, t, t, bounds)
            error = abs(travel - moved - v * t)
            if error < best[0]:
                best = (error, t, v, nudge)
            if error <= good:
                return best
    return best
